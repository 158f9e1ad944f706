"""Recovered lenses: their errors beside what the fits predicted."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from jaxlens.experiments.inverting import Recovery
from jaxlens.experiments.noises import chi_square_above
from jaxlens.figures.style import MUTED, PALETTE, WIDTH, kappa_label, new_figure

_TITLES = {"points": "from points", "pictures": "from a pair of pictures"}
# From one lens to the next, the factor on the noise at which it is drawn.
_APART = 1.05


def chance(fits: int) -> tuple[float, float]:
    """Returns the ends of the 95 % interval of a standard error, over the RMS of so many independent normal errors."""
    ratio = np.geomspace(0.01, 10, 4001)
    # The sum of squared errors over the variance is distributed as χ².
    above = chi_square_above(fits / ratio**2, fits)
    low, high = np.interp([0.025, 0.975], above, ratio)
    return float(low), float(high)


def error_chart(found: Sequence[Recovery]) -> Figure:
    """Draws the errors of each coefficient against the noise, with the predicted standard errors as lines."""
    methods = [method for method in _TITLES if any(one.method == method for one in found)]
    kappas = list(dict.fromkeys(one.kappa for one in found))
    order = len(kappas[0])
    figure = new_figure(WIDTH, 0.9 + 2.5 * order)
    places = figure.subplots(order, len(methods), squeeze=False, sharex="col")
    for column, method in enumerate(methods):
        for index in range(order):
            axes = places[index, column]
            for place, (color, kappa) in enumerate(zip(PALETTE, kappas, strict=False)):
                rows = [one for one in found if one.method == method and one.kappa == kappa and one.noise > 0]
                # A little apart, so that no interval hides another.
                noise = np.array([one.noise for one in rows]) * _APART ** (place - 0.5 * (len(kappas) - 1))
                axes.plot(noise, [one.predicted[index] for one in rows], "-", color=color, linewidth=1.2)
                errors = np.array([one.errors[index] for one in rows])
                low, high = (errors * factor for factor in chance(rows[0].fits)) if rows else (errors, errors)
                axes.errorbar(
                    noise, errors, (errors - low, high - errors), fmt="o", color=color, markersize=5, elinewidth=0.9
                )
            levels = sorted({one.noise for one in found if one.method == method and one.noise > 0})
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xticks(levels, [f"{level:g}" for level in levels])
            axes.xaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.1g}"))
            axes.grid(axis="y")
            axes.set_title(f"κ{'₁₂₃₄₅₆₇₈'[index]}, {_TITLES[method]}", loc="left")
            axes.set_ylabel(f"error of κ{'₁₂₃₄₅₆₇₈'[index]}")
        units = [one.unit for one in found if one.method == method]
        places[-1, column].set_xlabel(f"noise [{units[0]}]")
    handles = [
        Line2D([], [], color=color, marker="o", markersize=5, label=kappa_label(kappa))
        for color, kappa in zip(PALETTE, kappas, strict=False)
    ]
    handles += [
        Line2D([], [], color=MUTED, linestyle="none", marker="o", markersize=5, label="RMS error found, 95 % interval"),
        Line2D([], [], color=MUTED, label="standard error predicted"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, columnspacing=1.2)
    return figure
