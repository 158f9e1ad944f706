"""The focal length that a rotating camera finds for itself, against the coefficient of its lens."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxlens.experiments.rotating import Biases
from jaxlens.figures.style import BLUE, FAINT, GREEN, MUTED, PALETTE, VERMILLION, WIDTH, new_figure, plain

_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# A millionth, in percent.
_MILLIONTH = 1e-4


def bias_chart(k: Sequence[float], found: Sequence[Biases], noise: float) -> Figure:
    """Draws the bias against the coefficient, and what is left of it once the lens is taken out.

    Args:
        k: Coefficients of the lenses; pincushion is positive.
        found: The biases, for each set of rotations.
        noise: Of the points that lenses were fitted to, in half diagonals.
    """
    figure = new_figure(WIDTH, 4.0)
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1))
    values = np.asarray(k)
    for one, color, marker in zip(found, PALETTE, _MARKERS, strict=False):
        bias = 100 * np.where(np.isfinite(one.raw), one.raw, np.nan)
        left.plot(values, bias, "-", marker=marker, color=color, markersize=4.5, linewidth=1.3, label=plain(one.name))
    for axes in (left, right):
        axes.axvline(0, color=MUTED, linewidth=0.8, zorder=0)
        axes.set_xlabel("k  [per squared half diagonal]")
        axes.xaxis.set_major_locator(MaxNLocator(5, symmetric=True))
        axes.grid(axis="y")
        axes.set_axisbelow(True)
    left.axhline(0, color=MUTED, linewidth=0.8, zorder=0)
    left.set_title("the lens in place", loc="left")
    left.set_ylabel("estimate / true focal length − 1  [%]")
    left.text(0.96, 0.27, "pincushion, k > 0:\ntoo short", transform=left.transAxes, ha="right", color=MUTED)
    left.text(0.48, 0.72, "barrel, k < 0:\ntoo long", transform=left.transAxes, ha="right", color=MUTED)
    right.set_yscale("log")
    right.set_title("before and after undistortion", loc="left")
    right.set_ylabel("|estimate / truth − 1|  [%]")
    raw = [np.where(np.isfinite(one.raw), np.abs(one.raw), np.nan) for one in found]
    _band(right, values, raw, VERMILLION, "the lens in place", above=False)
    _band(
        right,
        values,
        [one.fitted_rms for one in found],
        BLUE,
        f"undone by a fitted lens\n(points ± {noise:g}; RMS)",
        above=False,
    )
    _band(
        right,
        values,
        [np.maximum(np.abs(one.known), 1e-17) for one in found],
        GREEN,
        "undone by the lens itself",
        above=True,
    )
    right.axhspan(1e-20, _MILLIONTH, color=FAINT, alpha=0.45, linewidth=0, zorder=-1)
    right.text(
        0.97,
        0.6 * _MILLIONTH,
        "below one millionth",
        transform=right.get_yaxis_transform(),
        ha="right",
        va="top",
        color=MUTED,
        fontsize=8,
    )
    lowest = min(float(np.min(np.abs(one.known))) for one in found)
    right.set_ylim(max(20 * lowest, 1e-16), 1e3)
    handles, _ = left.get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 3), columnspacing=1.4)
    return figure


def _band(axes: Axes, k: np.ndarray, sets: Sequence[np.ndarray], color: str, label: str, *, above: bool) -> None:
    """The range over the sets of rotations, in percent, and their middle as a line with its name."""
    percent = 100 * np.stack(sets)
    low, high, middle = (np.nanmin(percent, axis=0), np.nanmax(percent, axis=0), np.nanmedian(percent, axis=0))
    axes.fill_between(k, low, high, color=color, alpha=0.3, linewidth=0)
    axes.plot(k, middle, "-o", color=color, markersize=4)
    place = np.nanmax(high) * 3 if above else np.nanmin(low) / 2.5
    axes.text(0.04, place, label, color=color, transform=axes.get_yaxis_transform(), va="bottom" if above else "top")
