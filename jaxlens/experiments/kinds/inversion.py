"""Lenses recovered from points and from pictures, their errors beside the predicted standard errors."""

from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
from pydantic import Field, model_validator
from rich.console import Console, RenderableType

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.inverting import Recovery, from_pictures, from_points
from jaxlens.experiments.outcome import Outcome, progress_bar
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import Image, Kappa
from jaxlens.experiments.sources import load_source
from jaxlens.experiments.tables import write_csv
from jaxlens.figures.inversions import error_chart
from jaxlens.figures.style import save

Noise = Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]


class InversionExperiment(Experiment):
    """Lenses recovered from what they did: from points, and from pairs of pictures, under noise.

    Attributes:
        image: The undistorted image.
        kappa: The lenses, all of the same order.
        picture_noise: Standard deviations of the noise of gray values, as shares of the peak.
        picture_seeds: Distorted pictures of each lens and noise level.
        gain: Of the distorted picture's gray values, unknown to the fit.
        offset: Likewise, as a share of the peak.
        point_noise: Standard deviations of the noise of a coordinate, in pixels.
        point_seeds: Sets of points of each lens and noise level.
        points: In a set, spread evenly over the distorted picture.
    """

    image: Image
    kappa: list[Kappa] = Field(min_length=1, max_length=7)
    picture_noise: Noise
    picture_seeds: int = Field(default=5, ge=2, le=1000)
    gain: float = Field(default=0.9, gt=0)
    offset: float = 0.05
    point_noise: Noise
    point_seeds: int = Field(default=200, ge=2, le=10000)
    points: int = Field(default=200, ge=4, le=100_000)

    @model_validator(mode="after")
    def _check(self) -> "InversionExperiment":
        if len({len(one) for one in self.kappa}) > 1:
            raise ValueError("'kappa' must hold vectors of one length")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_inversion(configuration, self, folder, progress)


def perform_inversion(
    configuration: Configuration, experiment: InversionExperiment, folder: Path, progress: Console
) -> Outcome:
    """Carries out the experiment: a row of `table.csv` is a lens, what it was recovered from, and a noise level."""
    source = load_source(configuration, experiment.image)
    pixels = source.pixels if source.pixels.ndim == 2 else source.pixels.mean(axis=-1)
    found: list[Recovery] = []
    levels = len(experiment.point_noise) + len(experiment.picture_noise)
    with progress_bar(progress, experiment.name, len(experiment.kappa) * levels) as advance:
        for index, kappa in enumerate(experiment.kappa):
            key = jax.random.fold_in(jax.random.key(experiment.seed), index)
            truth = jnp.asarray(kappa, pixels.dtype)
            for noise in experiment.point_noise:
                found.append(
                    from_points(truth, noise, key, *pixels.shape, count=experiment.points, seeds=experiment.point_seeds)
                )
                advance(1)
            for noise in experiment.picture_noise:
                found.append(
                    from_pictures(
                        truth,
                        noise,
                        key,
                        pixels,
                        peak=source.peak,
                        gain=experiment.gain,
                        offset=experiment.offset,
                        seeds=experiment.picture_seeds,
                    )
                )
                advance(1)
    write_csv(folder, _columns(found))
    save(error_chart(found), folder, "errors", vector=True)
    return Outcome([source.facts], {"failed_fits": sum(one.failed for one in found)}, _report(experiment, found))


def _columns(found: list[Recovery]) -> dict[str, list]:
    order = len(found[0].kappa)
    columns: dict[str, list] = {
        "from": [one.method for one in found],
        **{f"kappa{i + 1}": [one.kappa[i] for one in found] for i in range(order)},
        "noise": [one.noise for one in found],
        "unit": [one.unit for one in found],
        "fits": [one.fits for one in found],
        "failed": [one.failed for one in found],
    }
    for i in range(order):
        columns[f"rms_error{i + 1}"] = [one.errors[i] for one in found]
        columns[f"predicted{i + 1}"] = [one.predicted[i] for one in found]
    return columns


def _report(experiment: InversionExperiment, found: list[Recovery]) -> list[RenderableType]:
    order = len(found[0].kappa)
    header = ["from", "κ", "noise", *(f"κ{i + 1}: RMS error\n(of predicted)" for i in range(order))]
    rows = []
    for one in found:
        row = [one.method, ", ".join(f"{value:g}" for value in one.kappa), f"{one.noise:g} {one.unit}"]
        for error, predicted in zip(one.errors, one.predicted, strict=True):
            noisy = one.noise > 0 and predicted > 0
            row.append(f"{error:.2g} ({error / predicted:.2f})" if noisy else f"{error:.2g}")
        rows.append(row)
    return [plain_table(experiment.title or experiment.name, header, rows)]
