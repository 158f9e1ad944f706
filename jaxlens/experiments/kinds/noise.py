"""Figure 7: noise that is the same over the entire image, a lens's errors that are not, and what MSE sees of either."""

from pathlib import Path

import jax
import numpy as np
from pydantic import Field
from rich.console import Console, RenderableType

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.errors import ConfigError
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.noises import Spread, arrangements, scores, spread_of
from jaxlens.experiments.outcome import Outcome
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import Image, Kappa, Warp
from jaxlens.experiments.sources import Source, load_source
from jaxlens.experiments.sweep.scoring import deform_all
from jaxlens.experiments.tables import Value, write_csv
from jaxlens.figures.noises import arrangement_panel, noise_panel, spread_chart
from jaxlens.figures.style import kappa_label, save


class NoiseExperiment(Experiment):
    """Noise that is the same over the entire image, and what MSE does not see of errors: Figure 7.

    Attributes:
        image: The image.
        other: The picture that the same errors are added to; scaled to the image's size.
        noise: Standard deviation of the noise, as a share of the peak; by default that of the root of the mean square
            of the lens's errors.
        kappa: The lens whose errors stand beside the noise.
        block: Side of the blocks in which the errors' spread is measured, in pixels.
        warp: How the image is sampled.
    """

    image: Image
    other: Image
    noise: float | None = Field(default=None, gt=0)
    kappa: Kappa
    block: int = Field(default=16, ge=2)
    warp: Warp = Warp()

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_noise(configuration, self, folder)


# The smallest picture that holds a window of SSIM.
_LEAST = 11
_BLOCKS = (
    "errors",
    "deviation",
    "block_px",
    "blocks",
    "least",
    "greatest",
    "low",
    "high",
    "inside",
    "excess",
    "bartlett",
    "p_value",
)


def perform_noise(configuration: Configuration, experiment: NoiseExperiment, folder: Path) -> Outcome:
    """Carries out the experiment: `table.csv` has the measures of each arrangement, `blocks.csv` the local spreads.

    Raises:
        ConfigError: the image is too small for blocks, or for SSIM.
    """
    source, other_source = (load_source(configuration, image) for image in (experiment.image, experiment.other))
    pixels = _gray(source)
    shorter = min(pixels.shape)
    if shorter < max(_LEAST, 2 * experiment.block):
        raise ConfigError(
            f"{configuration.path}: block: got {experiment.block}; the image, of {pixels.shape[0]} rows and "
            f"{pixels.shape[1]} columns, must hold two such blocks along each side, and {_LEAST} pixels"
        )
    other = _gray(other_source)
    if other.shape != pixels.shape:
        other = np.asarray(jax.image.resize(other, pixels.shape, "linear"))
    kappa = np.asarray([experiment.kappa], np.float64)
    through = deform_all(pixels, kappa, experiment.warp)[0] - pixels
    share = experiment.noise
    deviation = float(np.sqrt(np.mean(through**2))) if share is None else share * source.peak
    noise = deviation * np.random.default_rng(experiment.seed).standard_normal(pixels.shape)
    errors = {"noise": noise.astype(pixels.dtype), "lens": through}
    spreads = {name: spread_of(one, experiment.block) for name, one in errors.items()}
    names = {"noise": f"noise, σ = {deviation:.1f}", "lens": f"lens, {kappa_label(experiment.kappa)}"}

    table: dict[str, list[Value]] = {"errors": [], "arrangement": []}
    pairs = {}
    for name, one in errors.items():
        pairs[name] = arrangements(pixels, one, other, experiment.seed)
        for arrangement, pair in pairs[name].items():
            row = {"errors": name, "arrangement": arrangement} | scores(pair[0], pair[1], source.peak)
            for column, value in row.items():
                table.setdefault(column, []).append(value)
    write_csv(folder, table)
    blocks: dict[str, list[Value]] = {name: [] for name in _BLOCKS}
    for name, spread in spreads.items():
        for column, value in zip(_BLOCKS, (name, *_summary(spread, experiment.block)), strict=True):
            blocks[column].append(value)
    write_csv(folder, blocks, "blocks.csv")
    save(noise_panel(pixels, source.peak, errors, spreads, names), folder, "noise")
    save(spread_chart(spreads, names), folder, "spread", vector=True)
    save(arrangement_panel(pairs, table, names, source.peak), folder, "arrangements", dpi=150)
    inputs = [source.facts, other_source.facts]
    return Outcome(inputs, {"noise_deviation": deviation}, _report(experiment, table, spreads, names))


def _gray(source: Source) -> np.ndarray:
    return source.pixels if source.pixels.ndim == 2 else source.pixels.mean(axis=-1)


def _summary(spread: Spread, block: int) -> tuple[Value, ...]:
    statistic, p_value = spread.bartlett()
    local = spread.local
    ends = (float(local.min()), float(local.max()), spread.low, spread.high)
    return (spread.deviation, block, local.size, *ends, spread.inside, spread.excess, statistic, p_value)


def _report(
    experiment: NoiseExperiment, table: dict[str, list[Value]], spreads: dict[str, Spread], names: dict[str, str]
) -> list[RenderableType]:
    rows = [
        [f"{names[str(name)]}: {arrangement}", *(f"{float(value):.4f}" for value in values)]
        for name, arrangement, *values in zip(*table.values(), strict=True)
    ]
    header = ["errors", "MSE", "PSNR\ndB", "SNR\ndB", "SNR (Eq. 12)\ndB", "SSIM"]
    local = [
        [
            names[name],
            f"{spread.local.min():.2f} … {spread.local.max():.2f}",
            f"{spread.low:.2f} … {spread.high:.2f}",
            f"{100 * spread.inside:.1f} %",
            f"{spread.excess:.2f}",
            f"{spread.bartlett()[1]:.3g}",
        ]
        for name, spread in spreads.items()
    ]
    title = f"Standard deviations in blocks of {experiment.block} × {experiment.block} pixels"
    columns = ["errors", "found", "expected\nof 95 %", "of them\nthere", "spread over\nexpected", "Bartlett's\np-value"]
    return [plain_table(experiment.title or experiment.name, header, rows), plain_table(title, columns, local)]
