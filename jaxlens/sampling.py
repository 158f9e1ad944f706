"""Reading an image between its pixels: nearest, bilinear and bicubic, with borders and antialiasing."""

from functools import partial
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Real, Shaped

from jaxlens.numerics import as_points, epsilon, split
from jaxlens.pyramid import build_pyramid, footprint

Method = Literal["nearest", "bilinear", "bicubic", "bicubic_opencv"]
"""`bicubic` is Keys's kernel with a = −0.5 (third order exact), `bicubic_opencv` the same with OpenCV's a = −0.75."""

Border = Literal["constant", "edge", "reflect", "wrap"]
"""What lies outside the image. In `scipy.ndimage` these are `grid-constant`, `nearest`, `reflect` and `grid-wrap`."""

_TAPS = {"nearest": 1, "bilinear": 2, "bicubic": 4, "bicubic_opencv": 4}
_CUBIC = {"bicubic": -0.5, "bicubic_opencv": -0.75}
# Pixels beyond an image that no kernel reaches from.
_FAR = 8.0
# Pixels at an image's edge that points without a place in it may read, with weight zero.
_REACH = 3
# Probes along the longer axis of an antialiasing footprint.
_PROBES = 5


@partial(jax.jit, static_argnames=("method", "border", "antialias"))
def remap(
    image: Shaped[ArrayLike, "height width *channels"] | Bool[ArrayLike, "height width *channels"],
    coordinates: Float[ArrayLike, "*points 2"],
    *,
    method: Method = "bilinear",
    border: Border = "constant",
    fill: Real[ArrayLike, "*fill"] = 0.0,
    antialias: bool = False,
) -> Shaped[Array, "*points_and_channels"] | Bool[Array, "*points_and_channels"]:
    """Samples an image at pixel coordinates.

    Args:
        image: `(H, W)` or `(H, W, C)`, of any real dtype. A pixel that is not finite spoils the samples whose kernel
            spans it, even with weight zero, and no others.
        coordinates: `(..., 2)` source positions in pixels, (x, y) order, pixel centres at integers. Where one of
            the two is not finite the result is `fill`, whatever the border.
        method: The interpolation, see `Method`. Nearest rounds halves up.
        border: What lies outside the image, see `Border`: `constant` is `fill` (interpolated with the edge pixels, as
            OpenCV does), `edge` repeats the last pixel, `reflect` mirrors about the edge
            (d c b a | a b c d | d c b a), `wrap` continues on the other side.
        fill: The value outside the image: a number, or one for each channel. NaN marks, in a floating image, every
            sample that some of it would enter.
        antialias: Average over each output pixel's footprint in the source where the map shrinks the image. The
            footprint comes from the map's Jacobian, that is from neighbouring coordinates, which must then have
            shape `(H', W', 2)`. Where nothing shrinks the result is that of `antialias=False`.

    Returns:
        `(..., C)` or `(...)` samples in the dtype of the image; integers are rounded to the nearest (halves to even)
        and saturated (32-bit ones pass through single precision unless x64 is on). Differentiable with respect to
        the image (floating), the coordinates (except nearest) and the fill value; with respect to coordinates the
        derivative is that of the interpolant, and at pixels the one towards larger coordinates.

    Raises:
        ValueError: a shape, method, border or fill value that does not fit.
    """
    return resample(image, coordinates, method=method, border=border, fill=fill, antialias=antialias, computed=False)


def interpolate(image: Float[Array, "height width"], points: Float[Array, "*points 2"]) -> Float[Array, "*points"]:
    """Samples a finite image bilinearly, its edge repeated, without the checks and casts of `remap`: for residuals."""
    fill = jnp.zeros((1,), image.dtype)
    # Where it is differentiated, XLA computes the pixels' indices and their weights in different loops, which may round
    # a position that is whole to different sides. A nudge, as small as rounding itself, brings both to the same.
    nudge = 4 * epsilon(points.dtype) * max(image.shape)
    return _sample(image[..., None], split(points + nudge), fill, method="bilinear", border="edge", careful=False)[
        ..., 0
    ]


