"""Image profiles (integral projections): means along rows and columns, and how far one has moved against another."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from jaxlens.numerics import as_floating, epsilon


class IntegralProjections(eqx.Module):
    """What `integral_projections` returns.

    Attributes:
        horizontal: `(H,)`, the mean of each row: a profile from the top down.
        vertical: `(W,)`, the mean of each column: a profile from left to right.
        horizontal_valid: `(H,)`, false for rows without any pixel inside the mask; there the mean is zero.
        vertical_valid: `(W,)`, the same for columns.
    """

    horizontal: Float[Array, " height"]
    vertical: Float[Array, " width"]
    horizontal_valid: Bool[Array, " height"]
    vertical_valid: Bool[Array, " width"]


class ProfileDisplacement(eqx.Module):
    """What `profile_displacement` returns, in pixels: `other[i + displacement[i]]` looks like `reference[i]`.

    Attributes:
        displacement: `(N,)`, at each element of the reference; zero where not valid.
        score: `(N,)`, the normalized cross-correlation of the best match, −1 to 1; zero where there is none.
        valid: `(N,)`, where the window lies within the vector, has some contrast, and its best match is a peak that
            lies inside the range searched.
        shift: The one shift of the whole vector that correlates best.
        shift_score: Its normalized cross-correlation.
    """

    displacement: Float[Array, " length"]
    score: Float[Array, " length"]
    valid: Bool[Array, " length"]
    shift: Float[Array, ""]
    shift_score: Float[Array, ""]


@jax.jit
def integral_projections(
    image: Real[ArrayLike, "height width"], *, mask: Bool[ArrayLike, "height width"] | None = None
) -> IntegralProjections:
    """Computes the integral projection vectors of an image (Section 2.4 of the paper).

    They are means, not sums, so that neither the picture's size nor the mask's shape shows in them. The sums are
    `W · horizontal` and `H · vertical` without a mask.

    Args:
        image: `(H, W)`, of any real dtype; in colour, one channel at a time.
        mask: `(H, W)`, the pixels that count; all by default. Others may be NaN.

    Returns:
        An `IntegralProjections`, in the image's dtype if that is floating. Differentiable with respect to the image.

    Raises:
        ValueError: shapes that do not fit.

    Example:
        >>> import jax.numpy as jnp, jaxlens.profiles
        >>> jaxlens.profiles.integral_projections(jnp.asarray([[0.0, 2.0], [4.0, 6.0]])).horizontal.tolist()
        [1.0, 5.0]
    """
    image = as_floating(image)
    if image.ndim != 2 or 0 in image.shape:
        raise ValueError(f"an image must have shape (H, W) and at least one pixel, got {image.shape}")
    used = jnp.ones(image.shape, bool) if mask is None else jnp.asarray(mask)
    if used.shape != image.shape or used.dtype != bool:
        raise ValueError(
            f"mask must be an array of booleans of the image's shape {image.shape}, got {used.dtype} {used.shape}"
        )
    values = jnp.where(used, image, 0)

    def mean(axis):
        count = jnp.sum(used, axis=axis)
        return jnp.sum(values, axis=axis) / jnp.maximum(count, 1).astype(image.dtype), count > 0

    (horizontal, rows), (vertical, columns) = mean(1), mean(0)
    return IntegralProjections(horizontal, vertical, rows, columns)


@partial(jax.jit, static_argnames=("window", "largest"))
def profile_displacement(
    reference: Float[ArrayLike, " length"],
    other: Float[ArrayLike, " length"],
    *,
    window: int = 31,
    largest: int = 16,
) -> ProfileDisplacement:
    """Measures how far the features of one profile have moved in another, along it.

    Around each element of the reference a window is compared with all windows of the other vector that lie at most
    `largest` elements away, by normalized cross-correlation: brightness and contrast do not matter. The peak is found
    to a fraction of an element by the parabola through its three highest values.

    Args:
        reference: `(N,)`, a vector of `integral_projections`.
        other: `(N,)`, that of the distorted image.
        window: Length of the window in elements, odd, at least 3. It should hold a feature and its surroundings;
            displacements that change much within a window are blurred.
        largest: The largest displacement to look for, at least 1.

    Returns:
        A `ProfileDisplacement`. Differentiable with respect to both vectors (through the parabola; which integer
        displacement is best is held fixed).

    Raises:
        ValueError: shapes that do not fit; a window that is even, too short, or longer than the vectors; no room for
            the displacements.

    Example:
        >>> import jax.numpy as jnp, jaxlens.profiles
        >>> x = jnp.arange(100.0)
        >>> profile, moved = jnp.sin(x**2 / 200), jnp.sin((x - 3) ** 2 / 200)
        >>> result = jaxlens.profiles.profile_displacement(profile, moved)
        >>> round(float(result.displacement[50]), 1)
        3.0
    """
    reference, other = as_floating(reference), as_floating(other)
    if reference.ndim != 1 or reference.shape != other.shape:
        raise ValueError(f"both vectors must have the same shape (N,), got {reference.shape} and {other.shape}")
    length = reference.shape[0]
    if window < 3 or window % 2 == 0 or window > length:
        raise ValueError(f"window must be odd, at least 3 and at most the vectors' length {length}, got {window}")
    if not 1 <= largest < length - 2:
        raise ValueError(f"largest must be at least 1 and less than the vectors' length {length} − 2, got {largest}")
    dtype = jnp.result_type(reference, other)
    # Correlations do not mind; the sums of squares lose less to rounding.
    reference, other = (vector.astype(dtype) - jnp.mean(vector).astype(dtype) for vector in (reference, other))
    place = jnp.arange(length)[None, :] + jnp.arange(-largest, largest + 1)[:, None]
    inside = (place >= 0) & (place < length)
    moved = jnp.where(inside, other[jnp.clip(place, 0, length - 1)], 0)
    fixed = jnp.where(inside, reference[None, :], 0)
    in_windows = partial(_window_sums, window=window)
    complete = in_windows(inside.astype(dtype)) > window - 0.5
    local = jnp.where(complete, _correlation(fixed, moved, inside, in_windows), -jnp.inf)
    displacement, score, valid = _peak(local, largest)
    whole = _correlation(fixed, moved, inside, partial(jnp.sum, axis=1, keepdims=True))
    shift, shift_score, _ = _peak(whole, largest)
    return ProfileDisplacement(displacement, score, valid, shift[0], shift_score[0])


def _window_sums(values: Float[Array, "shifts length"], *, window: int) -> Float[Array, "shifts length"]:
    zero = np.zeros((), values.dtype)  # a constant, or JAX has no derivative for it
    return lax.reduce_window(values, zero, lax.add, (1, window), (1, 1), "SAME")


def _correlation(
    fixed: Float[Array, "shifts length"],
    moved: Float[Array, "shifts length"],
    inside: Bool[Array, "shifts length"],
    sums: Callable[[Array], Array],
) -> Float[Array, "shifts columns"]:
    """Returns normalized cross-correlations of what lies inside, −∞ where one of the two has no contrast."""
    count = jnp.maximum(sums(inside.astype(fixed.dtype)), 1)
    mean_fixed, mean_moved = sums(fixed) / count, sums(moved) / count
    square_fixed, square_moved = sums(fixed**2), sums(moved**2)
    variance_fixed = square_fixed - count * mean_fixed**2
    variance_moved = square_moved - count * mean_moved**2
    rounding = 64 * epsilon(fixed.dtype)
    contrast = (variance_fixed > rounding * square_fixed) & (variance_moved > rounding * square_moved)
    product = jnp.where(contrast, variance_fixed, 1) * jnp.where(contrast, variance_moved, 1)
    covariance = sums(fixed * moved) - count * mean_fixed * mean_moved
    return jnp.where(contrast, covariance / jnp.sqrt(product), -jnp.inf)


def _peak(scores: Float[Array, "shifts columns"], largest: int) -> tuple[Array, Array, Array]:
    """Returns where each column is largest, between its entries, and how large, and whether that is a peak."""
    best = jnp.argmax(scores, axis=0)
    middle = jnp.clip(best, 1, 2 * largest - 1)
    below, here, above = (jnp.take_along_axis(scores, (middle + step)[None, :], axis=0)[0] for step in (-1, 0, 1))
    valid = (best == middle) & jnp.isfinite(below) & jnp.isfinite(above)
    below, here, above = (jnp.where(valid, value, 0) for value in (below, here, above))
    bend = below - 2 * here + above  # not positive at a maximum
    valid &= bend < 0
    offset = jnp.where(valid, 0.5 * (below - above) / jnp.where(valid, bend, -1), 0)
    displacement = jnp.where(valid, (middle - largest).astype(scores.dtype) + offset, 0)
    height = jnp.minimum(here - 0.25 * (below - above) * offset, 1)
    return displacement, jnp.where(valid, height, 0), valid
