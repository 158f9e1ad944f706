"""Figure 6: an image, what lenses make of it, and how many of its pixels land on several."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from pydantic import Field
from rich.console import Console

from jaxlens.diagnostics import multiplicity
from jaxlens.experiments.config import Configuration
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.outcome import Outcome, progress_bar
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import Image, Kappa, Warp
from jaxlens.experiments.sources import load_source
from jaxlens.experiments.sweep.scoring import deform_all
from jaxlens.experiments.tables import kappa_columns, write_csv
from jaxlens.figures.multiplicities import multiplicity_panel
from jaxlens.figures.style import save
from jaxlens.lenses import RadialPolynomial
from jaxlens.warping import distortion_map


class PanelsExperiment(Experiment):
    """One image and what lenses make of it, with the count of its pixels that land on several: Figure 6.

    Attributes:
        image: The undistorted image.
        kappa: The lenses.
        warp: How it is sampled.
    """

    image: Image
    kappa: list[Kappa] = Field(min_length=1, max_length=11)
    warp: Warp = Warp()

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_panels(configuration, self, folder, progress)


def perform_panels(
    configuration: Configuration, experiment: PanelsExperiment, folder: Path, progress: Console
) -> Outcome:
    """Carries out the experiment."""
    source = load_source(configuration, experiment.image)
    kappa = np.asarray(experiment.kappa, np.float64)
    height, width = source.pixels.shape[:2]
    pictures = deform_all(source.pixels, kappa, experiment.warp)
    counts = []
    with progress_bar(progress, experiment.name, len(kappa)) as advance:
        for one in kappa:
            lens = RadialPolynomial(jnp.asarray(one, source.pixels.dtype))
            counts.append(np.asarray(multiplicity(distortion_map(lens, height, width), height, width)))
            advance(1)
    columns: dict[str, np.ndarray] = {
        "source_pixels": np.array([count.size for count in counts]),
        "not_shown": np.array([np.sum(count == 0) for count in counts]),
        "shown_once": np.array([np.sum(count == 1) for count in counts]),
        "multiple_positions": np.array([np.sum(count > 1) for count in counts]),
        "most_positions": np.array([count.max() for count in counts]),
    }
    write_csv(folder, kappa_columns(kappa) | columns)
    save(multiplicity_panel(source.pixels, pictures, counts, kappa, source.peak), folder, "panels")
    rows = [
        [", ".join(f"{value:g}" for value in one)]
        + [f"{int(column[index]):,}".replace(",", " ") for column in columns.values()]
        for index, one in enumerate(kappa)
    ]
    title = experiment.title or experiment.name
    report = plain_table(title, ["κ", *(name.replace("_", "\n") for name in columns)], rows)
    return Outcome([source.facts], {}, [report])
