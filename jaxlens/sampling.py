"""Reading an image between its pixels: nearest, bilinear and bicubic, with borders and antialiasing."""

from collections.abc import Callable
from functools import partial
from typing import Literal, get_args

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Real, Shaped

from jaxlens.interpolation import KERNELS, PERIODIC, Grid, as_pixels, interpolated, periodic, surrounded, weighted_sum
from jaxlens.memory import in_memory
from jaxlens.numerics import as_points, epsilon, join, split
from jaxlens.pyramid import build_pyramid, footprint

Method = Literal["nearest", "bilinear", "bicubic", "bicubic_opencv"]
"""`bicubic` is Keys's kernel with a = −0.5 (third order exact), `bicubic_opencv` the same with OpenCV's a = −0.75."""

Border = Literal["constant", "edge", "reflect", "wrap"]
"""What lies outside the image. In `scipy.ndimage` these are `grid-constant`, `nearest`, `reflect` and `grid-wrap`."""

# Probes along the longer axis of an antialiasing footprint.
_PROBES = 5

Planes = tuple[Float[Array, "*points"], Float[Array, "*points"]]


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
    points = as_points(coordinates)
    return resample(
        image,
        points.shape[:-1],
        lambda: split(points),
        method=method,
        border=border,
        fill=fill,
        antialias=antialias,
    )


def interpolate(image: Float[Array, "height width"], points: Float[Array, "*points 2"]) -> Float[Array, "*points"]:
    """Samples a finite image bilinearly, its edge repeated, without the checks and casts of `remap`: for residuals."""
    # Where it is differentiated, XLA computes the pixels' indices and their weights in different loops, which may round
    # a position that is whole to different sides. A nudge, as small as rounding itself, brings both to the same.
    nudge = 4 * epsilon(points.dtype) * max(image.shape)
    x, y = split(points + nudge)
    x, y = _placed(x, y, Grid(0, *image.shape), "bilinear", "edge")
    return interpolated(image, x, y, jnp.zeros((), image.dtype), kernel="bilinear", border="edge", dtype=image.dtype)


def resample(
    image: ArrayLike,
    shape: tuple[int, ...],
    coordinates: Callable[[], Planes],
    *,
    method: str,
    border: str,
    fill: ArrayLike,
    antialias: bool,
) -> Array:
    """Does what `remap` does, at points of this shape, whose x and y are computed where they are wanted."""
    image, fill = jnp.asarray(image), jnp.asarray(fill)
    _check(image, shape, method, border, antialias)
    channels = image.shape[2:]
    if fill.shape == (1,):
        fill = fill[0]
    if fill.shape not in ((), channels):
        raise ValueError(
            f"fill must be a number or one for each of the {channels[0] if channels else 1} channels, got shape "
            f"{fill.shape}"
        )

    def positions() -> Planes:
        x, y = coordinates()
        dtype = jnp.promote_types(x.dtype, jnp.float32)  # half cannot count pixels
        x, y = x.astype(dtype), y.astype(dtype)
        return (x, y) if antialias else _placed(x, y, Grid(0, *image.shape[:2]), method, border)

    x, y = in_memory(positions, image)
    working = _working_dtype(image.dtype, x.dtype)
    fill = fill.astype(working)
    # What surrounds the image is stored in its dtype; what that cannot hold of the fill value is added where it counts.
    padding = as_pixels(jnp.where(jnp.isfinite(fill), fill, 0), image.dtype)
    rest = fill - padding.astype(working)
    options = {"method": method, "border": border}

    def sample(image: Array, padding: Array, dtype) -> Array:
        if antialias:
            return _sample_footprints(image, x, y, padding, fill, dtype, **options)
        samples = interpolated(
            image, x.astype(working), y.astype(working), padding, kernel=method, border=border, dtype=dtype
        )
        return samples if border == "constant" else _with_nowhere(samples, x, fill)

    if border != "constant":
        return sample(image, padding, image.dtype)

    def with_rest() -> Array:
        share = 1 - sample(jnp.ones(image.shape[:2], bool), jnp.asarray(False), working)
        share = share[..., None] if channels else share
        # One that is not finite (NaN, to mark what is missing) counts where its share is beyond rounding, and has no
        # derivative.
        added = jnp.expand_dims(rest, range(share.ndim - rest.ndim))
        regular = jnp.where(jnp.isfinite(added), added, 0)
        missing = jnp.where(jnp.abs(share) > 16 * epsilon(x.dtype), lax.stop_gradient(added - regular), 0)
        return as_pixels(sample(image, padding, working) + share * regular + missing, image.dtype)

    return lax.cond(_all_zero(lax.stop_gradient(rest)), lambda: sample(image, padding, image.dtype), with_rest)


def _check(image: Array, shape: tuple[int, ...], method: str, border: str, antialias: bool) -> None:
    if image.ndim not in (2, 3) or 0 in image.shape:
        raise ValueError(f"an image has shape (H, W) or (H, W, C) and at least one pixel, got {image.shape}")
    if jnp.issubdtype(image.dtype, jnp.complexfloating):
        raise ValueError(f"an image must be real, got dtype {image.dtype}; sample its real and imaginary parts")
    if method not in get_args(Method):
        raise ValueError(f"method must be one of {', '.join(get_args(Method))}, got {method!r}")
    if border not in get_args(Border):
        raise ValueError(f"border must be one of {', '.join(get_args(Border))}, got {border!r}")
    if antialias and len(shape) != 2:
        raise ValueError(
            "antialias=True needs coordinates on a grid, of shape (H, W, 2), to know the footprint of a pixel; "
            f"got {(*shape, 2)}"
        )


