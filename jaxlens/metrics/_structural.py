"""Metrics of local structure: the universal quality index (Section 2.5) and the structural similarity index.

Both compare two images window by window and average over the windows. They follow the rules of
`jaxlens.metrics`, and these on windows:

- A window counts when it lies wholly inside the image; there is no padding.
- With a mask, a window counts when, moreover, all its pixels are in the mask: the mask's border is treated as
  the image's own. So a mask that is True everywhere changes nothing, what is hidden never enters a window,
  and windows of even side need no centre. A mask of scattered holes leaves few windows; one that leaves none
  gives NaN.
- Channels are compared one by one; the mean is over all windows of all channels.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxlens.metrics._inputs import (
    Image,
    Mask,
    RealScalar,
    check_data_range,
    check_images,
    check_positive,
    check_window,
    over_channels,
    pair,
)
from jaxlens.metrics._windows import (
    Kernel,
    LocalStatistics,
    Planes,
    compare_windows,
    gaussian_kernel,
    uniform_kernel,
    whole_windows,
)

UQI_WINDOW = 8
SSIM_SIGMA = 1.5


class QualityFactors(NamedTuple):
    """The three factors of the universal quality index, each a mean over the windows.

    In a window the index is their product; the product of these means is only near the mean index.

    Attributes:
        correlation: of the two images in a window, in [−1, 1]. Where both are flat it is 1; where one is, 0.
        luminance: how near the means are, in [−1, 1]: 2 x̄ ȳ / (x̄² + ȳ²); 1 where both means are 0. It is
            negative only where the means' signs differ.
        contrast: how near the standard deviations are, in [0, 1]: 2 σx σy / (σx² + σy²); 1 where both are 0.
    """

    correlation: Float[Array, ""]
    luminance: Float[Array, ""]
    contrast: Float[Array, ""]


def uqi(reference: Image, image: Image, *, window: int = UQI_WINDOW, mask: Mask | None = None) -> Float[Array, ""]:
    """Returns the universal quality index of Wang and Bovik (IEEE Signal Processing Letters 9(3), 2002), in [−1, 1].

    In each window the index is the product of correlation, luminance and contrast,
    4 σxy x̄ ȳ / ((σx² + σy²)(x̄² + ȳ²)). A window in which both images are flat has no structure to compare:
    there the index is its luminance factor, and 1 if both are black, as in the authors' own program. That
    program also scores 1 a window that is not flat but has both means exactly 0; here it is scored by its
    correlation and contrast, the factors that are defined.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        window: the side of the sliding window in pixels; static under `jax.jit`.
        mask: `(H, W)` boolean, True where a pixel counts; None for all. Windows must lie wholly inside it.

    Returns:
        The mean of the index over all windows; 1 for equal images. NaN if no window counts. Differentiable
        except where a window is flat in both images: there the flat term's derivative is taken.

    Raises:
        ValueError: if the shapes do not fit, or the window is larger than the image.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> image = np.random.default_rng(0).uniform(size=(32, 32))
        >>> round(float(metrics.uqi(image, image)), 4), round(float(metrics.uqi(image, 2 * image)), 4)
        (1.0, 0.64)
    """
    images = check_images(reference, image, mask)
    check_window("window", window, images[0].shape)
    return _uqi(*images, window=int(window))


def uqi_components(
    reference: Image, image: Image, *, window: int = UQI_WINDOW, mask: Mask | None = None
) -> QualityFactors:
    """Returns the factors of the universal quality index: loss of correlation, luminance and contrast distortion.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        window: the side of the sliding window in pixels; static under `jax.jit`.
        mask: `(H, W)` boolean, True where a pixel counts; None for all. Windows must lie wholly inside it.

    Returns:
        The mean of each factor over all windows, 1 for equal images; NaN if no window counts. Flat windows
        contribute the values that `QualityFactors` names, and a derivative of 0 to correlation and contrast.

    Raises:
        ValueError: if the shapes do not fit, or the window is larger than the image.
    """
    images = check_images(reference, image, mask)
    check_window("window", window, images[0].shape)
    return _uqi_components(*images, window=int(window))


def ssim(
    reference: Image,
    image: Image,
    *,
    data_range: RealScalar,
    window: Literal["gaussian", "uniform"] = "gaussian",
    size: int | None = None,
    sigma: float = SSIM_SIGMA,
    k1: RealScalar = 0.01,
    k2: RealScalar = 0.03,
    sample_covariance: bool = False,
    mask: Mask | None = None,
) -> Float[Array, ""]:
    """Returns the structural similarity of Wang, Bovik, Sheikh, Simoncelli (IEEE Trans. Image Processing 13(4), 2004).

    The defaults are that paper's: an 11×11 Gaussian window of σ = 1.5, and windows wholly inside the image.
    They agree with scikit-image's `structural_similarity(..., gaussian_weights=True, sigma=1.5,
    use_sample_covariance=False)`; `window="uniform", sample_covariance=True` agrees with its own defaults.

    Args:
        reference: `(H, W)` or `(H, W, C)`, any real dtype.
        image: the same shape.
        data_range: L, the range that samples may span: 255 for 8-bit images, 1 for images in [0, 1].
        window: the weights within a window.
        size: the window's side in pixels; by default 2 ⌊3.5 σ + ½⌋ + 1 (11 for σ = 1.5) if Gaussian, else 7.
        sigma: the Gaussian's standard deviation in pixels; unused for a uniform window.
        k1: the constant that steadies the luminance term, C1 = (k1 L)²; above 0.
        k2: the constant that steadies the contrast term, C2 = (k2 L)²; above 0. (`uqi` has neither.)
        sample_covariance: divide by n² − 1 rather than n², n being the window's side.
        mask: `(H, W)` boolean, True where a pixel counts; None for all. Windows must lie wholly inside it.
            `window`, `size`, `sigma` and `sample_covariance` are static under `jax.jit`.

    Returns:
        The mean index over all windows and channels, at most 1, and 1 only for equal images; NaN if no window
        counts. Smooth everywhere.

    Raises:
        ValueError: if the shapes do not fit, the window is larger than the image, or a number that must be
            above 0 is known and is not.

    Example:
        >>> import numpy as np
        >>> from jaxlens import metrics
        >>> image = np.random.default_rng(0).uniform(size=(32, 32))
        >>> round(float(metrics.ssim(image, image, data_range=1.0)), 4)
        1.0
    """
    check_data_range(data_range)
    check_positive("sigma", sigma, "It is the Gaussian window's standard deviation in pixels.")
    check_positive("k1", k1, "The original paper has 0.01.")
    check_positive("k2", k2, "The original paper has 0.03.")
    if window not in ("gaussian", "uniform"):
        raise ValueError(f'window is {window!r}; choose "gaussian" or "uniform".')
    if size is None:
        size = gaussian_size(sigma) if window == "gaussian" else 7
    images = check_images(reference, image, mask)
    check_window("size", size, images[0].shape)
    if sample_covariance and size == 1:
        raise ValueError("sample_covariance needs windows of more than one pixel; size is 1.")
    kernel = gaussian_kernel(int(size), float(sigma)) if window == "gaussian" else uniform_kernel(int(size))
    return _ssim(*images, data_range, k1, k2, kernel=kernel, sample_covariance=bool(sample_covariance))


def gaussian_size(sigma: float) -> int:
    """Returns the side of the Gaussian window: cut at 3.5 σ, as in scikit-image; 11 for the default σ = 1.5."""
    return 2 * int(3.5 * sigma + 0.5) + 1


@partial(jax.jit, static_argnames=("window",))
def _uqi(reference: Array, image: Array, mask: Array | None, *, window: int) -> Array:
    both = pair(reference, image, mask)
    (index,) = compare_windows(_quality_index, both.reference, both.image, uniform_kernel(window))
    return _mean_over_windows(index, both.mask, window)


@partial(jax.jit, static_argnames=("window",))
def _uqi_components(reference: Array, image: Array, mask: Array | None, *, window: int) -> QualityFactors:
    both = pair(reference, image, mask)
    factors = compare_windows(_quality_factors, both.reference, both.image, uniform_kernel(window))
    return QualityFactors(*(_mean_over_windows(factor, both.mask, window) for factor in factors))


@partial(jax.jit, static_argnames=("kernel", "sample_covariance"))
def _ssim(
    reference: Array,
    image: Array,
    mask: Array | None,
    data_range: RealScalar,
    k1: RealScalar,
    k2: RealScalar,
    *,
    kernel: Kernel,
    sample_covariance: bool,
) -> Array:
    both = pair(reference, image, mask)
    dtype = both.reference.dtype
    peak = jnp.asarray(data_range, dtype)
    peak = jnp.where(peak > 0, peak, jnp.nan)
    c1, c2 = (jnp.asarray(k1, dtype) * peak) ** 2, (jnp.asarray(k2, dtype) * peak) ** 2
    if sample_covariance:
        # Scaling both variances and the covariance by n²/(n² − 1) is the same as scaling C2 by the inverse.
        pixels = len(kernel) ** 2
        c2 = c2 * ((pixels - 1) / pixels)
    (index,) = compare_windows(_similarity_index, both.reference, both.image, kernel, c1, c2)
    return _mean_over_windows(index, both.mask, len(kernel))


def _similarity_index(statistics: LocalStatistics, c1: Array, c2: Array) -> Planes:
    mean_x, mean_y, variance_x, variance_y, covariance = statistics
    luminance = (2 * mean_x * mean_y + c1) / (mean_x * mean_x + mean_y * mean_y + c1)
    return (luminance * (2 * covariance + c2) / (variance_x + variance_y + c2),)


def _quality_index(statistics: LocalStatistics) -> Planes:
    # The product of correlation and contrast needs no square roots, nor their derivatives.
    variances = statistics.variance_x + statistics.variance_y
    return (_ratio(2 * statistics.covariance, variances) * _luminance(statistics),)


def _quality_factors(statistics: LocalStatistics) -> Planes:
    one = lax.full_like(statistics.mean_x, 1)
    flat_x, flat_y = statistics.variance_x == 0, statistics.variance_y == 0
    either = flat_x | flat_y
    when_flat = (flat_x & flat_y).astype(one.dtype)
    variance_x = lax.select(either, one, statistics.variance_x)
    variance_y = lax.select(either, one, statistics.variance_y)
    # Two square roots, because the product of two small variances could underflow.
    deviations = lax.sqrt(variance_x) * lax.sqrt(variance_y)
    correlation = lax.select(either, when_flat, statistics.covariance / deviations)
    contrast = lax.select(either, when_flat, 2 * deviations / (variance_x + variance_y))
    return correlation, _luminance(statistics), contrast


def _luminance(statistics: LocalStatistics) -> Array:
    mean_x, mean_y = statistics.mean_x, statistics.mean_y
    return _ratio(2 * mean_x * mean_y, mean_x * mean_x + mean_y * mean_y)


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Returns a ratio that is 1, with a derivative of 0, where the denominator vanishes."""
    vanishes = denominator == 0
    one = lax.full_like(denominator, 1)
    return lax.select(vanishes, one, numerator / lax.select(vanishes, one, denominator))


def _mean_over_windows(index: Array, mask: Array | None, size: int) -> Array:
    if mask is None:
        return jnp.mean(index)
    whole = whole_windows(mask, size)
    channels = index.size // whole.size
    counted = jnp.where(over_channels(whole, index), index, 0)
    return jnp.sum(counted) / (jnp.sum(whole).astype(index.dtype) * channels)
