"""Cameras, drawn: straight lines through the lens, the radius against the angle, and how two of them differ."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from jaxlens.cameras import Camera
from jaxlens.diagnostics import Difference
from jaxlens.figures.palette import BLUE, FAINT, MUTED, ORANGE, VERMILLION
from jaxlens.figures.style import new_figure, style
from jaxlens.lenses import WideLens

# Narrower than other figures: on a telephone their letters are still read.
_WIDTH = 5.2
# About so many lines along the longer side, at most so many in all, and points along each.
_LINES, _MOST_LINES, _POINTS = 12, 240, 1001
# Of a wide lens, the degrees between two lines.
_DEGREES = 15
# Of the longer side: a longer step between two points of a line is a jump over the picture's edge.
_JUMP = 0.4
# Rows and columns of arrows, and the length of the longest as a share of the longer side.
_ARROWS, _ARROW = 8, 0.12


def camera_figure(
    camera: Camera,
    pixels: np.ndarray,
    rays: np.ndarray,
    *,
    angles: np.ndarray,
    radii: np.ndarray,
    focal: float,
    corner: float,
    has_angles: bool = True,
) -> Figure:
    """Draws what a lens does to straight lines, and its radius against the angle from the axis.

    Args:
        camera: The camera.
        pixels: `(rows, columns, 2)` over its picture.
        rays: `(rows, columns, 3)`, of these pixels; NaN where there is none.
        angles: `(n,)` from the axis, in radians, up to where the lens ends.
        radii: `(n,)` of them, in pixels from the principal point.
        focal: Pixels per unit of tan(angle).
        corner: Pixels from the principal point to the farthest corner.
        has_angles: Whether the angles are those of a camera; if not, the ideal radius stands in their place.
    """
    with style():
        tall = _height(camera)
        figure = new_figure(_WIDTH, tall + 3.7)
        upper, lower = figure.subplots(2, 1, height_ratios=(tall, 2.1))
        spacing = _draw_lines(upper, camera, rays)
        _draw_blind(upper, pixels, np.isfinite(rays[..., 0]))
        upper.set_title(f"straight lines through the lens, {spacing}", loc="left")
        _as_picture(upper, camera)
        _draw_radius(lower, angles, radii, focal, corner, has_angles)
        return figure


def difference_figure(camera: Camera, found: Difference) -> Figure:
    """Draws how far from one another two cameras see the same ray, over the picture of the first.

    Args:
        camera: The first camera.
        found: As `jaxlens.diagnostics.difference` measures it.
    """
    with style():
        figure = new_figure(_WIDTH, _height(camera) + 1.45)
        axes = figure.subplots()
        pixels, offsets, distances = (np.asarray(part) for part in (found.pixels, found.offsets, found.distances))
        # What lies next to a fold would leave one colour for all the rest.
        largest, usual = np.nanmax(distances), np.nanpercentile(distances, 99)
        limit = max(float(largest if largest < 2 * usual else usual), 1e-12)
        levels = list(MaxNLocator(12).tick_values(0, limit))
        seen = np.isfinite(distances)
        axes.set_facecolor(FAINT)
        beyond = "max" if largest > levels[-1] else "neither"
        shades = axes.contourf(
            *np.moveaxis(pixels, -1, 0), np.ma.masked_invalid(distances), levels, cmap="viridis", extend=beyond
        )
        bar = figure.colorbar(shades, ax=axes, location="bottom", aspect=32, pad=0.02)
        bar.set_ticks(levels[::2])
        bar.set_label("distance [pixels]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        rows, columns = (_middles(size) for size in distances.shape)
        tails, arrows = (part[np.ix_(rows, columns)].reshape(-1, 2) for part in (pixels, offsets))
        factor = _round_down(_ARROW * max(camera.width, camera.height) / limit)
        # NaN compares as false.
        drawable = np.hypot(*arrows.T) <= limit
        axes.quiver(
            *tails[drawable].T,
            *(factor * arrows[drawable]).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            color="white",
            edgecolor="black",
            linewidth=0.5,
            width=0.007,
            headwidth=3,
            headlength=3,
            headaxislength=3,
        )
        axes.set_title(f"from the first camera to the second, arrows × {factor:g}", loc="left")
        if not seen.all():
            _explain(axes, Rectangle((0, 0), 1, 1, facecolor=FAINT), "not seen by both")
        _as_picture(axes, camera)
        return figure


def _height(camera: Camera) -> float:
    """The height for a picture, in inches: its own, unless it is a strip."""
    return float(np.clip(camera.height / camera.width, 0.3, 1.6)) * (_WIDTH - 0.7)


def _as_picture(axes: Axes, camera: Camera) -> None:
    axes.set_xlim(-0.5, camera.width - 0.5)
    axes.set_ylim(camera.height - 0.5, -0.5)
    axes.set_aspect("equal", anchor="W")
    axes.set_xlabel("x [pixels]")
    axes.set_ylabel("y [pixels]")


def _draw_lines(axes: Axes, camera: Camera, rays: np.ndarray) -> str:
    """Draws straight lines as the camera sees them; returns how far apart they are."""
    if isinstance(camera.lens, WideLens):
        lines, spacing = _parallels(), f"{_DEGREES}° apart"
    else:
        lines, step = _lattice(camera, rays)
        spacing = f"{step:g} pixels apart without it"
    # One by one, as many points as the radius curve has: nothing need be compiled anew.
    seen = np.stack([camera.project(line) for line in lines])
    jumps = np.abs(np.diff(seen, axis=1)).max(-1) > _JUMP * max(camera.width, camera.height)
    seen[:, 1:][jumps] = np.nan
    axes.plot(*seen.T, color=BLUE, linewidth=0.9)
    return spacing


def _parallels() -> np.ndarray:
    """Lines in space, level and upright, on all sides: those that are parallel meet at a right angle from the axis."""
    turns = np.radians(np.arange(-180 + _DEGREES, 181, _DEGREES))[:, None]
    along = np.linspace(-np.pi / 2, np.pi / 2, _POINTS)[None]
    level = np.stack(
        np.broadcast_arrays(np.sin(along), np.cos(along) * np.sin(turns), np.cos(along) * np.cos(turns)), axis=-1
    )
    return np.concatenate([level, level[..., [1, 0, 2]]])


def _lattice(camera: Camera, rays: np.ndarray) -> tuple[np.ndarray, float]:
    """The lines of a square lattice in the picture of a camera without the lens, and its spacing in pixels."""
    longer = max(camera.width, camera.height)
    step = _round_down(longer / _LINES)
    scale = np.asarray(camera.frame.scale)
    seen = rays[np.isfinite(rays).all(-1)]
    ideal = (seen[:, :2] / seen[:, 2:] * scale).reshape(-1, 2)
    # Next to a fold a picture may show what is far away, in a hair's breadth.
    reach = np.minimum(np.abs(ideal).max(axis=0, initial=0), _MOST_LINES / 4 * step)
    lines = []
    for axis in (0, 1):
        places = step * np.arange(-np.floor(reach[axis] / step), reach[axis] // step + 1)[:, None]
        along = np.linspace(-1, 1, _POINTS)[None] * reach[1 - axis]
        line = np.stack(np.broadcast_arrays(places, along)[:: 1 if axis == 0 else -1], axis=-1) / scale
        lines.append(np.concatenate([line, np.ones_like(line[..., :1])], axis=-1))
    return np.concatenate(lines), step


def _draw_blind(axes: Axes, pixels: np.ndarray, seen: np.ndarray) -> None:
    """Shades what of the picture has no ray, and draws its edge."""
    if seen.all() or min(seen.shape) < 2:
        return
    x, y, blind = pixels[0, :, 0], pixels[:, 0, 1], (~seen).astype(float)
    axes.contourf(x, y, blind, levels=[0.5, 1.5], colors=[FAINT])
    axes.contour(x, y, blind, levels=[0.5], colors=[VERMILLION], linewidths=1.4)
    _explain(axes, Rectangle((0, 0), 1, 1, facecolor=FAINT, edgecolor=VERMILLION), "no ray")


def _explain(axes: Axes, patch: Rectangle, text: str) -> None:
    axes.legend([patch], [text], loc="lower left", frameon=True, framealpha=1, edgecolor="none")


def _draw_radius(
    axes: Axes, angles: np.ndarray, radii: np.ndarray, focal: float, corner: float, has_angles: bool
) -> None:
    top = 1.25 * corner
    inside = int(np.argmax(np.append(radii > top, True)))
    # One beyond, so that the curve leaves the axes.
    angles, radii = angles[: inside + 1], radii[: inside + 1]
    plane = np.linspace(0, np.arctan(2 * top / focal), 200)

    def across(values: np.ndarray) -> np.ndarray:
        return np.degrees(values) if has_angles else focal * np.tan(values)

    axes.plot(across(plane), focal * np.tan(plane), "--", color=MUTED, linewidth=1.2, label="without the lens")
    axes.plot(across(angles), radii, color=BLUE, label="with it")
    axes.axhline(corner, color=ORANGE, linewidth=1.2, label="farthest corner of the picture")
    # A lens that leaves the axes, or sees all round, has no end to be shown.
    if 0 < len(radii) <= inside and angles[-1] < np.pi - 1e-3:
        axes.plot(across(angles[-1:]), radii[-1:], "o", color=VERMILLION, markersize=6, label="the lens ends")
    axes.set_xlim(0, 1.08 * float(across(angles if len(angles) else plane)[-1]))
    axes.set_ylim(0, top)
    axes.set_xlabel("angle from the axis [degrees]" if has_angles else "radius without the lens [pixels]")
    axes.set_ylabel("radius in the picture [pixels]")
    axes.grid(True)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2)


def _middles(size: int) -> np.ndarray:
    """The places of arrows along a side."""
    count = min(_ARROWS, size)
    return ((np.arange(count) + 0.5) * size / count).astype(int)


def _round_down(value: float) -> float:
    """Returns the largest of 1, 2, 3 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(digit for digit in (1, 2, 3, 5) if digit * power <= value * (1 + 1e-12)) * power)
