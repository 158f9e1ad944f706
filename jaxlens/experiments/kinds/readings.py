"""Three readings of Eq. 11 against Table 1, over several images."""

from pathlib import Path

import numpy as np
from pydantic import Field, model_validator
from rich.console import Console, RenderableType
from rich.text import Text

from jaxlens.experiments import paper
from jaxlens.experiments.config import Configuration
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.outcome import Outcome, progress_bar
from jaxlens.experiments.readings import READINGS, Reading
from jaxlens.experiments.reports import new_table
from jaxlens.experiments.schema import Image, Warp
from jaxlens.experiments.sources import Source, load_source
from jaxlens.experiments.sweep.scoring import deform_all, score_lenses
from jaxlens.experiments.tables import Value, write_csv
from jaxlens.figures.readings import distance_chart, psnr_chart, reading_panel
from jaxlens.figures.style import save


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
    def _check(self) -> "ReadingsExperiment":
        labels = [image.label for image in self.images]
        if len(set(labels)) < len(labels):
            raise ValueError("'images' must have different names; give each a 'name'")
        return self

    def with_picture(self, path: str) -> "ReadingsExperiment":
        """As the base class says, in place of all images."""
        return self.model_copy(update={"images": [self.images[0].replaced_by(path)]})

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_readings(configuration, self, folder, progress)


_KAPPA = np.array([row.kappa for row in paper.TABLE_1])
# The lens whose pictures are shown.
_SHOWN = 1

Psnr = dict[str, dict[Reading, np.ndarray]]


def perform_readings(
    configuration: Configuration, experiment: ReadingsExperiment, folder: Path, progress: Console
) -> Outcome:
    """Carries out the experiment: `table.csv` has the distances to Table 1, `scores.csv` what they come from."""
    sources = [load_source(configuration, image) for image in experiment.images]
    psnr: Psnr = {source.label: {} for source in sources}
    scores: dict[str, list[Value]] = {
        name: [] for name in ("image", "reading", "kappa1", "kappa2", *paper.METRICS, "coverage")
    }
    table: dict[str, list[Value]] = {name: [] for name in ("image", "reading", "psnr_distance", "snr_distance")}
    with progress_bar(progress, experiment.name, len(sources) * len(READINGS)) as advance:
        for source in sources:
            for reading in READINGS:
                found = score_lenses(
                    source.pixels,
                    _KAPPA,
                    peak=source.peak,
                    warp=experiment.warp,
                    reading=reading,
                    memory_mb=experiment.memory_mb,
                )
                advance(1)
                psnr[source.label][reading] = found["psnr"]
                _extend(scores, source.label, reading, found)
                for name, value in zip(table, (source.label, reading, *_distances(found)), strict=True):
                    table[name].append(value)
    write_csv(folder, table)
    write_csv(folder, scores, "scores.csv")
    distances: dict[Reading, list[float]] = {
        reading: [_distance(psnr[source.label][reading]) for source in sources] for reading in READINGS
    }
    labels = [source.label for source in sources]
    save(distance_chart(labels, distances), folder, "distances", vector=True)
    save(psnr_chart(psnr), folder, "psnr", vector=True)
    save(_pictures(sources[0], experiment), folder, "pictures")
    title = experiment.title or experiment.name
    return Outcome([source.facts for source in sources], {}, _report(title, labels, psnr, table))


def _extend(scores: dict[str, list[Value]], label: str, reading: Reading, found: dict[str, np.ndarray]) -> None:
    for index, (kappa1, kappa2) in enumerate(_KAPPA):
        values = (label, reading, kappa1, kappa2, *(found[name][index] for name in (*paper.METRICS, "coverage")))
        for name, value in zip(scores, values, strict=True):
            scores[name].append(value)


def _distances(found: dict[str, np.ndarray]) -> tuple[float, float]:
    return _distance(found["psnr"]), paper.distance(list(found["snr"]), [row.snr for row in paper.TABLE_1])


def _distance(psnr: np.ndarray) -> float:
    return paper.distance(list(psnr), [row.psnr for row in paper.TABLE_1])


def _pictures(source: Source, experiment: ReadingsExperiment):
    pictures = [
        deform_all(source.pixels, _KAPPA[_SHOWN : _SHOWN + 1], experiment.warp, reading)[0] for reading in READINGS
    ]
    return reading_panel(source.pixels, pictures, _KAPPA[_SHOWN], source.peak)


def _report(title: str, labels: list[str], psnr: Psnr, table: dict[str, list[Value]]) -> list[RenderableType]:
    shown = new_table(title)
    shown.add_column("distance to Table 1, dB\nPSNR (SNR)")
    for reading in READINGS:
        shown.add_column(reading, justify="right")
    pairs = {(image, reading): (float(a), float(b)) for image, reading, a, b in zip(*table.values(), strict=True)}
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
