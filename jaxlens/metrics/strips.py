"""Every metric of a pair of large images, from strips of rows."""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens.metrics.decibels import decibels
from jaxlens.metrics.inputs import Image, RealScalar, check_data_range, check_images, check_shapes
from jaxlens.metrics.pointwise import mae, minkowski, mse
from jaxlens.metrics.structural import SSIM_SIGMA, UQI_WINDOW, gaussian_size, ssim, uqi
from jaxlens.metrics.summary import MINKOWSKI_P

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
    """Every metric at once, as `evaluate`, in memory that does not grow with the images.

    The pointwise metrics are made of sums, extremes and moments of the strips; windows that lie on two strips are
    seen by both, and counted by the upper one. Nothing but the order of the sums differs from `evaluate`.

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
    overlap = max(gaussian_size(SSIM_SIGMA), UQI_WINDOW) - 1
    parts = []
    for first in range(0, height, rows):
        last = min(first + rows, height)
        rest = slice(first, last + overlap)
        x, y, _ = check_images(reference[rest], image[rest], None)
        parts.append(_measure(x, y, data_range, (last - first) * (np.size(reference) // height), own=last - first))
        if progress is not None:
            jax.block_until_ready(parts[-1])  # what is only asked for is not done
            progress(last, height)
    columns = {name: jnp.stack([part[name] for part in parts]) for name in parts[0]}
    return _combined(columns, data_range)


@partial(jax.jit, static_argnames="own")
def _measure(
    reference: Array, image: Array, data_range: RealScalar, samples: RealScalar, *, own: int
) -> dict[str, Array]:
    """What the metrics are made of, for one strip, of whose rows `own`, with so many samples, are its own."""
    x, y = reference[:own], image[:own]
    noise = mse(x, y)
    floating = noise.dtype
    error = x.astype(floating) - y.astype(floating)
    # By a number that is not known before: XLA multiplies by the inverse of others, and rounds.
    samples = jnp.asarray(samples, floating)
    mean = jnp.sum(error) / samples
    measured = {
        "samples": samples,
        "signal": mse(x, jnp.zeros_like(x)),
        "noise": noise,
        "mae": mae(x, y),
        "mean": mean,
        "variance": jnp.sum((error - mean) ** 2) / samples,
        "low": jnp.min(x).astype(floating),
        "high": jnp.max(x).astype(floating),
        "minkowski": minkowski(x, y, p=MINKOWSKI_P),
    }
    for name, size, metric in (
        ("uqi", UQI_WINDOW, uqi),
        ("ssim", gaussian_size(SSIM_SIGMA), partial(ssim, data_range=data_range)),
    ):
        both = reference[: own + size - 1], image[: own + size - 1]
        fits = min(both[0].shape[:2]) >= size
        windows = (both[0].shape[0] - size + 1) * (x.shape[1] - size + 1) if fits else 0
        measured[f"{name} windows"] = jnp.asarray(windows, floating)
        measured[name] = metric(*both) if fits else jnp.zeros((), floating)
    return measured


@jax.jit
def _combined(parts: dict[str, Array], data_range: RealScalar) -> "OrderedDict[str, Array]":
    samples = parts["samples"]

    def mean(values: Array, weights: Array = samples) -> Array:
        return jnp.sum(values * weights) / jnp.sum(weights)

    noise, error = mean(parts["noise"]), mean(parts["mean"])
    # The spread within the strips and that of their means.
    variance = mean(parts["variance"] + (parts["mean"] - error) ** 2)
    span = jnp.max(parts["high"]) - jnp.min(parts["low"])
    scores: OrderedDict[str, Array] = OrderedDict()
    scores["snr"] = decibels(mean(parts["signal"]), noise)
    scores["psnr"] = decibels(jnp.asarray(data_range, noise.dtype) ** 2, noise)
    scores["rmse"] = jnp.sqrt(noise)
    scores["mae"] = mean(parts["mae"])
    scores["mse"] = noise
    scores["range_snr"] = decibels(span**2, variance)
    # Without any window 0 / 0, which is NaN as it should be.
    scores["uqi"] = mean(parts["uqi"], parts["uqi windows"])
    scores["ssim"] = mean(parts["ssim"], parts["ssim windows"])
    scores["minkowski"] = minkowski(parts["minkowski"][None], jnp.zeros_like(parts["minkowski"])[None], p=MINKOWSKI_P)
    return scores
