"""Pictures as landscapes (Figures 1 and 8 of the paper): gray values as heights, seen in perspective."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from jaxlens.figures.contours import contour_lines
from jaxlens.figures.palette import MUTED, WIDTH
from jaxlens.figures.style import bare, new_figure, style

Drawing = Literal["mesh", "filled", "isolines"]
"""`mesh` is a net whose back is hidden, `filled` a surface in the picture's own grays under a light, `isolines` lines
of equal height."""

_TITLES = {
    "mesh": "net, coloured by height",
    "filled": "surface in the picture's grays, lit",
    "isolines": "lines of equal gray value",
}
# Cells along the longer side, of a net and of a closed surface.
_NET, _FINE = 72, 480
# By how much lines are drawn nearer than they are, in half diagonals.
_ABOVE = 0.025
# The light on a filled surface, to the viewer's upper left: x right, y up the picture, z up.
_LIGHT = np.array([-0.4, 0.35, 0.85]) / np.linalg.norm([-0.4, 0.35, 0.85])
_AMBIENT = 0.45


def surface_figure(
    image: np.ndarray,
    peak: float,
    *,
    drawings: Sequence[Drawing] = ("mesh", "filled", "isolines"),
    smoothing: float = 11.5,
    perspective: float = 0.22,
    relief: float = 0.5,
    azimuth: float = 25.0,
    elevation: float = 50.0,
) -> Figure:
    """Draws a picture as a landscape, one panel for each way of drawing; args as in `draw_surface`."""
    with style():
        rows = int(np.ceil(len(drawings) / 3))
        columns = min(len(drawings), 3)
        figure = new_figure(WIDTH, 0.3 + rows * WIDTH / max(columns, 2))
        for axes, drawing in zip(figure.subplots(rows, columns, squeeze=False).flat, drawings, strict=False):
            draw_surface(
                axes,
                image,
                peak,
                drawing=drawing,
                smoothing=smoothing,
                perspective=perspective,
                relief=relief,
                azimuth=azimuth,
                elevation=elevation,
            )
            axes.set_title(_TITLES[drawing], pad=4)
        blur = f", smoothed by a Gaussian with σ = {smoothing:g} px" if smoothing else ""
        figure.suptitle(f"gray values as heights{blur}", fontsize=10)
        return figure


def draw_surface(
    axes: Axes,
    image: np.ndarray,
    peak: float,
    *,
    drawing: Drawing = "mesh",
    smoothing: float = 11.5,
    perspective: float = 0.22,
    relief: float = 0.5,
    azimuth: float = 25.0,
    elevation: float = 50.0,
) -> None:
    """Draws a picture as a landscape, light places high.

    The defaults of `smoothing` and `perspective` are the numbers of Figure 8, in the units below; the paper does not
    say what they mean in the program that drew it.

    Args:
        axes: Where to draw; ticks and frame are taken off.
        image: `(H, W)` gray values, or `(H, W, C)`, whose mean over the channels is taken.
        peak: The gray value of white.
        drawing: How; see `Drawing`.
        smoothing: The standard deviation, in pixels, of the Gaussian that the heights are smoothed with; 0 for none.
        perspective: One over the distance of the viewer from the picture's centre, in half diagonals of the picture:
            0 is parallel projection; below 0.7, so that the viewer stays outside of the landscape.
        relief: The height of white, in half diagonals.
        azimuth: By how many degrees the landscape is turned, seen from above, counterclockwise.
        elevation: Angle of the viewer above the landscape, in degrees: 90 looks straight down.

    Raises:
        ValueError: an unknown drawing, or a number out of its range.
    """
    if drawing not in get_args(Drawing):
        raise ValueError(f"drawing must be one of {', '.join(get_args(Drawing))}, got {drawing!r}")
    if smoothing < 0 or not 0 <= perspective < 0.7:
        raise ValueError(
            f"smoothing must not be negative and 0 ≤ perspective < 0.7, got smoothing {smoothing} and perspective "
            f"{perspective}"
        )
    gray = np.asarray(image, np.float64) / peak
    gray = gray.mean(axis=-1) if gray.ndim == 3 else gray
    rows, columns = (_grid(size, max(gray.shape), _NET if drawing == "mesh" else _FINE) for size in gray.shape)
    heights = smoothed(gray, smoothing)[np.ix_(rows, columns)]
    half_diagonal = 0.5 * np.hypot(*gray.shape)
    x = (columns - 0.5 * (gray.shape[1] - 1)) / half_diagonal
    y = (0.5 * (gray.shape[0] - 1) - rows) / half_diagonal
    points = np.stack([*np.meshgrid(x, y), relief * heights], axis=-1)
    camera = _Camera(perspective, azimuth, elevation)
    quads = _quads(points)
    shapes = list(camera.flatten(quads))
    order = camera.nearness(quads).mean(axis=1)
    if drawing == "filled":
        tone = np.clip(_quads(gray[np.ix_(rows, columns)][..., None]).mean(axis=(1, 2)), 0, 1)
        faces = colormaps["gray"](np.clip((0.12 + 0.88 * tone) * _lit(quads), 0, 1))
        edges, widths = faces, np.full(len(quads), 0.35)
    else:
        faces = np.ones((len(quads), 4))
        edges = colormaps["viridis"](0.9 * np.clip(quads[..., 2].mean(axis=1) / max(relief, 1e-12), 0, 1))
        widths = np.full(len(quads), 0.45)
    if drawing == "isolines":
        edges, widths = faces, np.full(len(quads), 0.35)
        lines, border = _isolines(x, y, relief * heights), _border(points)
        segments = np.concatenate([lines, border])
        shapes += list(camera.flatten(segments))
        # Lines lie in the surface: a little nearer, so that their own cells do not hide them.
        order = np.concatenate([order, camera.nearness(segments).mean(axis=1) + _ABOVE])
        level = lines[:, 0, 2] / max(relief, 1e-12)
        gray_border = np.broadcast_to(to_rgba(MUTED), (len(border), 4))
        edges = np.concatenate([edges, colormaps["viridis"](0.9 * np.clip(level, 0, 1)), gray_border])
        faces = np.concatenate([faces, np.zeros((len(segments), 4))])
        widths = np.concatenate([widths, np.full(len(segments), 0.8)])
    painted = np.argsort(order, kind="stable")  # the farthest first
    axes.add_collection(
        PolyCollection(
            [shapes[i] for i in painted],
            facecolors=faces[painted],
            edgecolors=edges[painted],
            linewidths=widths[painted],
            capstyle="round",
            joinstyle="round",
            rasterized=True,
        )
    )
    everything = camera.flatten(points.reshape(1, -1, 3))[0]
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad = 0.02 * (high - low).max()
    axes.set_xlim(low[0] - pad, high[0] + pad)
    axes.set_ylim(low[1] - pad, high[1] + pad)
    axes.set_aspect("equal")
    bare(axes)


class _Camera:
    """Looks at the origin; the y axis of the landscape points away from it."""

    def __init__(self, perspective: float, azimuth: float, elevation: float):
        turn, tilt = np.radians(azimuth), np.radians(elevation)
        turned = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        tilted = np.array([[1, 0, 0], [0, np.sin(tilt), np.cos(tilt)], [0, -np.cos(tilt), np.sin(tilt)]])
        self._rotation = tilted @ turned
        self._perspective = perspective

    def flatten(self, points: np.ndarray) -> np.ndarray:
        seen = points @ self._rotation.T
        return seen[..., :2] / (1 - self._perspective * seen[..., 2:])

    def nearness(self, points: np.ndarray) -> np.ndarray:
        return points @ self._rotation[2]


def _grid(size: int, longest: int, cells: int) -> np.ndarray:
    """Returns whole pixels, about evenly spaced, from the first to the last."""
    count = min(size, max(2, round(cells * size / longest)) + 1)
    return np.unique(np.round(np.linspace(0, size - 1, count)).astype(int))


def _quads(grid: np.ndarray) -> np.ndarray:
    corners = (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1])
    return np.stack(corners, axis=2).reshape(-1, 4, grid.shape[-1])


def _lit(quads: np.ndarray) -> np.ndarray:
    normal = np.cross(quads[:, 1] - quads[:, 3], quads[:, 0] - quads[:, 2])
    normal *= np.sign(normal[:, 2:]) / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return _AMBIENT + (1 - _AMBIENT) * np.maximum(normal @ _LIGHT, 0) / _LIGHT[2]


def _isolines(x: np.ndarray, y: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Returns the pieces `(n, 2, 3)` of lines of equal height, two ends each."""
    low, high = heights.min(), heights.max()
    levels = np.linspace(low, high, 20)[1:-1] if high > low else np.empty(0)
    pieces = [np.empty((0, 2, 3))]
    for level, lines in zip(levels, contour_lines(heights, levels, x=x, y=y), strict=True):
        for line in lines:
            ends = np.stack([line[:-1], line[1:]], axis=1)
            pieces.append(np.concatenate([ends, np.full((len(ends), 2, 1), level)], axis=2))
    return np.concatenate(pieces)


def _border(points: np.ndarray) -> np.ndarray:
    """Returns the pieces of the landscape's edge, as `_isolines`."""
    sides = (points[0], points[-1], points[:, 0], points[:, -1])
    return np.concatenate([np.stack([side[:-1], side[1:]], axis=1) for side in sides])


def smoothed(gray: np.ndarray, deviation: float) -> np.ndarray:
    """Convolves with a Gaussian cut at four standard deviations; the picture's edge is mirrored."""
    if deviation == 0:
        return gray
    reach = int(np.ceil(4 * deviation))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        padded = np.pad(gray, [(reach, reach) if axis == i else (0, 0) for i in (0, 1)], mode="symmetric")
        gray = np.apply_along_axis(np.convolve, axis, padded, kernel, mode="valid")
    return gray
