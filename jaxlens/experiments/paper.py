"""Table 1 of the paper, and what its own numbers say about it.

The paper: Darujati, Gumelar, Nugroho and Hariadi, "Getting 3D Facial Image Distortion Using Pincushion Deformations".
It does not publish its image. Its table ties PSNR and RMSE by a peak of 193 rather than 255, and SNR and PSNR by a
constant, which makes SNR a ratio of powers and not Eq. 12.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

Reading = Literal["functional inverse", "reciprocal", "direct"]
READINGS: tuple[Reading, ...] = get_args(Reading)
"""What Φ⁻¹(r²) in Eq. 11 may mean: see `source_map`."""

METRICS = ("snr", "psnr", "rmse", "mae")
PEAK = 193.0
"""The peak L in the PSNR of Table 1, in gray levels: RMSE · 10^(PSNR / 20) in five of its six rows."""

FALLING = ((0.0, 1.0), (1.0, 2.0), (1.0, 3.0), (2.0, 3.0))
"""Lenses along which PSNR falls, in the paper and in ours: neither coefficient ever decreases."""


@dataclass(frozen=True)
class Row:
    """A row of Table 1.

    Attributes:
        kappa: (κ1, κ2).
        snr: In decibels.
        psnr: In decibels.
        rmse: In gray levels, as printed.
        mae: In gray levels, as printed.
        copied: RMSE and MAE are those of another row, printed again.
    """

    kappa: tuple[float, float]
    snr: float
    psnr: float
    rmse: float
    mae: float
    copied: bool = False


TABLE_1 = (
    Row((0.0, 1.0), 9.338424, 16.313903, 29.5027238, 10.5450952),
    Row((1.0, 2.0), 3.996214, 10.971689, 54.5723698, 32.1266306),
    Row((1.0, 3.0), 3.410667, 10.386142, 58.3781284, 35.9175127),
    Row((2.0, 3.0), 2.923990, 9.899470, 54.5723698, 32.1266306, copied=True),
    Row((3.0, 2.0), 2.479110, 9.454590, 64.9871918, 43.0463493),
    Row((3.0, 1.0), 1.863934, 8.839413, 69.7568175, 48.9409058),
)


def row_of(kappa: Sequence[float]) -> Row | None:
    """Returns the row of Table 1 for a lens, if it has one."""
    return next((row for row in TABLE_1 if row.kappa == tuple(kappa)), None)


def implied_peak(psnr: float, rmse: float) -> float:
    """Returns the L of Eq. 8 that ties a PSNR to an RMSE."""
    return rmse * 10 ** (psnr / 20)


def implied_rmse(psnr: float, peak: float = PEAK) -> float:
    """Returns the RMSE that a PSNR implies: 61.742 in row (2, 3), where the table prints 54.572."""
    return peak / 10 ** (psnr / 20)


def root_mean_square(offset: float, peak: float = PEAK) -> float:
    """Returns the reference's root of the mean square that PSNR − SNR implies: 86.4537 for Table 1."""
    return peak / 10 ** (offset / 20)


def distance(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """Returns the root of the mean squared difference of two columns, in their unit."""
    return math.sqrt(math.fsum((a - b) ** 2 for a, b in zip(ours, theirs, strict=True)) / len(ours))
