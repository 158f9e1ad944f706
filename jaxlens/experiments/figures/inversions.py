"""Recovered lenses: their errors beside what the fits predicted."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from jaxlens.experiments.figures.style import MUTED, PALETTE, WIDTH, kappa_label, new_figure
from jaxlens.experiments.inverting import Recovery

_TITLES = {"points": "from points", "pictures": "from a pair of pictures"}


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
            for color, kappa in zip(PALETTE, kappas, strict=False):
                rows = [one for one in found if one.method == method and one.kappa == kappa and one.noise > 0]
                noise = np.array([one.noise for one in rows])
                axes.plot(noise, [one.predicted[index] for one in rows], "-", color=color, linewidth=1.2)
                axes.plot(noise, [one.errors[index] for one in rows], "o", color=color, markersize=5)
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
            axes.set_ylabel("error")
        units = [one.unit for one in found if one.method == method]
        places[-1, column].set_xlabel(f"noise [{units[0]}]")
    handles = [
        Line2D([], [], color=color, marker="o", markersize=5, label=kappa_label(kappa))
        for color, kappa in zip(PALETTE, kappas, strict=False)
    ]
    handles += [
        Line2D([], [], color=MUTED, linestyle="none", marker="o", markersize=5, label="RMS error found"),
        Line2D([], [], color=MUTED, label="standard error predicted"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, columnspacing=1.2)
    return figure
