"""Sums of neighbouring pixels, weighted by a kernel along each axis: what every interpolation is made of."""

import operator
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped


def _keys(a: float) -> np.ndarray:
    """Keys's cubic kernel (1981, Eq. 4) of this parameter."""
    return np.array([[0, a, -2 * a, a], [1, 0, -(a + 3), a + 2], [0, -a, 2 * a + 3, -(a + 2)], [0, 0, a, -a]])


KERNELS = {
    "nearest": np.array([[1.0]]),
    "bilinear": np.array([[1.0, -1.0], [0.0, 1.0]]),
    "bicubic": _keys(-0.5),
    "bicubic_opencv": _keys(-0.75),
}
"""[k, p] is the coefficient of fᵖ in the weight of the k-th pixel read, at the fraction f behind the pixel before."""


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def weighted_sum(
    kernel: str,
    orders: tuple[int, int],
    width: int | None,
    pixels: Shaped[Array, " size *channels"],
    first: Int[Array, "*points"],
    widths: Int[Array, "*points"],
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
) -> Float[Array, "*points_and_channels"]:
    """Sums the n × n pixels that begin at `first`, weighted along both axes.

    Args:
        kernel: A name in `KERNELS`, of n weights.
        orders: How often the weights along x and y are differentiated.
        width: Of the image, in pixels, where it is the same for all points; that is faster. Else `widths` counts.
        pixels: The image row by row. All pixels that a point reads must be among them.
        first: The places in it of the first pixel, left and above, that each point reads.
        widths: The width of the image that each point reads.
        x: The fraction along x that the kernel takes.
        y: Along y.

    Returns:
        The sums, in the dtype of x and y. Differentiable with respect to floating pixels, x and y, any number of times.
        A derivative by x or y is a sum of the same kind, several times cheaper than what automatic differentiation
        makes of one, which keeps every pixel that was read.
    """
    across, down = (_weights(KERNELS[kernel], order, f) for order, f in zip(orders, (x, y), strict=True))
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

    return reduce(operator.add, [jnp.expand_dims(down[k], trailing) * row_sum(k) for k in range(count)])


@partial(weighted_sum.defjvp, symbolic_zeros=True)
def _weighted_sum_jvp(kernel, orders, width, primals, tangents):
    pixels, first, widths, x, y = primals
    change, _, _, *directions = tangents
    parts = [] if _is_zero(change) else [weighted_sum(kernel, orders, width, change, first, widths, x, y)]
    for axis, direction in enumerate(directions):
        higher = tuple(order + int(axis == k) for k, order in enumerate(orders))
        if higher[axis] < KERNELS[kernel].shape[1] and not _is_zero(direction):
            slopes = weighted_sum(kernel, higher, width, pixels, first, widths, x, y)
            parts.append(slopes * jnp.expand_dims(direction, tuple(range(x.ndim, slopes.ndim))))
    sums = weighted_sum(kernel, orders, width, pixels, first, widths, x, y)
    return sums, reduce(operator.add, parts) if parts else jnp.zeros_like(sums)


def _is_zero(tangent) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def _weights(kernel: np.ndarray, order: int, fraction: Float[Array, "*points"]) -> list[Float[Array, "*points"]]:
    weights = []
    for piece in kernel:
        *lower, highest = np.polynomial.polynomial.polyder(piece, order).tolist()
        weight = highest
        for coefficient in reversed(lower):
            weight = weight * fraction + coefficient
        weights.append(jnp.broadcast_to(jnp.asarray(weight, fraction.dtype), fraction.shape))
    return weights