def _working_dtype(image_dtype, coordinate_dtype):
    """Returns the dtype to interpolate in: at least single precision, double where integers or coordinates need it."""
    if jnp.issubdtype(image_dtype, jnp.floating):
        return jnp.result_type(image_dtype, coordinate_dtype, jnp.float32)
    exact = jnp.dtype(image_dtype).itemsize <= 2
    return jnp.result_type(coordinate_dtype, jnp.float32 if exact else jnp.result_type(float))


@jax.custom_batching.custom_vmap
def _all_zero(values):
    return jnp.all(values == 0)


@_all_zero.def_vmap
def _all_zero_in_batch(axis_size, in_batched, values):
    # One answer for the whole batch: a `cond` on a batched one would compute both of its branches.
    return _all_zero(values), False


def _placed(x: Array, y: Array, grid: Grid, method: str, border: str) -> Planes:
    """Brings positions to those nearest the image that show the same, unless its border repeats it.

    One that is not finite shows the fill value: with the constant border it lies beyond, else it is NaN.
    """
    count = len(KERNELS[method])
    # Beyond these, which are whole, the kernel reads nothing of the image.
    before = -(count // 2 + 1)
    beyond_x, beyond_y = (size - 1 + max(1, count // 2) for size in (grid.width, grid.height))
    somewhere = jnp.isfinite(x) & jnp.isfinite(y)
    nowhere = jnp.nan
    # Comparisons that leave each end its derivative towards larger coordinates.
    if border == "edge":
        x, y = (jnp.where(p >= before, jnp.where(p < end, p, end), before) for p, end in ((x, beyond_x), (y, beyond_y)))
    elif border == "constant":
        first, nowhere = before + int(count > 1), float(before)
        somewhere = (x >= first) & (x < beyond_x) & (y >= first) & (y < beyond_y)
    return jnp.where(somewhere, x, nowhere), jnp.where(somewhere, y, nowhere)


def _first_period(position: Array, size: int | Array, border: str) -> Array:
    """Returns the position within the image, or less than a pixel beside it, that shows the same."""
    if border not in PERIODIC:
        return position
    pixel = jnp.floor(position)
    shown, mirrored = periodic(pixel, size, border)
    return shown + jnp.where(mirrored, pixel - position, position - pixel)


def _with_nowhere(samples: Array, x: Array, fill: Array) -> Array:
    """Returns the samples, with the fill value where a position is NaN."""
    somewhere = jnp.expand_dims(x == x, range(x.ndim, samples.ndim))
    return jnp.where(
        somewhere, samples, as_pixels(jnp.expand_dims(fill, range(samples.ndim - fill.ndim)), samples.dtype)
    )


def _sample_footprints(
    image: Array, x: Array, y: Array, padding: Array, fill: Array, dtype, *, method: str, border: str
) -> Shaped[Array, "height width *channels"]:
    """Averages over footprints: probes along the longer axis, at the pyramid's levels of the shorter one."""
    working = _working_dtype(image.dtype, x.dtype)
    pyramid = build_pyramid(image.astype(working), lambda level: surrounded(level, padding, method, border))
    direction, longer, shorter = footprint(join(x, y))
    longer, shorter = jnp.maximum(longer, 1), jnp.maximum(shorter, 1)
    deepest = len(pyramid.offsets) - 1
    depth = jnp.clip(jnp.log2(jnp.maximum(shorter, longer / _PROBES)), 0, deepest)
    fine = jnp.floor(depth).astype(jnp.int32)
    coarse = jnp.minimum(fine + 1, deepest)
    tables = [jnp.asarray(table) for table in (pyramid.offsets, pyramid.heights, pyramid.widths)]

    def expanded(plane: Array) -> Array:
        return jnp.expand_dims(plane, range(2, image.ndim))

    def read(x, y, grid):
        x, y = (values.astype(working) for values in _placed(x, y, grid, method, border))
        samples = weighted_sum(pyramid.pixels, x, y, grid, kernel=method, border=border, dtype=working)
        return samples if border == "constant" else _with_nowhere(samples, x, fill)

    def at_level(level, x, y):
        shrink = jnp.exp2(-level.astype(x.dtype))
        return read((x + 0.5) * shrink - 0.5, (y + 0.5) * shrink - 0.5, Grid(*(table[level] for table in tables)))

    def add_probe(total, position):
        # The halvings of an odd size are longer than the image: further periods would drift.
        probe = split(join(x, y) + (position * (longer - shorter))[..., None] * direction)
        across, down = (
            _first_period(values, length, border) for values, length in zip(probe, image.shape[1::-1], strict=True)
        )
        share = expanded((depth - fine).astype(working))
        blended = (1 - share) * at_level(fine, across, down) + share * at_level(coarse, across, down)
        return total + blended / _PROBES, None

    positions = (jnp.arange(_PROBES, dtype=x.dtype) + 0.5) / _PROBES - 0.5
    plain = read(x, y, Grid(0, *image.shape[:2]))
    averaged = lax.scan(add_probe, jnp.zeros_like(plain), positions)[0]
    return as_pixels(jnp.where(expanded(longer > 1), averaged, plain), dtype)