def resample(image, coordinates, *, method: str, border: str, fill, antialias: bool, computed: bool) -> Array:
    """Does what `remap` does, where the coordinates may be `computed` by the same compiled function.

    If they are, then splitting them at once undoes their interleaving. If not, that is done as they are read.
    """
    image, coordinates = jnp.asarray(image), as_points(coordinates)
    _check(image, coordinates, method, border, antialias)
    coordinates = coordinates.astype(jnp.promote_types(coordinates.dtype, jnp.float32))  # half cannot count pixels
    pixels = image if image.ndim == 3 else image[..., None]
    fill = jnp.asarray(fill)
    if fill.ndim > 1 or fill.shape not in ((), (1,), (pixels.shape[-1],)):
        raise ValueError(
            f"fill must be a number or one for each of the {pixels.shape[-1]} channels, got shape {fill.shape}"
        )
    fill = jnp.broadcast_to(fill, pixels.shape[-1:])
    if antialias:
        samples = _sample_footprint(pixels, coordinates, method, border, fill)
    else:
        # Points outside the image read its edge, with weight zero. Where nothing there can spoil them there is no need
        # for the care that keeps XLA from vectorizing the loop.
        edges = pixels[:_REACH], pixels[-_REACH:], pixels[:, :_REACH], pixels[:, -_REACH:]
        plain, careful = (partial(_sample, method=method, border=border, careful=flag) for flag in (False, True))
        safe = _all_finite(*lax.stop_gradient((fill, *edges)))
        points = lax.optimization_barrier(split(coordinates)) if computed else coordinates
        samples = lax.cond(safe, plain, careful, pixels, points, fill)
    samples = _cast(samples, image.dtype)
    return samples if image.ndim == 3 else samples[..., 0]


def _check(image: Array, coordinates: Array, method: str, border: str, antialias: bool) -> None:
    if image.ndim not in (2, 3) or 0 in image.shape:
        raise ValueError(f"an image has shape (H, W) or (H, W, C) and at least one pixel, got {image.shape}")
    if jnp.issubdtype(image.dtype, jnp.complexfloating):
        raise ValueError(f"an image must be real, got dtype {image.dtype}; sample its real and imaginary parts")
    if method not in get_args(Method):
        raise ValueError(f"method must be one of {', '.join(get_args(Method))}, got {method!r}")
    if border not in get_args(Border):
        raise ValueError(f"border must be one of {', '.join(get_args(Border))}, got {border!r}")
    if antialias and coordinates.ndim != 3:
        raise ValueError(
            "antialias=True needs coordinates on a grid, of shape (H, W, 2), to know the footprint of a pixel; "
            f"got {coordinates.shape}"
        )


def _working_dtype(image_dtype, coordinate_dtype):
    """The dtype to interpolate in: at least single precision, double where integers or coordinates need it."""
    if jnp.issubdtype(image_dtype, jnp.floating):
        return jnp.result_type(image_dtype, coordinate_dtype, jnp.float32)
    exact = jnp.dtype(image_dtype).itemsize <= 2
    return jnp.result_type(coordinate_dtype, jnp.float32 if exact else jnp.result_type(float))


def _sample(
    pixels: Array,
    points: Array | tuple[Array, Array],
    fill: Array,
    *,
    method: str,
    border: str,
    careful: bool,
) -> Float[Array, "*points channels"]:
    """Interpolates `(H, W, C)` pixels at coordinates, or at planes of x and y."""
    # The barrier keeps XLA from computing the coordinates again for every tap and channel.
    x, y = points if isinstance(points, tuple) else lax.optimization_barrier(split(points))
    height, width, channels = pixels.shape
    dtype = _working_dtype(pixels.dtype, x.dtype)
    return _interpolate(
        pixels.reshape(-1, channels),
        0,
        height,
        width,
        x,
        y,
        method=method,
        border=border,
        fill=fill,
        dtype=dtype,
        careful=careful,
    )


