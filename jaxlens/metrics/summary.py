"""Every metric of a pair of images at once."""

from collections import OrderedDict

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.metrics.inputs import Image, Mask, RealScalar, check_data_range, check_images
from jaxlens.metrics.pointwise import mae, minkowski, mse, psnr, range_snr, rmse, snr
from jaxlens.metrics.structural import SSIM_SIGMA, UQI_WINDOW, gaussian_size, ssim, uqi

MINKOWSKI_P = 4.0


def evaluate(
    reference: Image, image: Image, *, data_range: RealScalar, mask: Mask | None = None
) -> dict[str, Float[Array, ""]]:
    """Every metric at once, each with its defaults.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        data_range: L of `psnr` and `ssim`.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        Scalars by name: `snr`, `psnr` (both dB), `rmse`, `mae`, `mse`, `range_snr` (dB, with the reference's
        own extremes), `uqi`, `ssim` and `minkowski` (p = 4). The keys do not depend on the input: where the
        image is smaller than a window, `uqi` (8 pixels) and `ssim` (11) are NaN. It is an `OrderedDict`,
        because the order of a plain one is lost under `jax.jit` and `jax.vmap`.

    Raises:
        ValueError: if the shapes do not fit, or `data_range` is known and not above 0.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> scores = metrics.evaluate(np.zeros((16, 16)), np.full((16, 16), 0.1), data_range=1.0)
        >>> round(float(scores["psnr"]), 4), round(float(scores["mae"]), 4)
        (20.0, 0.1)
    """
    check_data_range(data_range)
    return _evaluate(*check_images(reference, image, mask), data_range)


@jax.jit
def _evaluate(reference: Array, image: Array, mask: Array | None, data_range: RealScalar) -> "OrderedDict[str, Array]":
    side = min(reference.shape[:2])
    mean_square = mse(reference, image, mask=mask)
    missing = jnp.full((), jnp.nan, mean_square.dtype)
    scores: OrderedDict[str, Array] = OrderedDict()
    scores["snr"] = snr(reference, image, mask=mask)
    scores["psnr"] = psnr(reference, image, data_range=data_range, mask=mask)
    scores["rmse"] = rmse(reference, image, mask=mask)
    scores["mae"] = mae(reference, image, mask=mask)
    scores["mse"] = mean_square
    scores["range_snr"] = range_snr(reference, image, mask=mask)
    scores["uqi"] = uqi(reference, image, mask=mask) if side >= UQI_WINDOW else missing
    fits = side >= gaussian_size(SSIM_SIGMA)
    scores["ssim"] = ssim(reference, image, data_range=data_range, mask=mask) if fits else missing
    scores["minkowski"] = minkowski(reference, image, p=MINKOWSKI_P, mask=mask)
    return scores
