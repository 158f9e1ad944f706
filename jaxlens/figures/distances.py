"""Three distances from a point of a surface, measured, and drawn as curves of equal distance."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import matplotlib
import numpy as np
from jaxtyping import Array, Bool, Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure

from jaxlens.figures.contours import contour_lines
from jaxlens.figures.palette import MUTED, WIDTH
from jaxlens.figures.pictures import place
from jaxlens.figures.style import bare, new_figure, plain
from jaxlens.surfaces import DepthMap, geodesic_distance, nose_tip, radial_geodesic_distance, shade

_TITLE, _GAP, _MARGIN, _BAR = 0.44, 0.08, 0.05, 0.95
_TITLES = (
    ("planar", "straight in the picture's plane"),
    ("radial geodesic (Eqs. 1, 2)", "on the surface above that line"),
    ("geodesic", "the shortest on the surface"),
)

Box = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Distances:
    """How far all points of a surface are from one of them.

    Attributes:
        depth_map: The surface.
        picture: `(H, W)`, shaded, 0 to 1; NaN where there is no surface.
        features: The same head, lit from the front.
        source: (x, y) in pixels; the tip of the nose, of a face.
        planar: `(H, W)`, straight in the picture's plane. NaN where there is no surface, as the others.
        radial: `(H, W)`, of the curve above that straight line (Eqs. 1 and 2); infinite where it leaves the surface.
        geodesic: `(H, W)`, of the shortest curve on the surface.
    """

    depth_map: DepthMap
    picture: Float[np.ndarray, "height width"]
    features: Float[np.ndarray, "height width"]
    source: Float[np.ndarray, "2"]
    planar: Float[np.ndarray, "height width"]
    radial: Float[np.ndarray, "height width"]
    geodesic: Float[np.ndarray, "height width"]

    @property
    def known(self) -> Bool[np.ndarray, "height width"]:
        """Where all three are finite and not zero."""
        return np.isfinite(self.radial) & np.isfinite(self.geodesic) & (self.planar > 0)


def measure_distances(
    depth_map: DepthMap,
    *,
    source: Float[np.ndarray, "2"] | None = None,
    albedo: Float[Array, "height width"] | None = None,
    normals: Float[Array, "height width 3"] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Distances:
    """Measures a surface.

    Args:
        depth_map: The surface.
        source: (x, y) in pixels; what `nose_tip` finds, unless given.
        albedo: `(H, W)`, for the shaded picture.
        normals: `(H, W, 3)`, for it too; the depth map's own, unless given.
        progress: Told about the shortest distances, as in `jaxlens.surfaces.geodesic_distance`.

    Raises:
        ValueError: as `jaxlens.surfaces.geodesic_distance`.
    """
    height, width = depth_map.shape
    mask = np.asarray(depth_map.mask)
    picture, features = (
        np.where(mask, np.asarray(shade(depth_map, albedo=albedo, normals=normals, **light)), np.nan)
        for light in ({}, {"light": (0.0, 0.0, 1.0)})
    )
    place = nose_tip(depth_map) if source is None else jnp.asarray(source, depth_map.depth.dtype)
    radial = radial_geodesic_distance(depth_map, place)
    geodesic = geodesic_distance(depth_map, source=place, progress=progress)
    offsets = (depth_map.points()[..., :2] - (place * depth_map.spacing)[None, None]).reshape(height, width, 2)
    planar = np.where(mask, np.hypot(*np.moveaxis(np.asarray(offsets), -1, 0)), np.nan)
    return Distances(depth_map, picture, features, np.asarray(place), planar, np.asarray(radial), np.asarray(geodesic))


def distance_maps(found: Distances, step: float, unit: str, *, origin: str = "the nose tip") -> Figure:
    """Draws the three distances from a point as curves of equal distance over the shaded surface."""
    maps = (found.planar, found.radial, found.geodesic)
    box = box_of(found)
    side, high = _cells(box, len(maps))
    figure = new_figure(WIDTH, _TITLE + high + 2 * _MARGIN, by_hand=True)
    farthest = max(float(np.max(one[np.isfinite(one)])) for one in maps)
    levels = step * np.arange(1, int(farthest / step) + 1)
    colors = matplotlib.colormaps["plasma"]
    norm = Normalize(0, 1.12 * farthest)  # plasma's last yellows are too light
    for index, (values, (title, note)) in enumerate(zip(maps, _TITLES, strict=True)):
        axes = place(figure, _MARGIN + index * (side + _GAP), _MARGIN + _TITLE, side, high)
        draw_faded(axes, found, box)
        curves = contour_lines(values, levels)
        lines = [curve for level in curves for curve in level]
        shades = [colors(norm(level)) for level, several in zip(levels, curves, strict=True) for _ in several]
        axes.add_collection(LineCollection(lines, colors=shades, linewidths=1.1))
        axes.plot(*found.source, "+", color="black", markersize=7, markeredgewidth=1.4)
        axes.text(0.5, 1 + 0.25 / high, title, transform=axes.transAxes, ha="center", va="baseline", fontsize=10)
        axes.text(
            0.5, 1 + 0.07 / high, note, transform=axes.transAxes, ha="center", va="baseline", fontsize=8, color=MUTED
        )
    axes = place(figure, WIDTH - _MARGIN - _BAR + 0.12, _MARGIN + _TITLE + 0.1, 0.13, high - 0.2)
    stops = step * np.arange(0, len(levels) + 1)
    shades = ListedColormap([colors(norm(stop)) for stop in stops])
    bar = figure.colorbar(
        ScalarMappable(BoundaryNorm(np.append(stops, stops[-1] + step) - step / 2, len(stops)), shades), cax=axes
    )
    every = max(1, round(len(stops) / 8))
    bar.set_ticks(stops[::every].tolist(), labels=[f"{stop:.3g}" for stop in stops[::every]])
    bar.ax.minorticks_off()
    bar.set_label(plain(f"distance from {origin}  [{unit}]"))
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def box_of(found: Distances) -> Box:
    """Returns left, right, top and bottom of what is drawn: the surface, and a little more, in pixels."""
    rows, columns = np.nonzero(np.isfinite(found.picture))
    pad = 0.03 * max(np.ptp(rows), np.ptp(columns))
    return columns.min() - pad, columns.max() + pad, rows.min() - pad, rows.max() + pad


def aspect_of(box: Box) -> float:
    """Returns the height over the width of the place for what is drawn, unless that is a strip."""
    left, right, top, bottom = box
    return float(np.clip((bottom - top) / (right - left), 0.5, 2.0))


def _cells(box: Box, count: int) -> tuple[float, float]:
    side = (WIDTH - 2 * _MARGIN - _BAR - (count - 1) * _GAP) / count
    return side, side * aspect_of(box)


def draw_faded(axes: Axes, found: Distances, box: Box) -> None:
    """Draws the shaded surface, light, on white."""
    picture = found.picture / np.nanmax(found.picture)
    axes.imshow(0.45 + 0.55 * picture, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    show_box(axes, box)


def show_box(axes: Axes, box: Box) -> None:
    """Takes ticks and frame off, and shows what is in the box."""
    bare(axes)
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[3], box[2])
    axes.set_aspect("equal")
