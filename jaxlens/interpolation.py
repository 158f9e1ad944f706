"""Sums of neighbouring pixels, weighted by a kernel along each axis: what every interpolation is made of."""

import math
import operator
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxlens.batching import in_turns_if_large
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


PERIODIC = ("reflect", "wrap")
"""The borders that repeat the image."""


class Grid(NamedTuple):
    """An image among pixels that are stored row by row: numbers, or planes that differ from point to point.

    Around it are as many pixels of its border as the kernel has weights.
    """

    offset: int | Int[Array, "*points"]
    height: int | Int[Array, "*points"]
    width: int | Int[Array, "*points"]


def interpolated(
    image: Shaped[Array, "height width *channels"],
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
    padding: Shaped[Array, "*padding"],
    *,
    kernel: str,
    border: str | None,
    dtype: jax.typing.DTypeLike,
) -> Shaped[Array, "*points_and_channels"]:
    """Sums the n × n pixels about each position, weighted along both axes.

    Args:
        image: The pixels.
        x: Positions along x: they, and the n pixels about them, must not lie beyond the border. Of the border that
            repeats the image they may be any, and at NaN the sums mean nothing.
        y: Along y.
        padding: In the image's dtype, what the constant border is made of: a number, or one for each channel.
        kernel: A name in `KERNELS`, of n weights.
        border: What surrounds the image by n pixels; None is nothing, and the kernel begins at the floor of a position.
        dtype: The dtype of the result; the sums are computed in that of x and y: see `as_pixels`.

    Returns:
        The sums. Differentiable, where they are floating, with respect to floating pixels and padding, x and y, any
        number of times. A derivative by x or y is a sum of the same kind, several times cheaper than what automatic
        differentiation makes of one, which keeps every pixel that was read. Of a batch the images take turns, so that
        each finds what is stored meanwhile in the cache.
    """
    static = {"kernel": kernel, "border": border, "orders": (0, 0), "dtype": jnp.dtype(dtype)}
    return _interpolated.bind(image[None], x[None], y[None], padding[None], **static)[0]


def surrounded(
    image: Shaped[Array, "height width *channels"], padding: Array, kernel: str, border: str | None
) -> Shaped[Array, " size *channels"]:
    """Returns the pixels of an image, row by row, with its border around it."""
    count, channels = len(KERNELS[kernel]), image.shape[2:]
    around = [(count, count)] * 2 + [(0, 0)] * len(channels)
    if border == "constant":
        one_for_all = padding.size == 1
        image = jnp.pad(image, around, constant_values=padding.reshape(()) if one_for_all else 0)
        if not one_for_all:
            within = jnp.pad(jnp.ones(image.shape, bool)[count:-count, count:-count], around)
            image = jnp.where(within, image, padding[None, None])
    elif border == "edge":
        image = jnp.pad(image, around, mode="edge")
    elif border is not None:
        rows, columns = (periodic(jnp.arange(-count, size + count), size, border)[0] for size in image.shape[:2])
        image = image[rows][:, columns]
    return image.reshape(-1, *channels)


def periodic(pixel: Array, size: int | Array, border: str) -> tuple[Array, Bool[Array, "*points"]]:
    """Returns the pixel that stands at a number outside the image, and whether it belongs to a mirror image."""
    if border == "wrap":
        return jnp.mod(pixel, size), jnp.zeros_like(pixel, bool)
    pixel = jnp.mod(pixel, 2 * size)
    return jnp.where(pixel < size, pixel, 2 * size - 1 - pixel), pixel >= size


