"""Integral projections: beside the pictures that they are of, and how far they have moved."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxlens.experiments.projecting import AXES, Profile
from jaxlens.experiments.projecting import Axis as ProfileAxis
from jaxlens.figures.pictures import cell_aspect, place
from jaxlens.figures.style import (
    BLUE,
    FAINT,
    MUTED,
    ORANGE,
    VERMILLION,
    WIDTH,
    bare,
    new_figure,
    show_image,
)

_TITLE, _GAP, _MARGIN, _TICKS = 0.25, 0.14, 0.05, 0.5
# A profile's height, as a share of the picture's side.
_STRIP = 0.42
# Of a measured displacement from one element to the next, in pixels.
_JUMP = 2.0
_COLORS = (VERMILLION, BLUE, ORANGE)
_LABELS = {"x": "column x  [px]", "y": "row y  [px]"}


def projection_panel(
    initial: np.ndarray,
    peak: float,
    pictures: Mapping[float, np.ndarray],
    found: Mapping[float, Mapping[ProfileAxis, Profile]],
    names: Mapping[float, str],
) -> Figure:
    """Draws each picture with the means of its columns below it and those of its rows to its right.

    The initial picture's profiles lie in gray under those of the distorted ones.
    """
    aspect, columns = cell_aspect(initial), 1 + len(pictures)
    step = (WIDTH - 2 * _MARGIN - _TICKS) / columns
    side = (step - _GAP) / (1 + _STRIP)
    strip = side * _STRIP
    figure = new_figure(WIDTH, 2 * _MARGIN + _TITLE + side * aspect + 0.05 + strip, by_hand=True)
    top = _MARGIN + _TITLE
    first = next(iter(found.values()))
    shown: list[tuple[np.ndarray, str, Mapping[ProfileAxis, Profile] | None, str]] = [
        (initial, "initial", None, MUTED),
        *((pictures[k], names[k], found[k], color) for k, color in zip(pictures, _COLORS, strict=False)),
    ]
    drawn = [one for both in found.values() for one in both.values()]
    most = 1.06 * max(float(np.nanmax(line)) for one in drawn for line in (one.initial, one.distorted))
    for index, (picture, title, profile, color) in enumerate(shown):
        left = _MARGIN + _TICKS + index * step
        show_image(place(figure, left, top, side, side * aspect), picture, peak, title=title)
        below = place(figure, left, top + side * aspect + 0.05, side, strip)
        beside = place(figure, left + side + 0.05, top, strip, side * aspect)
        for axis, axes in zip(AXES, (below, beside), strict=True):
            at = np.arange(len(first[axis].initial))
            _line(axes, axis, at, first[axis].initial, color=MUTED if profile is None else "#A0A0A0", filled=True)
            if profile is not None:
                _line(axes, axis, at, profile[axis].distorted, color=color)
        below.set_xlim(-0.5, initial.shape[1] - 0.5)
        below.set_ylim(most, 0)
        beside.set_ylim(initial.shape[0] - 0.5, -0.5)
        beside.set_xlim(0, most)
        for axes, hidden in ((below, "top"), (beside, "left")):
            axes.spines[["top", "right", "bottom", "left"]].set_visible(False)
            axes.spines[hidden].set_visible(True)
            axes.set_xticks([])
            axes.set_yticks([])
        if index == 0:
            level = _round_level(most)
            below.set_yticks([0, level], ["0", f"{level:g}"])
            below.set_ylabel("gray levels", labelpad=2, fontsize=8.5)
            axes = place(figure, left + side + 0.05, top + side * aspect + 0.05, strip, strip)
            bare(axes)
            text = "means of\n↑ rows\n← columns"
            axes.text(0.1, 0.85, text, va="top", color=MUTED, fontsize=8, linespacing=1.3)
    return figure


def displacement_chart(found: Mapping[float, Mapping[ProfileAxis, Profile]], names: Mapping[float, str]) -> Figure:
    """Draws how far the profiles' features have moved, and how far the lens should have moved them."""
    figure = new_figure(WIDTH, 3.1)
    expected = Line2D([], [], color=MUTED, linewidth=1.2, linestyle=(0, (4, 2)), label="expected of the lens")
    for axis, axes in zip(AXES, figure.subplots(1, 2, sharey=True), strict=True):
        for (k, both), color in zip(found.items(), _COLORS, strict=False):
            profile = both[axis]
            at = np.arange(len(profile.initial))
            axes.plot(at, profile.expected, color=color, linewidth=1.2, linestyle=(0, (4, 2)))
            # A jump between neighbours is another match, not a path.
            broken = np.diff(profile.measured, prepend=np.nan)
            line = np.where(np.abs(broken) > _JUMP, np.nan, profile.measured)
            axes.plot(at, line, color=color, linewidth=2, label=names[k])
        axes.set_xlabel(_LABELS[axis])
        axes.set_title("means of columns, along x" if axis == "x" else "means of rows, along y", loc="left")
        axes.set_xlim(0, len(next(iter(found.values()))[axis].initial) - 1)
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        if axis == "x":
            axes.set_ylabel("displacement  [px]")
            handles = [*axes.get_legend_handles_labels()[0], expected]
            figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _line(
    axes: Axes, axis: ProfileAxis, at: np.ndarray, values: np.ndarray, *, color: str, filled: bool = False
) -> None:
    if filled and axis == "x":
        axes.fill_between(at, values, color=FAINT, linewidth=0)
    elif filled:
        axes.fill_betweenx(at, values, color=FAINT, linewidth=0)
    pair = (at, values) if axis == "x" else (values, at)
    axes.plot(*pair, color=color, linewidth=0.9 if filled else 1.4)


def _round_level(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is below a number."""
    power = 10 ** np.floor(np.log10(max(most, 1e-12)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= most))