def _interpolate(pixels, offset, height, width, x, y, *, method, border, fill, dtype, careful):
    """Interpolates flattened pixels `(N, C)`, of which an image of this height and width begins at `offset`.

    The three may be numbers, or planes that differ from point to point. Unless `careful`, the fill value must be
    finite, and so must be the pixels that points without a place in the image read, with weight zero.
    """
    finite = jnp.isfinite(x) & jnp.isfinite(y)
    nowhere = -_FAR if border == "constant" else 0
    columns = _taps(jnp.where(finite, x, nowhere), width, method, border)
    rows = _taps(jnp.where(finite, y, nowhere), height, method, border)
    if border != "constant":
        # In the weights: a select on the total would keep XLA from vectorizing the loop.
        rows = [(row, jnp.where(finite, weight, 0)) for row, weight in rows]
    total = jnp.zeros((), dtype)
    for row, row_weight in rows:
        for column, column_weight in columns:
            value = pixels.at[offset + row * width + column].get(mode="promise_in_bounds")
            total = total + (row_weight * column_weight).astype(dtype)[..., None] * value.astype(dtype)
    if border == "constant":
        covered = jnp.asarray(sum(weight for _, weight in columns) * sum(weight for _, weight in rows))
    else:
        covered = finite
    share = (1 - covered.astype(dtype))[..., None]
    fill = jnp.expand_dims(fill.astype(dtype), range(x.ndim))
    if not careful:
        return total + share * fill
    # A fill that is not finite (NaN, to mark what is missing) counts where it has a share beyond rounding, and has
    # no derivative.
    regular = jnp.where(jnp.isfinite(fill), fill, 0)
    missing = lax.stop_gradient(fill - regular)
    total = total + share * regular + jnp.where(jnp.abs(share) > 16 * epsilon(x.dtype), missing, 0)
    if not jnp.issubdtype(pixels.dtype, jnp.floating):
        return total
    # A NaN among the pixels spoils, by 0 · NaN, what does not depend on them: there it is the fill value.
    spoiled = jnp.where(share == 1, 0, jnp.nan).astype(dtype)
    return jnp.where(total == total, total, spoiled + fill)


@jax.custom_batching.custom_vmap
def _all_finite(*arrays):
    return jnp.stack([jnp.isfinite(array).all() for array in arrays]).all()


@_all_finite.def_vmap
def _all_finite_in_batch(axis_size, in_batched, *arrays):
    # One answer for the whole batch: a `cond` on a batched one would compute both of its branches.
    return _all_finite(*arrays), False


def _sample_footprint(
    pixels: Array, coordinates: Array, method: str, border: str, fill: Array
) -> Float[Array, "height width channels"]:
    """Averages over footprints: probes along the longer axis, at the pyramid's levels of the shorter one."""
    dtype = _working_dtype(pixels.dtype, coordinates.dtype)
    pyramid = build_pyramid(pixels.astype(dtype))
    direction, longer, shorter = footprint(coordinates)
    longer, shorter = jnp.maximum(longer, 1), jnp.maximum(shorter, 1)
    deepest = len(pyramid.offsets) - 1
    depth = jnp.clip(jnp.log2(jnp.maximum(shorter, longer / _PROBES)), 0, deepest)
    fine = jnp.floor(depth).astype(jnp.int32)
    coarse = jnp.minimum(fine + 1, deepest)
    share = (depth - fine).astype(dtype)[..., None]
    offsets, heights, widths = (jnp.asarray(values) for values in (pyramid.offsets, pyramid.heights, pyramid.widths))

    def at_level(level, x, y):
        shrink = jnp.exp2(-level.astype(x.dtype))
        return _interpolate(
            pyramid.pixels,
            offsets[level],
            heights[level],
            widths[level],
            (x + 0.5) * shrink - 0.5,
            (y + 0.5) * shrink - 0.5,
            method=method,
            border=border,
            fill=fill,
            dtype=dtype,
            careful=True,
        )

    def add_probe(total, position):
        x, y = split(coordinates + (position * (longer - shorter))[..., None] * direction)
        # The halvings of an odd size are longer than the image: further periods would drift.
        x, y = _first_period(x, pixels.shape[1], border), _first_period(y, pixels.shape[0], border)
        blended = (1 - share) * at_level(fine, x, y) + share * at_level(coarse, x, y)
        return total + blended / _PROBES, None

    positions = (jnp.arange(_PROBES, dtype=coordinates.dtype) + 0.5) / _PROBES - 0.5
    averaged = lax.scan(add_probe, jnp.zeros((*longer.shape, pixels.shape[-1]), dtype), positions)[0]
    plain = _sample(pixels, coordinates, fill, method=method, border=border, careful=True)
    return jnp.where((longer > 1)[..., None], averaged, plain)


