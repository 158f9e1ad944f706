"""Three readings of Eq. 11 against Table 1, over several images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator
from rich.console import Console, RenderableType
from rich.text import Text

from jaxlens import experiments, figures
from jaxlens.experiments import (
    READINGS,
    Configuration,
    Experiment,
    Image,
    Outcome,
    Reading,
    Source,
    Value,
    Warp,
    load_source,
    new_table,
    paper,
    progress_bar,
    write_rows,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KAPPA = np.array([row.kappa for row in paper.TABLE_1])
_SCORES = (*paper.METRICS, "coverage")
# The lens whose pictures are shown.
_SHOWN = 1
_MARKS: dict[Reading, tuple[str, str]] = {
    "functional inverse": (figures.BLUE, "o"),
    "reciprocal": (figures.ORANGE, "s"),
    "direct": (figures.GREEN, "^"),
}
_LIFTS: dict[Reading, float] = {"functional inverse": 0.22, "reciprocal": 0.0, "direct": -0.22}
_FORMULAS: dict[Reading, str] = {
    "functional inverse": "functional inverse: solve ρ Φ(ρ²) = r",
    "reciprocal": "reciprocal: 1 / Φ(r²)",
    "direct": "direct: Φ(r²)",
}

Psnr = dict[str, dict[Reading, np.ndarray]]


class ReadingsExperiment(Experiment):
    """The three readings of Eq. 11 against Table 1, over several images.

    Attributes:
        images: The images, each with a peak.
        warp: How they are sampled.
        memory_mb: As in a sweep.
    """

    images: list[Image] = Field(min_length=1)
    warp: Warp = Warp()
    memory_mb: float = Field(default=256.0, gt=0)

    @model_validator(mode="after")
    def _check(self) -> ReadingsExperiment:
        labels = [image.label for image in self.images]
        if len(set(labels)) < len(labels):
            raise ValueError("'images' must have different names; give each a 'name'")
        return self

    def with_picture(self, path: str) -> ReadingsExperiment:
        """As the base class says, in place of all images."""
        return self.model_copy(update={"images": [self.images[0].replaced_by(path)]})

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: `table.csv` has the distances to Table 1, `scores.csv` what they come from."""
        sources = [load_source(configuration, image) for image in self.images]
        psnr: Psnr = {source.label: {} for source in sources}
        scores: list[tuple[Value, ...]] = []
        table: list[tuple[str, Reading, float, float]] = []
        with progress_bar(progress, self.name, len(sources) * len(READINGS)) as advance:
            for source in sources:
                for reading in READINGS:
                    found = experiments.score_lenses(
                        source.pixels,
                        _KAPPA,
                        peak=source.peak,
                        warp=self.warp,
                        reading=reading,
                        memory_mb=self.memory_mb,
                    )
                    advance(1)
                    psnr[source.label][reading] = found["psnr"]
                    values = zip(*(found[name] for name in _SCORES), strict=True)
                    for kappa, row in zip(_KAPPA, values, strict=True):
                        scores.append((source.label, reading, *kappa, *row))
                    snr = paper.distance(list(found["snr"]), [row.snr for row in paper.TABLE_1])
                    table.append((source.label, reading, _distance(found["psnr"]), snr))
        write_rows(folder, ("image", "reading", "psnr_distance", "snr_distance"), table)
        write_rows(folder, ("image", "reading", "kappa1", "kappa2", *_SCORES), scores, "scores.csv")
        distances: dict[Reading, list[float]] = {
            reading: [_distance(psnr[source.label][reading]) for source in sources] for reading in READINGS
        }
        labels = [source.label for source in sources]
        figures.save(distance_chart(labels, distances), folder / "distances.svg")
        figures.save(psnr_chart(psnr), folder / "psnr.svg")
        figures.save(_pictures(sources[0], self), folder / "pictures.jpg")
        return Outcome([source.facts for source in sources], {}, _report(self.heading, labels, psnr, table))


def _distance(psnr: np.ndarray) -> float:
    return paper.distance(list(psnr), [row.psnr for row in paper.TABLE_1])


