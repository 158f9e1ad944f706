"""The sweep: one image, many lenses, every metric for each; on request beside Table 1."""

from pathlib import Path
from typing import Literal

from pydantic import Field
from rich.console import Console

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.outcome import Outcome, progress_bar
from jaxlens.experiments.schema import Image, Lenses, Warp


class SweepExperiment(Experiment):
    """An image through many lenses, with every metric for each.

    Attributes:
        image: The undistorted image.
        lenses: The grid.
        warp: How it is sampled.
        memory_mb: What one step of the sweep may take, estimated, in megabytes. A step is never less than one lens.
        compare: Report beside the paper's Table 1.
    """

    image: Image
    lenses: Lenses
    warp: Warp = Warp()
    memory_mb: float = Field(default=256.0, gt=0)
    compare: Literal["table1"] | None = None

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out a sweep: a row of `table.csv` is a lens."""
        import numpy as np

        from jaxlens.experiments.sources import load_source
        from jaxlens.experiments.sweep.drawing import draw_metrics, draw_pictures
        from jaxlens.experiments.sweep.report import comparison, extremes
        from jaxlens.experiments.sweep.scoring import estimated_bytes, lanes_within, score_lenses
        from jaxlens.experiments.tables import kappa_columns, write_csv

        source = load_source(configuration, self.image)
        kappa = np.asarray(self.lenses.coefficients(), np.float64)
        with progress_bar(progress, self.name, len(kappa)) as advance:
            scores = score_lenses(
                source.pixels, kappa, peak=source.peak, warp=self.warp, memory_mb=self.memory_mb, advance=advance
            )
        write_csv(folder, kappa_columns(kappa) | scores)
        draw_pictures(source, kappa, scores, self, folder)
        draw_metrics(kappa, scores, self, folder)
        facts: dict[str, object] = {
            "lenses": len(kappa),
            "lanes": lanes_within(self.memory_mb, source.pixels),
            "estimated_mb_per_lens": round(estimated_bytes(source.pixels) / 1e6, 1),
        }
        if self.compare is not None:
            report = comparison(kappa, scores, peak=source.peak, title=self.heading)
        else:
            report = extremes(kappa, scores, title=self.heading)
        return Outcome([source.facts], facts, report)
