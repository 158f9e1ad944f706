"""Figure 7: noise that is the same over the entire image, a lens's errors that are not, and what MSE sees of either."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from pydantic import Field
from rich.console import Console, RenderableType

import jaxlens as jl
from jaxlens import experiments, figures
from jaxlens.experiments import (
    ConfigError,
    Configuration,
    Experiment,
    Image,
    Kappa,
    Outcome,
    Value,
    Warp,
    load_source,
    plain_table,
    write_csv,
    write_rows,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
_METRICS = ("mse", "psnr", "snr", "range_snr", "ssim")
# Of the expected local standard deviations, and the abscissas that its ends are sought among.
_LEVEL, _STEPS = 0.95, 20001
_TITLE, _NOTE, _GAP, _MARGIN = 0.25, 0.44, 0.12, 0.05
_BAR = 0.75
_COLORS = {"noise": figures.BLUE, "lens": figures.VERMILLION}
_BINS = 40
# Times the expected spread, from which on single blocks are only seen on a logarithmic axis.
_UNEVEN = 4.0


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
        """Carries out the experiment: `table.csv` has the measures of each arrangement, `blocks.csv` the local spreads.

        Raises:
            ConfigError: the image is too small for blocks, or for SSIM.
        """
        import jax

        source, other_source = (load_source(configuration, image) for image in (self.image, self.other))
        pixels = source.gray
        shorter = min(pixels.shape)
        if shorter < max(_LEAST, 2 * self.block):
            raise ConfigError(
                f"{configuration.path}: block: got {self.block}; the image, of {pixels.shape[0]} rows and "
                f"{pixels.shape[1]} columns, must hold two such blocks along each side, and {_LEAST} pixels"
            )
        other = other_source.gray
        if other.shape != pixels.shape:
            other = np.asarray(jax.image.resize(other, pixels.shape, "linear"))
        kappa = np.asarray([self.kappa], np.float64)
        through = experiments.deform_all(pixels, kappa, self.warp)[0] - pixels
        share = self.noise
        deviation = float(np.sqrt(np.mean(through**2))) if share is None else share * source.peak
        noise = deviation * np.random.default_rng(self.seed).standard_normal(pixels.shape)
        errors = {"noise": noise.astype(pixels.dtype), "lens": through}
        spreads = {name: spread_of(one, self.block) for name, one in errors.items()}
        names = {"noise": f"noise, σ = {deviation:.1f}", "lens": f"lens, {figures.kappa_label(self.kappa)}"}

        table: dict[str, list[Value]] = {"errors": [], "arrangement": []}
        pairs = {}
        for name, one in errors.items():
            pairs[name] = arrangements(pixels, one, other, self.seed)
            for arrangement, pair in pairs[name].items():
                row = {"errors": name, "arrangement": arrangement} | scores(pair[0], pair[1], source.peak)
                for column, value in row.items():
                    table.setdefault(column, []).append(value)
        write_csv(folder, table)
        blocks = [(name, *_summary(spread, self.block)) for name, spread in spreads.items()]
        write_rows(folder, _BLOCKS, blocks, "blocks.csv")
        figures.save(noise_panel(pixels, source.peak, errors, spreads, names), folder / "noise.jpg")
        figures.save(spread_chart(spreads, names), folder / "spread.svg")
        figures.save(arrangement_panel(pairs, table, names, source.peak), folder / "arrangements.jpg")
        inputs = [source.facts, other_source.facts]
        return Outcome(inputs, {"noise_deviation": deviation}, _report(self, table, spreads, names))


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
    return [plain_table(experiment.heading, header, rows), plain_table(title, columns, local)]


@dataclass(frozen=True, eq=False)
class Spread:
    """The standard deviations of errors in square blocks, against those of noise that is the same everywhere.

    Of Gaussian noise with one σ, `(n − 1) s² / σ²` of the n errors of a block is distributed as χ² with n − 1 degrees
    of freedom.

    Attributes:
        deviation: σ, from all errors: the root of the mean of the blocks' variances.
        samples: n, in a block.
        local: `(rows, columns)`, s of each block.
        low: Lower end of the range in which 95 % of the blocks are expected.
        high: Its upper end.
    """

    deviation: float
    samples: int
    local: Float[np.ndarray, "rows columns"]
    low: float
    high: float

    @property
    def inside(self) -> float:
        """The share of blocks in the expected range."""
        return float(np.mean((self.local >= self.low) & (self.local <= self.high)))

    @property
    def excess(self) -> float:
        """The standard deviation of the blocks' variances over the expected one, σ² √(2 / (n − 1))."""
        return float(np.std(self.local**2) / (self.deviation**2 * np.sqrt(2 / (self.samples - 1))))

    def bartlett(self) -> tuple[float, float]:
        """Returns Bartlett's statistic, and how often equal variances would give one as large.

        A block without any error makes the statistic infinite.
        """
        count, freedom = self.local.size, self.samples - 1
        with np.errstate(divide="ignore"):
            logarithms = np.log(self.local**2 / self.deviation**2)
        statistic = -freedom * float(logarithms.sum()) / (1 + (count + 1) / (3 * count * freedom))
        return statistic, float(chi_square_above(statistic, count - 1))

    def density(self, at: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
        """Returns the density of s where the noise is the same everywhere."""
        freedom = self.samples - 1
        ends = np.concatenate([at, [2 * at[-1] - at[-2]]]) - 0.5 * (at[1] - at[0])
        below = 1 - chi_square_above(freedom * (ends / self.deviation) ** 2, freedom)
        return np.diff(below) / np.diff(ends)


def spread_of(errors: Float[np.ndarray, "height width"], block: int) -> Spread:
    """Measures errors in blocks; rows and columns that fill none are left out."""
    rows, columns = (size // block for size in errors.shape)
    cut = np.asarray(errors, np.float64)[: rows * block, : columns * block]
    local = cut.reshape(rows, block, columns, block).std(axis=(1, 3), ddof=1)
    deviation, freedom = float(np.sqrt(np.mean(local**2))), block**2 - 1
    ratio = np.linspace(0, 4, _STEPS)
    below = 1 - chi_square_above(freedom * ratio**2, freedom)
    low, high = np.interp([(1 - _LEVEL) / 2, (1 + _LEVEL) / 2], below, ratio)
    return Spread(deviation, block**2, local, deviation * low, deviation * high)


def arrangements(
    reference: Float[np.ndarray, "height width"],
    errors: Float[np.ndarray, "height width"],
    other: Float[np.ndarray, "height width"],
    seed: int,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Returns pairs of a picture and the same with errors, among which MSE sees no difference."""
    random = np.random.default_rng(seed)
    order = random.permutation(errors.size)
    signs = random.choice([-1.0, 1.0], size=errors.shape)

    def shuffled(picture: np.ndarray) -> np.ndarray:
        return picture.ravel()[order].reshape(picture.shape)

    return {
        "as they are": (reference, reference + errors),
        "errors re-ordered": (reference, reference + shuffled(errors)),
        "signs at random": (reference, reference + signs * errors),
        "both re-ordered": (shuffled(reference), shuffled(reference + errors)),
        "on another picture": (other, other + errors),
    }


def scores(reference: np.ndarray, image: np.ndarray, peak: float) -> dict[str, float]:
    """Returns MSE, PSNR, SNR as a ratio of powers and by Eq. 12, and SSIM."""
    values = (
        jl.metrics.mse(reference, image),
        jl.metrics.psnr(reference, image, data_range=peak),
        jl.metrics.snr(reference, image),
        jl.metrics.range_snr(reference, image),
        jl.metrics.ssim(reference, image, data_range=peak),
    )
    return {name: float(value) for name, value in zip(_METRICS, values, strict=True)}


def chi_square_above(values: float | np.ndarray, freedom: int) -> np.ndarray:
    """Returns the probability of more than each value of χ²."""
    import jax

    with jax.enable_x64(True):
        return np.asarray(jax.scipy.stats.chi2.sf(np.asarray(values, np.float64), float(freedom)))


def noise_panel(
    initial: np.ndarray,
    peak: float,
    errors: Mapping[str, np.ndarray],
    spreads: Mapping[str, Spread],
    names: Mapping[str, str],
) -> Figure:
    """Draws the image with each kind of errors, and the errors' standard deviations in blocks below, in one scale."""
    aspect, columns = figures.cell_aspect(initial), 1 + len(errors)
    side = (figures.WIDTH - 2 * _MARGIN - _BAR - (columns - 1) * _GAP) / columns
    high = side * aspect
    below = _MARGIN + _TITLE + high + _GAP
    figure = figures.new_figure(figures.WIDTH, below + high + _NOTE + _MARGIN, by_hand=True)
    figures.show_image(figures.place(figure, _MARGIN, _MARGIN + _TITLE, side, high), initial, peak, title="initial")
    most = max(float(spread.local.max()) for spread in spreads.values())
    drawn = None
    for index, (name, one) in enumerate(errors.items()):
        left = _MARGIN + (index + 1) * (side + _GAP)
        figures.show_image(
            figures.place(figure, left, _MARGIN + _TITLE, side, high), initial + one, peak, title=names[name]
        )
        axes = figures.place(figure, left, below, side, high)
        local = spreads[name].local
        drawn = axes.imshow(local, cmap="viridis", vmin=0, vmax=most, interpolation="nearest", aspect="auto")
        figures.bare(axes)
        inside = f"{100 * spreads[name].inside:.1f} % in the 95 % range"
        axes.set_xlabel(f"{local.min():.1f} to {local.max():.1f}\n{inside}", color=figures.MUTED, labelpad=3)
    text = figures.place(figure, _MARGIN, below, side, high)
    figures.bare(text)
    block = round(next(iter(spreads.values())).samples ** 0.5)
    text.text(
        1,
        0.98,
        f"standard deviation\nof the errors in blocks\nof {block} × {block} pixels",
        ha="right",
        va="top",
        color=figures.MUTED,
        linespacing=1.4,
        transform=text.transAxes,
    )
    if drawn is not None:
        bar_left = _MARGIN + columns * (side + _GAP)
        bar = figure.colorbar(drawn, cax=figures.place(figure, bar_left, below, 0.14, high))
        bar.set_label("gray levels")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def spread_chart(spreads: Mapping[str, Spread], names: Mapping[str, str]) -> Figure:
    """Draws how the blocks' standard deviations are distributed, and how those of even noise would be."""
    from matplotlib.legend_handler import HandlerTuple
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = figures.new_figure(figures.WIDTH, 2.9)
    for (name, spread), axes in zip(spreads.items(), figure.subplots(1, len(spreads)), strict=True):
        low, high = float(spread.local.min()), float(spread.local.max())
        width = max(high - low, spread.high - spread.low)
        ends = np.linspace(max(0.0, low - 0.15 * width), high + 0.15 * width, _BINS + 1)
        axes.hist(spread.local.ravel(), ends, color=_COLORS[name], alpha=0.75)
        at = np.linspace(ends[0], ends[-1], 801)
        expected = spread.density(at) * spread.local.size * (ends[1] - ends[0])
        axes.plot(at, expected, color=figures.BLACK, linewidth=1.4)
        if spread.excess > _UNEVEN:
            axes.set_yscale("log")
            axes.set_ylim(0.6, 2 * max(np.histogram(spread.local, ends)[0].max(), expected.max()))
        axes.set_xlim(ends[0], ends[-1])
        axes.set_title(names[name], loc="left")
        axes.set_xlabel("standard deviation in a block  [gray levels]")
        axes.set_ylabel("blocks")
    found = tuple(Patch(color=_COLORS[name], alpha=0.75) for name in spreads)
    curve = Line2D([], [], color=figures.BLACK, linewidth=1.4)
    labels = ["blocks found", "expected of noise that is the same everywhere (χ)"]
    together = {tuple: HandlerTuple(ndivide=None, pad=0.2)}
    handles = [found, curve]  # the annotation of `legend` knows no tuples of artists
    figure.legend(handles, labels, handler_map=together, loc="outside upper center", ncols=2)  # pyright: ignore
    return figure


def arrangement_panel(
    pairs: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]],
    table: Mapping[str, Sequence],
    names: Mapping[str, str],
    peak: float,
) -> Figure:
    """Draws the pictures of each arrangement of the same errors, with their MSE and SSIM below."""
    first = next(iter(pairs.values()))
    columns, head = len(first), 0.26
    aspect = figures.cell_aspect(next(iter(first.values()))[0])
    side = (figures.WIDTH - 2 * _MARGIN - head - (columns - 1) * 0.08) / columns
    high, note = side * aspect, 0.42
    figure = figures.new_figure(figures.WIDTH, 2 * _MARGIN + _TITLE + len(pairs) * (high + note), by_hand=True)
    rows = iter(zip(table["mse"], table["ssim"], strict=True))
    for row, (name, arrangements) in enumerate(pairs.items()):
        top = _MARGIN + _TITLE + row * (high + note)
        middle = 1 - (top + high / 2) / figure.get_size_inches()[1]
        figure.text((_MARGIN + 0.1) / figures.WIDTH, middle, names[name], rotation=90, ha="center", va="center")
        for column, (arrangement, (_, image)) in enumerate(arrangements.items()):
            axes = figures.place(figure, _MARGIN + head + column * (side + 0.08), top, side, high)
            mse, ssim = next(rows)
            figures.show_image(axes, image, peak, note=f"MSE {mse:.1f}\nSSIM {ssim:.3f}".replace("-", "−"))
            if row == 0:
                axes.set_title(arrangement, pad=4, fontsize=9)
    return figure