def _pictures(source: Source, experiment: ReadingsExperiment) -> Figure:
    pictures = [
        experiments.deform_all(source.pixels, _KAPPA[_SHOWN : _SHOWN + 1], experiment.warp, reading)[0]
        for reading in READINGS
    ]
    return reading_panel(source.pixels, pictures, _KAPPA[_SHOWN], source.peak)


def _report(
    title: str, labels: list[str], psnr: Psnr, table: list[tuple[str, Reading, float, float]]
) -> list[RenderableType]:
    shown = new_table(title)
    shown.add_column("distance to Table 1, dB\nPSNR (SNR)")
    for reading in READINGS:
        shown.add_column(reading, justify="right")
    pairs = {(image, reading): (a, b) for image, reading, a, b in table}
    nearest = []
    for label in labels:
        row = [pairs[label, reading] for reading in READINGS]
        best = int(np.argmin([pair[0] for pair in row]))
        nearest.append(READINGS[best])
        cells = [f"{a:.3f} ({b:.3f})" for a, b in row]
        shown.add_row(Text(label), *(Text(cell, "bold" if index == best else "") for index, cell in enumerate(cells)))
    rows = new_table(f"PSNR in dB on {labels[0]}")
    rows.add_column("reading of Φ⁻¹(r²)")
    for row in paper.TABLE_1:
        rows.add_column(", ".join(f"{value:g}" for value in row.kappa), justify="right")
    for reading in READINGS:
        rows.add_row(reading, *(f"{value:.2f}" for value in psnr[labels[0]][reading]))
    rows.add_row("the paper", *(f"{row.psnr:.2f}" for row in paper.TABLE_1))
    wins = ", ".join(f"{reading}: {nearest.count(reading)}" for reading in READINGS)
    return [rows, shown, Text(f"Nearest to the paper's PSNR column, of {len(labels)} images: {wins}.")]


def distance_chart(labels: Sequence[str], distances: Mapping[Reading, Sequence[float]]) -> Figure:
    """Draws how far each reading's PSNR column lies from Table 1's: a row an image, the nearest reading filled."""
    figure = figures.new_figure(figures.WIDTH, 1.2 + 0.42 * len(labels))
    axes = figure.subplots()
    columns = np.array([distances[reading] for reading in READINGS])
    positions = np.arange(len(labels))[::-1]
    for position in positions[:-1] - 0.5:
        axes.axhline(position, color=figures.FAINT, linewidth=0.7, zorder=1)
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
    axes.set_yticks(positions, [figures.plain(label) for label in labels], color=figures.BLACK)
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
    figure = figures.new_figure(figures.WIDTH, 0.75 + 1.9 * rows)
    places = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    positions = np.arange(len(paper.TABLE_1))
    for index, axes in enumerate(places.flat):
        if index >= len(psnr):
            axes.set_visible(False)
            continue
        label = list(psnr)[index]
        axes.set_title(figures.plain(label), loc="left", fontsize=9.5)
        for reading in READINGS:
            color, marker = _MARKS[reading]
            axes.plot(
                positions, psnr[label][reading], "-" + marker, color=color, markersize=5, linewidth=1.2, label=reading
            )
        theirs = [row.psnr for row in paper.TABLE_1]
        axes.plot(positions, theirs, "D", color=figures.BLACK, markerfacecolor="none", markersize=7, label="paper")
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        if index + columns >= len(psnr):
            axes.set_xlabel("κ₁, κ₂")
            axes.set_xticks(positions, [figures.pair_label(row.kappa).replace(" ", "") for row in paper.TABLE_1])
            axes.tick_params(axis="x", labelbottom=True)
        if index % columns == 0:
            axes.set_ylabel("PSNR  [dB]")
    handles, labels = places.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def reading_panel(initial: np.ndarray, pictures: Sequence[np.ndarray], kappa: np.ndarray, peak: float) -> Figure:
    """Draws an image and what each reading makes of it under one lens."""
    titles = ["functional inverse", "reciprocal 1/Φ", "direct Φ"]
    return figures.deformed_panel(initial, pictures, titles, [figures.kappa_label(kappa)] * len(pictures), peak, rows=1)
