"""Line grids: three ways to write a lens from left to right, a coefficient a row."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jaxlens.experiments.linegrids import HALF, SETTINGS, Setting
from jaxlens.figures.pictures import place
from jaxlens.figures.style import BLUE, FAINT, MUTED, WIDTH, bare, new_figure, show_image

_HEAD, _NOTE, _GAP, _MARGIN = 0.55, 0.27, 0.14, 0.05
_HEADINGS: dict[Setting, tuple[str, str]] = {
    "lens": ("a lens: ideal → observed", r"$x_d = x_u\,(1 + k\,|x_u|^2)$"),
    "section 2.4": (
        "Section 2.4: output → source",
        r"$x_{\mathrm{source}} = x_{\mathrm{out}}\,(1 + k\,|x_{\mathrm{out}}|^2)$",
    ),
    "division": ("division model (Eq. 5)", r"$x_u = x_d\,/\,(1 - k\,|x_d|^2)$"),
}


def curve_panel(
    curves: Mapping[tuple[Setting, float], Sequence[np.ndarray]],
    names: Mapping[tuple[Setting, float], str],
    k: Sequence[float],
    lines: int,
) -> Figure:
    """Draws the grid's lines in the output, over the straight grid, cut at the output's frame."""
    figure, places = _panel(k, names)
    at = np.linspace(-HALF, HALF, lines)
    straight = [[(one, -HALF), (one, HALF)] for one in at] + [[(-HALF, one), (HALF, one)] for one in at]
    for key, axes in places.items():
        frame = Rectangle((-HALF, -HALF), 2 * HALF, 2 * HALF, fill=False, edgecolor=MUTED, linewidth=0.8, clip_on=False)
        axes.add_collection(LineCollection(straight, colors=FAINT, linewidths=0.7))
        axes.add_collection(LineCollection(list(curves[key]), colors=BLUE, linewidths=1.1))
        axes.add_patch(frame)
        axes.set_xlim(-HALF, HALF)
        axes.set_ylim(HALF, -HALF)
        axes.set_aspect("equal")
    return figure


def picture_panel(
    pictures: Mapping[tuple[Setting, float], np.ndarray],
    names: Mapping[tuple[Setting, float], str],
    k: Sequence[float],
) -> Figure:
    """Draws pictures of the grid through the lenses."""
    figure, places = _panel(k, names)
    for key, axes in places.items():
        show_image(axes, pictures[key], 1.0)
    return figure


def _panel(
    k: Sequence[float], names: Mapping[tuple[Setting, float], str]
) -> tuple[Figure, dict[tuple[Setting, float], Axes]]:
    """An empty panel with its headings above and, below each place, k and what it makes of straight lines."""
    side = (WIDTH - 2 * _MARGIN - (len(SETTINGS) - 1) * _GAP) / len(SETTINGS)
    figure = new_figure(WIDTH, _MARGIN + _HEAD + len(k) * (side + _NOTE + _GAP) - _GAP, by_hand=True)
    places: dict[tuple[Setting, float], Axes] = {}
    for column, setting in enumerate(SETTINGS):
        left = _MARGIN + column * (side + _GAP)
        for row, value in enumerate(k):
            axes = place(figure, left, _MARGIN + _HEAD + row * (side + _NOTE + _GAP), side, side)
            bare(axes)
            sign = f"{value:+g}".replace("-", "−")
            axes.set_xlabel(f"k = {sign}: {names[setting, value]}", labelpad=4)
            places[setting, value] = axes
        title, formula = _HEADINGS[setting]
        figure.text(
            (left + side / 2) / WIDTH,
            1 - _MARGIN / figure.get_size_inches()[1],
            f"{title}\n{formula}",
            ha="center",
            va="top",
            linespacing=1.5,
        )
    return figure, places