def weighted_sum(
    pixels: Shaped[Array, " size *channels"],
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
    grid: Grid,
    *,
    kernel: str,
    border: str | None,
    dtype: jax.typing.DTypeLike,
    orders: tuple[int, int] = (0, 0),
    shifted: bool = True,
) -> Shaped[Array, "*points_and_channels"]:
    """Does what `interpolated` does with pixels that are `surrounded`, one computation for all points.

    Args:
        pixels: The pixels.
        x: As there.
        y: As there.
        grid: The image among the pixels.
        kernel: As there.
        border: As there.
        dtype: As there.
        orders: How often the weights along x and y are differentiated.
        shifted: Read pixels that begin later by one index: one computation, and one check, for all.
    """
    count = len(KERNELS[kernel])
    width = grid.width + (0 if border is None else 2 * count)
    (left, x, *signs_x), (top, y, *signs_y) = (
        _first_pixel(position, size, kernel, border) for position, size in ((x, grid.width), (y, grid.height))
    )
    first = grid.offset + top * width + left

    def sums() -> Array:
        # The fractions are computed here: a loop that reads fewer planes is worth a little arithmetic.
        across, down = (
            [math.prod([weight, *signs * (order % 2)]) for weight in kernel_weights(kernel, order, p - jnp.floor(p))]
            for order, p, signs in zip(orders, (x, y), (signs_x, signs_y), strict=True)
        )
        trailing = tuple(range(x.ndim, x.ndim + pixels.ndim - 1))

        def value(row: int, column: int) -> Array:
            skipped = row * width + column
            if shifted and not isinstance(skipped, jax.Array):
                values = pixels[skipped : pixels.shape[0] - (count - 1) * (width + 1) + skipped].at[first]
            else:
                values = pixels.at[first + skipped]
            return values.get(mode="promise_in_bounds", wrap_negative_indices=False).astype(x.dtype)

        def row_sum(row: int) -> Array:
            return reduce(operator.add, [jnp.expand_dims(across[k], trailing) * value(row, k) for k in range(count)])

        total = reduce(operator.add, [jnp.expand_dims(down[k], trailing) * row_sum(k) for k in range(count)])
        return as_pixels(total, dtype)

    # In a loop of its own: merged with others that read the same pixels, none is vectorized.
    return in_memory(sums, first)


def _first_pixel(
    position: Float[Array, "*points"], size: int | Int[Array, "*points"], kernel: str, border: str | None
) -> tuple[Int[Array, "*points"], Float[Array, "*points"], *tuple[Float[Array, "*points"], ...]]:
    """Returns the first of the pixels that a kernel reads along an axis, and a position of the fraction it takes.

    Where the image is mirrored also the sign, −1 in a mirror image, with which that position moves.
    """
    if border in ("edge", *PERIODIC):
        position = jnp.where(position == position, position, 0)
    pixel = jnp.floor(position)
    if border is None:
        return pixel.astype(jnp.int32), position
    count, fraction = len(KERNELS[kernel]), position - pixel
    if count == 1:
        # floor(x + 1/2), without its rounding error.
        pixel, fraction = pixel + (fraction >= 0.5), jnp.zeros_like(fraction)
    before = count - (count - 1) // 2
    if border not in PERIODIC:
        return pixel.astype(jnp.int32) + before, position
    pixel, mirrored = periodic(pixel, size, border)
    # A mirror image is seen from the other side: the position lies behind the pixel before.
    first = (pixel - (mirrored & (fraction > 0))).astype(jnp.int32) + before
    if border == "wrap":
        return first, position
    sign = jnp.where(mirrored, -1, 1).astype(position.dtype)
    return first, sign * position, sign


_interpolated = Primitive("interpolated")
# Images, positions and paddings have a leading axis: of a batch, or of length one where all of it share them.


def _of_one(image, x, y, padding, *, kernel, border, dtype, orders, shifted=True):
    grid, pixels = Grid(0, *image.shape[:2]), surrounded(image, padding, kernel, border)
    options = {"kernel": kernel, "border": border, "dtype": dtype, "orders": orders, "shifted": shifted}
    return weighted_sum(pixels, x, y, grid, **options)


