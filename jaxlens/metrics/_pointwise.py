"""Metrics of the error at each pixel: norms (Eqs. 6 and 7) and their decibels (Eqs. 8 and 12)."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxlens.metrics._decibels import decibels
from jaxlens.metrics._inputs import (
    Image,
    Mask,
    Pair,
    RealScalar,
    check_data_range,
    check_images,
    check_positive,
    over_channels,
    pair,
)


def mse(reference: Image, image: Image, *, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the mean squared error (Eq. 6), in squared gray levels.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        Σ (x − y)² / N over the samples that count; NaN if none does. Smooth everywhere.

    Raises:
        ValueError: if the shapes do not fit.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> float(metrics.mse(np.array([[10, 20]], np.uint8), np.array([[13, 16]], np.uint8)))
        12.5
    """
    return _mse(*check_images(reference, image, mask))


def rmse(reference: Image, image: Image, *, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the root of the mean squared error, in gray levels.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        √(Σ (x − y)² / N); NaN if no sample counts. Its derivative at equal images, where it has a kink, is 0.

    Raises:
        ValueError: if the shapes do not fit.
    """
    return _rmse(*check_images(reference, image, mask))


def mae(reference: Image, image: Image, *, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the mean absolute error, in gray levels.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        Σ |x − y| / N; NaN if no sample counts. A sample without error contributes a derivative of 0.

    Raises:
        ValueError: if the shapes do not fit.
    """
    return _mae(*check_images(reference, image, mask))


def minkowski(reference: Image, image: Image, *, p: RealScalar, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the Minkowski distance (Eq. 7), in gray levels: a sum over the samples, not a mean.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        p: the exponent, above 0. 1 gives the sum of absolute errors, 2 the Euclidean distance, `inf` the
            largest absolute error. It may be traced; below 1 the result is no longer a distance.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        (Σ |x − y|^p)^(1/p); NaN if no sample counts. The errors are divided by the largest before the power,
        so a large p does not overflow. Differentiable in the images and in a finite p; a sample without error
        contributes 0. At p = `inf` the largest errors share the derivative.

    Raises:
        ValueError: if the shapes do not fit, or p is known and not above 0.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> reference, image = np.zeros((1, 2), np.float32), np.array([[3, -4]], np.float32)
        >>> [round(float(metrics.minkowski(reference, image, p=p)), 4) for p in (1, 2, float("inf"))]
        [7.0, 5.0, 4.0]
    """
    check_positive("p", p, "Use p=1 for absolute errors, p=2 for squared ones, p=inf for the largest.")
    return _minkowski(*check_images(reference, image, mask), p)


def psnr(reference: Image, image: Image, *, data_range: RealScalar, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the peak signal-to-noise ratio (Eq. 8), in decibels.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        data_range: L, the range that samples may span: 255 for 8-bit images, 1 for images in [0, 1]. It is
            never guessed from the dtype. Table 1 of the paper used its reference's own maximum, 193.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        10 log₁₀(L² / MSE). Equal images give `inf`, with a derivative of 0; no counted sample gives NaN.

    Raises:
        ValueError: if the shapes do not fit, or `data_range` is known and not above 0.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> black, gray = np.zeros((8, 8), np.uint8), np.full((8, 8), 51, np.uint8)
        >>> round(float(metrics.psnr(black, gray, data_range=255)), 3)
        13.979
    """
    check_data_range(data_range)
    return _psnr(*check_images(reference, image, mask), data_range)


def snr(reference: Image, image: Image, *, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the signal-to-noise ratio of powers, in decibels: what Table 1 of the paper lists as SNR.

    This is not Eq. 12, which is `range_snr`. It differs from the PSNR by a constant of the reference,
    20 log₁₀(L / rms(x)), which is 6.97548 dB in all rows of Table 1.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        10 log₁₀(Σ x² / Σ (x − y)²). Equal images give `inf`, black ones too; otherwise a black reference
        gives `-inf`; no counted sample gives NaN. The derivative is 0 where the value is infinite.

    Raises:
        ValueError: if the shapes do not fit.
    """
    return _snr(*check_images(reference, image, mask))


def range_snr(
    reference: Image,
    image: Image,
    *,
    bounds: tuple[RealScalar, RealScalar] | None = None,
    mask: Mask | None = None,
) -> Float[Array, ""]:
    """Returns the signal-to-noise ratio of a signal that lies between two bounds (Eq. 12), in decibels.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        bounds: (a_min, a_max), between which the signal is known to lie. The paper does not say where they
            come from; by default they are the least and greatest counted samples of the reference.
        mask: `(H, W)` boolean, True where a pixel counts; None for all.

    Returns:
        20 log₁₀((a_max − a_min) / s), s being the standard deviation of the error x − y over all samples that
        count (divided by N, not N − 1). A constant offset is therefore no noise. An error without spread
        gives `inf`; otherwise a flat reference gives `-inf`; no counted sample gives NaN. The derivative is 0
        where the value is infinite.

    Raises:
        ValueError: if the shapes do not fit, or the bounds are known and a_max is not above a_min.
    """
    if bounds is not None:
        low, high = bounds
        known = not isinstance(low, Tracer) and not isinstance(high, Tracer)
        if known and not np.asarray(low) < np.asarray(high):
            raise ValueError(f"bounds are ({low}, {high}); give (a_min, a_max) with a_min below a_max.")
    return _range_snr(*check_images(reference, image, mask), bounds)


@jax.jit
def _mse(reference: Array, image: Array, mask: Array | None) -> Array:
    return _mean_square_error(pair(reference, image, mask))


@jax.jit
def _rmse(reference: Array, image: Array, mask: Array | None) -> Array:
    return _safe_sqrt(_mean_square_error(pair(reference, image, mask)))


@jax.jit
def _mae(reference: Array, image: Array, mask: Array | None) -> Array:
    both = pair(reference, image, mask)
    return jnp.sum(jnp.abs(both.reference - both.image)) / both.samples


@jax.jit
def _minkowski(reference: Array, image: Array, mask: Array | None, p: RealScalar) -> Array:
    both = pair(reference, image, mask)
    error = jnp.abs(both.reference - both.image)
    p = jnp.asarray(p, error.dtype)
    largest = jnp.max(error)
    # The distance does not depend on the unit in which errors are measured: the unit needs no derivative.
    unit = jax.lax.stop_gradient(jnp.where(largest > 0, largest, 1))
    exponent = jnp.where(jnp.isinf(p), 1, p)
    nonzero = error != 0  # true for NaN, which must be seen in the sum
    total = jnp.sum(jnp.where(nonzero, jnp.where(nonzero, error / unit, 1) ** exponent, 0))
    vanishes = total == 0
    distance = jnp.where(vanishes, 0, unit * jnp.where(vanishes, 1, total) ** (1 / exponent))
    # Written so that where nothing differs the derivative is 0, and not shared by all samples.
    distance = jnp.where(jnp.isinf(p), jnp.where(largest == 0, 0, largest), distance)
    return jnp.where((both.samples > 0) & (p > 0), distance, jnp.nan)


@jax.jit
def _psnr(reference: Array, image: Array, mask: Array | None, data_range: RealScalar) -> Array:
    noise = _mean_square_error(pair(reference, image, mask))
    peak = jnp.asarray(data_range, noise.dtype)
    return decibels(jnp.where(peak > 0, peak, jnp.nan) ** 2, noise)


@jax.jit
def _snr(reference: Array, image: Array, mask: Array | None) -> Array:
    both = pair(reference, image, mask)
    return decibels(jnp.sum(both.reference**2) / both.samples, _mean_square_error(both))


@jax.jit
def _range_snr(
    reference: Array, image: Array, mask: Array | None, bounds: tuple[RealScalar, RealScalar] | None
) -> Array:
    both = pair(reference, image, mask)
    seen = True if both.mask is None else over_channels(both.mask, both.reference)
    error = both.reference - both.image
    # In two passes: the mean of squares less the square of the mean would cancel for a nearly constant error.
    deviation = jnp.where(seen, error - jnp.sum(error) / both.samples, 0)
    if bounds is None:
        low = jnp.min(jnp.where(seen, both.reference, jnp.inf))
        high = jnp.max(jnp.where(seen, both.reference, -jnp.inf))
        span = high - low
    else:
        span = jnp.asarray(bounds[1], error.dtype) - jnp.asarray(bounds[0], error.dtype)
        span = jnp.where(span > 0, span, jnp.nan)
    return decibels(span**2, jnp.sum(deviation**2) / both.samples)


def _mean_square_error(both: Pair) -> Array:
    return jnp.sum((both.reference - both.image) ** 2) / both.samples


def _safe_sqrt(square: Array) -> Array:
    """Returns a square root whose derivative at 0 is 0."""
    return jnp.where(square == 0, 0, jnp.sqrt(jnp.where(square == 0, 1, square)))
