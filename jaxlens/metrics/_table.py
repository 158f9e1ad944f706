"""The metrics that `evaluate` measures: one row each, and whatever lists metrics is derived from it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.metrics._decibels import decibels
from jaxlens.metrics._inputs import Image, Mask, RealScalar
from jaxlens.metrics._pointwise import mae, minkowski, mse, psnr, range_snr, rmse, snr
from jaxlens.metrics._structural import SSIM_SIGMA, UQI_WINDOW, gaussian_size, ssim, uqi
from jaxlens.metrics._totals import MINKOWSKI_P, Totals


@dataclass(frozen=True)
class Metric:
    """A metric, and what is to be known to compute and to show it.

    Attributes:
        function: `function(reference, image, mask=…)`, with `data_range=…` too if `takes_range`; a scalar.
        label: Its name as people write it.
        unit: Unit of its values; empty if they have none.
        meaning: What it is, in a few words.
        takes_range: It needs the images' dynamic range, L of Eq. 8.
        window: The side in pixels of the windows of which it is the mean; 0 if it has none. It is NaN where an image
            is smaller.
        from_totals: How it follows from sums over the pixels. Without, and without windows, `evaluate_in_strips`
            measures whole images.
    """

    function: Callable[..., Float[Array, ""]]
    label: str
    unit: str
    meaning: str
    takes_range: bool = False
    window: int = 0
    from_totals: Callable[[Totals], Array] | None = None

    def __call__(
        self, reference: Image, image: Image, *, data_range: RealScalar, mask: Mask | None = None
    ) -> Float[Array, ""]:
        """Measures a pair of images.

        Args:
            reference: `(H, W)` or `(H, W, C)`, any real dtype.
            image: the same shape.
            data_range: L of Eq. 8; left out where the metric has no use for it.
            mask: `(H, W)` boolean, True where a pixel counts; None for all.

        Returns:
            The value; NaN if the metric's window is larger than the images.

        Raises:
            ValueError: if the shapes do not fit, or `data_range` is known and not above 0.
        """
        if min(jnp.shape(reference)[:2]) < self.window:
            return jnp.full((), jnp.nan, mse(reference, image).dtype)
        options = {"data_range": data_range} if self.takes_range else {}
        return self.function(reference, image, mask=mask, **options)


_GRAY = "gray levels"
METRICS: dict[str, Metric] = {
    "snr": Metric(
        snr,
        "SNR",
        "dB",
        "signal-to-noise ratio, Σx² / Σ(x − y)²",
        from_totals=lambda totals: decibels(totals.signal, totals.noise),
    ),
    "psnr": Metric(
        psnr,
        "PSNR",
        "dB",
        "peak signal-to-noise ratio (Eq. 8)",
        takes_range=True,
        from_totals=lambda totals: decibels(totals.data_range**2, totals.noise),
    ),
    "rmse": Metric(
        rmse, "RMSE", _GRAY, "root of the mean squared error", from_totals=lambda totals: jnp.sqrt(totals.noise)
    ),
    "mae": Metric(mae, "MAE", _GRAY, "mean absolute error", from_totals=lambda totals: totals.absolute),
    "mse": Metric(mse, "MSE", f"{_GRAY}²", "mean squared error (Eq. 6)", from_totals=lambda totals: totals.noise),
    "range_snr": Metric(
        range_snr,
        "range SNR",
        "dB",
        "signal-to-noise ratio by range (Eq. 12)",
        from_totals=lambda totals: decibels((totals.high - totals.low) ** 2, totals.variance),
    ),
    "uqi": Metric(uqi, "UQI", "", "universal quality index; 1 if equal", window=UQI_WINDOW),
    "ssim": Metric(
        ssim, "SSIM", "", "structural similarity; 1 if equal", takes_range=True, window=gaussian_size(SSIM_SIGMA)
    ),
    "minkowski": Metric(
        partial(minkowski, p=MINKOWSKI_P),
        "Minkowski",
        _GRAY,
        f"Minkowski distance, p = {MINKOWSKI_P:g} (Eq. 7)",
        from_totals=lambda totals: totals.minkowski,
    ),
}
"""The metrics by name, in the order of tables. A program may add its own."""