def _of_all(*arguments, **static):
    one, several = partial(_of_one, **static), [not _is_one(array.shape[0]) for array in arguments]
    shared = [None if many else array[0] for array, many in zip(arguments, several, strict=True)]
    if not any(several):
        return one(*shared)[None]

    def each(batched: list[Array]) -> Array:
        turn = iter(batched)
        return one(*(next(turn) if array is None else array for array in shared))

    batched = [array for array, many in zip(arguments, several, strict=True) if many]
    return in_turns_if_large(each, batched, arguments[1].size // arguments[1].shape[0])


def _is_one(size) -> bool:
    return isinstance(size, int) and size == 1


def _abstract(image, x, y, padding, *, dtype, **static):
    sizes = [array.shape[0] for array in (image, x, y, padding)]
    size = next((size for size in sizes if not _is_one(size)), 1)
    return ShapedArray((size, *x.shape[1:], *image.shape[3:]), dtype)


def _jvp(primals, tangents, *, orders, dtype, **static):
    x, y = primals[1:3]
    by_image, *directions, by_padding = tangents
    again = partial(_interpolated.bind, dtype=dtype, **static)
    sums = again(*primals, orders=orders)
    if not jnp.issubdtype(dtype, jnp.floating):
        return sums, _zero_of(sums)
    parts = []
    if not (isinstance(by_image, ad.Zero) and isinstance(by_padding, ad.Zero)):
        changes = (ad.instantiate_zeros(change) for change in (by_image, by_padding))
        parts.append(again(next(changes), x, y, next(changes), orders=orders))
    for axis, direction in enumerate(directions):
        higher = tuple(order + int(axis == k) for k, order in enumerate(orders))
        if higher[axis] < KERNELS[static["kernel"]].shape[1] and not isinstance(direction, ad.Zero):
            slopes = again(*primals, orders=higher)
            parts.append(slopes * jnp.expand_dims(direction, range(direction.ndim, sums.ndim)).astype(dtype))
    return sums, reduce(operator.add, parts) if parts else _zero_of(sums)


def _zero_of(sums):
    return ad.Zero(jax.typeof(sums).to_tangent_aval())


def _transpose(cotangent, image, x, y, padding, **static):
    if isinstance(cotangent, ad.Zero):
        return ad.Zero(image.aval), None, None, ad.Zero(padding.aval)
    # Straight into the pixels: each of the shifted ones would be padded.
    linear = jax.linear_transpose(
        lambda image, padding: _of_all(image, x, y, padding, shifted=False, **static), image.aval, padding.aval
    )
    by_image, by_padding = linear(cotangent)
    return by_image, None, None, by_padding


def _batch(arguments, axes, **static):
    fronts = [a if axis is None else jnp.moveaxis(a, axis, 0) for a, axis in zip(arguments, axes, strict=True)]
    size = next(a.shape[0] for a, axis in zip(fronts, axes, strict=True) if axis is not None)
    lengths = [a.shape[int(axis is not None)] for a, axis in zip(fronts, axes, strict=True)]
    length = next((length for length in lengths if not _is_one(length)), 1)

    def merged(array: Array, axis: int | None) -> Array:
        if axis is None and _is_one(array.shape[0]):
            return array
        array = array[None] if axis is None else array
        whole = jnp.broadcast_to(array, (size, length, *array.shape[2:]))
        return whole.reshape(-1, *array.shape[2:])

    merged_arguments = (merged(a, axis) for a, axis in zip(fronts, axes, strict=True))
    sums = _interpolated.bind(*merged_arguments, **static)
    return sums.reshape(size, length, *sums.shape[1:]), 0


_interpolated.def_impl(lambda *arguments, **static: jax.jit(partial(_of_all, **static))(*arguments))
_interpolated.def_abstract_eval(_abstract)
mlir.register_lowering(_interpolated, mlir.lower_fun(_of_all, multiple_results=False))
batching.primitive_batchers[_interpolated] = _batch
ad.primitive_jvps[_interpolated] = _jvp
ad.primitive_transposes[_interpolated] = _transpose


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