def _cast(samples: Array, dtype) -> Array:
    """Brings samples back to the dtype of the image: integers rounded and saturated."""
    if jnp.issubdtype(dtype, jnp.floating):
        return samples.astype(dtype)
    if dtype == jnp.bool_:
        return samples >= 0.5
    low, high = float(jnp.iinfo(dtype).min), float(jnp.iinfo(dtype).max)
    if high > 2 ** (jnp.finfo(samples.dtype).nmant + 1):
        # The largest integer is not a float of this dtype; the float below it is the largest that fits.
        high = float(np.nextafter(np.asarray(high, samples.dtype), np.asarray(0, samples.dtype)))
    return jnp.clip(jnp.round(samples), low, high).astype(dtype)


def _taps(position: Array, size: int | Array, method: str, border: str) -> list[tuple[Array, Array]]:
    """The pixels that an interpolation along one axis reads: their indices, always inside, and their weights."""
    count = _TAPS[method]
    # floor(x) − 1 is the first of four, floor(x) of two; the nearest is floor(x + 1/2), without its rounding error.
    first = jnp.floor(position)
    weights = _weights(position - first, method)
    first = first + (position - first >= 0.5) if count == 1 else first - (count // 2 - 1)
    if border != "constant":
        return [(_border_index(first + k, size, border), weight) for k, weight in enumerate(weights)]
    first = jnp.clip(first, -_FAR, size + _FAR).astype(jnp.int32)
    taps = []
    for k, weight in enumerate(weights):
        inside = jnp.clip(first + k, 0, size - 1)
        taps.append((inside, jnp.where(first + k == inside, weight, 0)))
    return taps


def _first_period(position: Array, size: int, border: str) -> Array:
    """The position within the image, or half a pixel beside it, that shows the same."""
    if border == "reflect":
        period = jnp.mod(position + 0.5, 2 * size)
        return jnp.where(period < size, period, 2 * size - period) - 0.5
    return jnp.mod(position + 0.5, size) - 0.5 if border == "wrap" else position


def _border_index(index: Array, size: int | Array, border: str) -> Array:
    """The pixel that stands at an index outside the image."""
    if border == "reflect":
        period = jnp.mod(index, 2 * size)
        index = jnp.minimum(period, 2 * size - 1 - period)
    elif border == "wrap":
        index = jnp.mod(index, size)
    return jnp.clip(index, 0, size - 1).astype(jnp.int32)


def _weights(offset: Array, method: str) -> list[Array]:
    """The weights of the pixels that are read, for a position at this offset, in [0, 1], from the pixel before it."""
    if method == "nearest":
        return [jnp.ones_like(offset)]
    if method == "bilinear":
        return [1 - offset, offset]
    a = _CUBIC[method]  # Keys (1981), Eq. 4

    def near(t):
        return ((a + 2) * t - (a + 3)) * t * t + 1

    def far(t):
        return a * (((t - 5) * t + 8) * t - 4)

    return [far(1 + offset), near(offset), near(1 - offset), far(2 - offset)]
