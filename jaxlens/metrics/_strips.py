"""Every metric of a pair of large images, from strips of rows."""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens.metrics._inputs import Image, RealScalar, check_data_range, check_images, check_shapes
from jaxlens.metrics._table import METRICS, Metric
from jaxlens.metrics._totals import Totals, totals_of, totals_of_all

# A strip's samples: some twenty planes of them are in memory at once.
_SAMPLES = 2**20


def evaluate_in_strips(
    reference: Image,
    image: Image,
    *,
    data_range: RealScalar,
    rows: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Float[Array, ""]]:
    """Computes every metric of the table `METRICS`, as `evaluate`, in memory that does not grow with the images.

    The pointwise metrics are made of sums, extremes and moments of the strips; windows that lie on two strips are
    seen by both, and counted by the upper one. Nothing but the order of the sums differs from `evaluate`. Only a metric
    of your own that says neither how it follows from sums nor a window is measured on the whole images.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype. NumPy arrays stay where they are; a strip at a time is given
            to JAX.
        image: the same shape.
        data_range: L of `psnr` and `ssim`.
        rows: how many a strip has, without the windows' overlap; by default a million samples' worth.
        progress: called with the number of rows done, and that of all, after each strip.

    Returns:
        As `evaluate`. Not for use under `jax.jit`, and not differentiable.

    Raises:
        ValueError: if the shapes do not fit, `data_range` is not above 0, or `rows` is below 1.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> scores = metrics.evaluate_in_strips(np.zeros((16, 16)), np.full((16, 16), 0.1), data_range=1.0, rows=5)
        >>> round(float(scores["psnr"]), 4), round(float(scores["mae"]), 4)
        (20.0, 0.1)
    """
    check_data_range(data_range)
    check_shapes(reference, image)
    if rows is None:
        rows = max(1, _SAMPLES * np.shape(reference)[0] // np.size(reference))
    if rows < 1:
        raise ValueError(f"rows is {rows}; a strip has at least 1.")
    reference, image = (one if isinstance(one, jax.Array) else np.asarray(one) for one in (reference, image))
    height = len(reference)
    metrics = tuple(METRICS.items())
    overlap = max(1, *(metric.window for _, metric in metrics)) - 1
    parts = []
    for first in range(0, height, rows):
        last = min(first + rows, height)
        rest = slice(first, last + overlap)
        x, y, _ = check_images(reference[rest], image[rest], None)
        samples = (last - first) * (np.size(reference) // height)
        parts.append(_measure(x, y, data_range, samples, own=last - first, metrics=metrics))
        if progress is not None:
            jax.block_until_ready(parts[-1])  # what is only asked for is not done
            progress(last, height)
    strips, windows = jax.tree.map(lambda *values: jnp.stack(values), *parts)
    scores = _combined(strips, windows, metrics=metrics)
    return OrderedDict(
        (name, scores[name] if name in scores else metric(reference, image, data_range=data_range))
        for name, metric in metrics
    )


@partial(jax.jit, static_argnames=("own", "metrics"))
def _measure(
    reference: Array,
    image: Array,
    data_range: RealScalar,
    samples: RealScalar,
    *,
    own: int,
    metrics: tuple[tuple[str, Metric], ...],
) -> tuple[Totals, dict[str, tuple[Array, Array]]]:
    """Measures one strip, whose first `own` rows, of `samples` samples, are its own.

    Of metrics with windows it is the sum over the windows that begin in these rows, and how many they are.
    """
    totals = totals_of(reference[:own], image[:own], samples, data_range)
    windows = {}
    for name, metric in metrics:
        if metric.window:
            both = reference[: own + metric.window - 1], image[: own + metric.window - 1]
            high, wide = (max(0, side - metric.window + 1) for side in both[0].shape[:2])
            count = jnp.asarray(high * wide, totals.samples.dtype)
            windows[name] = (metric(*both, data_range=data_range) * count if high * wide else count), count
    return totals, windows


@partial(jax.jit, static_argnames="metrics")
def _combined(
    strips: Totals, windows: dict[str, tuple[Array, Array]], *, metrics: tuple[tuple[str, Metric], ...]
) -> dict[str, Array]:
    totals = totals_of_all(strips)
    scores = {name: metric.from_totals(totals) for name, metric in metrics if metric.from_totals is not None}
    # Without any window 0 / 0, which is NaN as it should be.
    return scores | {name: jnp.sum(sums) / jnp.sum(counts) for name, (sums, counts) in windows.items()}
