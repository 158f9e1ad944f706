"""Three readings of Eq. 11: their distances to Table 1, their PSNR, their pictures."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from jaxlens.experiments import paper
from jaxlens.experiments.readings import READINGS, Reading
from jaxlens.figures.pictures import deformed_panel
from jaxlens.figures.style import (
    BLACK,
    BLUE,
    FAINT,
    GREEN,
    ORANGE,
    WIDTH,
    kappa_label,
    new_figure,
    pair_label,
    plain,
)

_MARKS: dict[Reading, tuple[str, str]] = {
    "functional inverse": (BLUE, "o"),
    "reciprocal": (ORANGE, "s"),
    "direct": (GREEN, "^"),
}
_LIFTS: dict[Reading, float] = {"functional inverse": 0.22, "reciprocal": 0.0, "direct": -0.22}
_FORMULAS: dict[Reading, str] = {
    "functional inverse": "functional inverse: solve ρ Φ(ρ²) = r",
    "reciprocal": "reciprocal: 1 / Φ(r²)",
    "direct": "direct: Φ(r²)",
}


def distance_chart(labels: Sequence[str], distances: Mapping[Reading, Sequence[float]]) -> Figure:
    """Draws how far each reading's PSNR column lies from Table 1's: a row an image, the nearest reading filled."""
    figure = new_figure(WIDTH, 1.2 + 0.42 * len(labels))
    axes = figure.subplots()
    columns = np.array([distances[reading] for reading in READINGS])
    positions = np.arange(len(labels))[::-1]
    for position in positions[:-1] - 0.5:
        axes.axhline(position, color=FAINT, linewidth=0.7, zorder=1)
    nearest = columns.argmin(axis=0)
    for index, reading in enumerate(READINGS):
        color, marker = _MARKS[reading]
        best = nearest == index
        for chosen, face in ((best, color), (~best, "white")):
            axes.plot(
                columns[index][chosen],
                # Side by side, for they often nearly coincide.
                positions[chosen] + _LIFTS[reading],
                marker,
                color=color,
                markerfacecolor=face,
                markersize=7,
                markeredgewidth=1.5,
                zorder=2,
            )
        axes.plot([], [], marker, color=color, markersize=7, label=_FORMULAS[reading])
    axes.set_yticks(positions, [plain(label) for label in labels], color=BLACK)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_xlim(left=0)
    axes.set_ylim(-0.5, len(labels) - 0.5)
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    axes.set_xlabel("root of mean square distance of PSNR to Table 1  [dB];  filled: the nearest")
    figure.legend(loc="outside upper center", ncols=len(READINGS), columnspacing=1.2, handletextpad=0.2)
    return figure


def psnr_chart(psnr: Mapping[str, Mapping[Reading, np.ndarray]]) -> Figure:
    """Draws PSNR of the six lenses under each reading, an image a panel, with the paper's."""
    columns = min(3, len(psnr))
    rows = -(-len(psnr) // columns)
    figure = new_figure(WIDTH, 0.75 + 1.9 * rows)
    places = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    positions = np.arange(len(paper.TABLE_1))
    for index, axes in enumerate(places.flat):
        if index >= len(psnr):
            axes.set_visible(False)
            continue
        label = list(psnr)[index]
        axes.set_title(plain(label), loc="left", fontsize=9.5)
        for reading in READINGS:
            color, marker = _MARKS[reading]
            axes.plot(
                positions, psnr[label][reading], "-" + marker, color=color, markersize=5, linewidth=1.2, label=reading
            )
        theirs = [row.psnr for row in paper.TABLE_1]
        axes.plot(positions, theirs, "D", color=BLACK, markerfacecolor="none", markersize=7, label="paper")
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        if index + columns >= len(psnr):
            axes.set_xlabel("κ₁, κ₂")
            axes.set_xticks(positions, [pair_label(row.kappa).replace(" ", "") for row in paper.TABLE_1])
            axes.tick_params(axis="x", labelbottom=True)
        if index % columns == 0:
            axes.set_ylabel("PSNR  [dB]")
    handles, labels = places.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def reading_panel(initial: np.ndarray, pictures: Sequence[np.ndarray], kappa: np.ndarray, peak: float) -> Figure:
    """Draws an image and what each reading makes of it under one lens."""
    titles = ["functional inverse", "reciprocal 1/Φ", "direct Φ"]
    return deformed_panel(initial, pictures, titles, [kappa_label(kappa)] * len(pictures), peak, rows=1)
