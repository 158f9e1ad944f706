"""Every metric of a pair of images at once."""

from collections import OrderedDict
from functools import partial

import jax
from jaxtyping import Array, Float

from jaxlens.metrics._inputs import Image, Mask, RealScalar, check_data_range, check_images
from jaxlens.metrics._table import METRICS, Metric


def evaluate(
    reference: Image, image: Image, *, data_range: RealScalar, mask: Mask | None = None
) -> dict[str, Float[Array, ""]]:
    """Computes every metric of the table `METRICS`, each with its defaults.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        data_range: L of `psnr` and `ssim`.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        Scalars by name, in the order of `METRICS`, where their units and meanings stand. The keys do not depend on the
        input: where the image is smaller than a metric's window (`uqi` 8 pixels, `ssim` 11), it is NaN. It is an
        `OrderedDict`, because the order of a plain one is lost under `jax.jit` and `jax.vmap`.

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
    return _evaluate(*check_images(reference, image, mask), data_range, metrics=tuple(METRICS.items()))


# The table is an argument, for it may have grown since the last call.
@partial(jax.jit, static_argnames="metrics")
def _evaluate(
    reference: Array,
    image: Array,
    mask: Array | None,
    data_range: RealScalar,
    *,
    metrics: tuple[tuple[str, Metric], ...],
) -> "OrderedDict[str, Array]":
    return OrderedDict((name, metric(reference, image, data_range=data_range, mask=mask)) for name, metric in metrics)
