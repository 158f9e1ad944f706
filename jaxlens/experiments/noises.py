"""Errors of a picture: how evenly they are spread, and the same ones in another order, with other signs, elsewhere."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from jaxlens import metrics

_METRICS = ("mse", "psnr", "snr", "range_snr", "ssim")
# Of the expected local standard deviations, and the abscissas that its ends are sought among.
_LEVEL, _STEPS = 0.95, 20001


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
        metrics.mse(reference, image),
        metrics.psnr(reference, image, data_range=peak),
        metrics.snr(reference, image),
        metrics.range_snr(reference, image),
        metrics.ssim(reference, image, data_range=peak),
    )
    return {name: float(value) for name, value in zip(_METRICS, values, strict=True)}


def chi_square_above(values: float | np.ndarray, freedom: int) -> np.ndarray:
    """Returns the probability of more than each value of χ²."""
    with jax.enable_x64(True):
        return np.asarray(jax.scipy.stats.chi2.sf(np.asarray(values, np.float64), float(freedom)))
