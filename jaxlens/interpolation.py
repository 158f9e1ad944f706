"""Sums of neighbouring pixels, weighted by a kernel along each axis: what every interpolation is made of."""

import operator
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import zero_from_primal
from jaxtyping import Array, Float, Int, Shaped

from jaxlens.memory import in_memory


def _keys(a: float) -> np.ndarray:
    """Keys's cubic kernel (1981, Eq. 4) of this parameter."""
    return np.array([[0, a, -2 * a, a], [1, 0, -(a + 3), a + 2], [0, -a, 2 * a + 3, -(a + 2)], [0, 0, a, -a]])


KERNELS = {
    "nearest": np.array([[1.0]]),
    "bilinear": np.array([[1.0, -1.0], [0.0, 1.0]]),
    "bicubic": _keys(-0.5),
    "bicubic_opencv": _keys(-0.75),
    "cubic_b_spline": np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6,
}
"""[k, p] is the coefficient of fᵖ in the weight of the k-th pixel read, at the fraction f behind the pixel before."""


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2, 3))
def weighted_sum(
    kernel: str,
    orders: tuple[int, int],
    width: int | None,
    dtype: jax.typing.DTypeLike,
    pixels: Shaped[Array, " size *channels"],
    first: Int[Array, "*points"],
    widths: Int[Array, "*points"] | None,
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
) -> Shaped[Array, "*points_and_channels"]:
    """Sums the n × n pixels that begin at `first`, weighted along both axes.

    Args:
        kernel: A name in `KERNELS`, of n weights.
        orders: How often the weights along x and y are differentiated.
        width: Of the image, in pixels, where it is the same for all points; that is faster. Else `widths` counts.
        dtype: Of the sums, which are computed in that of x and y: see `as_pixels`.
        pixels: The image row by row. All pixels that a point reads must be among them.
        first: The places in it of the first pixel, left and above, that each point reads.
        widths: The width of the image that each point reads.
        x: The positions along x: their fractions, behind the floor, are what the kernel takes.
        y: Along y.

    Returns:
        The sums. Differentiable, where they are floating, with respect to floating pixels, x and y, any number of
        times. A derivative by x or y is a sum of the same kind, several times cheaper than what automatic
        differentiation makes of one, which keeps every pixel that was read.
    """

    def sums() -> Array:
        # The fractions are computed here: a loop that reads fewer planes is worth a little arithmetic.
        across, down = (
            kernel_weights(kernel, order, p - jnp.floor(p)) for order, p in zip(orders, (x, y), strict=True)
        )
        count, trailing = len(across), tuple(range(x.ndim, x.ndim + pixels.ndim - 1))

        def value(row: int, column: int) -> Array:
            if width is None:
                values = pixels.at[first + row * widths + column]
            else:
                # The same index into pixels that begin later: one computation, and one check, for all.
                skipped = row * width + column
                values = pixels[skipped : pixels.shape[0] - (count - 1) * (width + 1) + skipped].at[first]
            return values.get(mode="promise_in_bounds", wrap_negative_indices=False).astype(x.dtype)

        def row_sum(row: int) -> Array:
            return reduce(operator.add, [jnp.expand_dims(across[k], trailing) * value(row, k) for k in range(count)])

        total = reduce(operator.add, [jnp.expand_dims(down[k], trailing) * row_sum(k) for k in range(count)])
        return as_pixels(total, dtype)

    # In a loop of its own: merged with others that read the same pixels, none is vectorized.
    return in_memory(sums, first)


@partial(weighted_sum.defjvp, symbolic_zeros=True)
def _weighted_sum_jvp(kernel, orders, width, dtype, primals, tangents):
    first, widths, x, y = primals[1:]
    change, _, _, *directions = tangents
    sums = weighted_sum(kernel, orders, width, dtype, *primals)
    if not jnp.issubdtype(dtype, jnp.floating):
        return sums, zero_from_primal(sums, symbolic_zeros=True)
    parts = [] if _is_zero(change) else [weighted_sum(kernel, orders, width, dtype, change, first, widths, x, y)]
    for axis, direction in enumerate(directions):
        higher = tuple(order + int(axis == k) for k, order in enumerate(orders))
        if higher[axis] < KERNELS[kernel].shape[1] and not _is_zero(direction):
            slopes = weighted_sum(kernel, higher, width, dtype, *primals)
            parts.append(slopes * jnp.expand_dims(direction, tuple(range(x.ndim, slopes.ndim))).astype(dtype))
    return sums, reduce(operator.add, parts) if parts else jnp.zeros_like(sums)


def _is_zero(tangent) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def kernel_weights(kernel: str, order: int, fraction: Float[Array, "*points"]) -> list[Float[Array, "*points"]]:
    """Returns the derivatives of this order of a kernel's weights along one axis."""
    weights = []
    for piece in KERNELS[kernel]:
        *lower, highest = np.polynomial.polynomial.polyder(piece, order).tolist()
        weight = highest
        for coefficient in reversed(lower):
            weight = weight * fraction + coefficient
        weights.append(jnp.broadcast_to(jnp.asarray(weight, fraction.dtype), fraction.shape))
    return weights


def as_pixels(samples: Float[Array, "*batch"], dtype: jax.typing.DTypeLike) -> Shaped[Array, "*batch"]:
    """Brings samples to the dtype of an image: integers rounded (halves to even) and saturated."""
    if jnp.issubdtype(dtype, jnp.floating):
        return samples.astype(dtype)
    if dtype == jnp.bool_:
        return samples >= 0.5
    low, high = float(jnp.iinfo(dtype).min), float(jnp.iinfo(dtype).max)
    if high > 2 ** (jnp.finfo(samples.dtype).nmant + 1):
        # The largest integer is not a float of this dtype; the float below it is the largest that fits.
        high = float(np.nextafter(np.asarray(high, samples.dtype), np.asarray(0, samples.dtype)))
    return jnp.clip(jnp.round(samples), low, high).astype(dtype)
