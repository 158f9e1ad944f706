"""A whole picture through a coordinate map: alpha weighs the colours, large pictures are made in strips."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from jaxlens.frames import Frame
from jaxlens.images.picture import Picture
from jaxlens.maps import CoordinateMap
from jaxlens.sampling import Border, Method
from jaxlens.warping import frame_for
from jaxlens.warping import warp as warp_array

# Large pictures are made in strips of about so many pixels, and at least so many rows, so that what is computed on the
# way (some 100 bytes a pixel) does not grow with them.
_STRIP_PIXELS = 2**22
_STRIP_ROWS = 16


def warp(
    picture: Picture,
    mapping: CoordinateMap,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
    method: Method = "bilinear",
    border: Border = "constant",
    fill: ArrayLike | Sequence[float] | None = None,
    antialias: bool = False,
) -> Picture:
    """Pulls a picture back through a map, as `jaxlens.warp` does with arrays: `output(p) = picture(mapping(p))`.

    Pixels of up to 16 bits are computed in single precision, others in double, whatever JAX's default is. The colours
    of a picture with alpha (2 or 4 channels) are multiplied by their opacity, interpolated, and divided by it, so that
    the colours of transparent pixels, which nobody sees, do not bleed; where the result is transparent they are zero.
    Without interpolation (`nearest`) the pixels are copied as they are. Large pictures are made in strips: beside
    source and result, the memory needed does not grow with them.

    Args:
        picture: The source, as `read` returns it.
        mapping: From points of the output to points of the source, both normalized: `lens.inverse()` distorts,
            `OneToOne(lens)` undistorts. A point that it sends to NaN takes the fill value.
        frame: Ties the source's pixels to normalized coordinates; Eq. 10's by default.
        output_frame: The same for the output; by default that of the source.
        shape: `(height, width)` of the output; by default that of the source.
        method: The interpolation, as in `jaxlens.remap`.
        border: What lies outside the source, as in `jaxlens.remap`.
        fill: The value of pixels without a source, on the picture's own scale: a number, or one for each channel.
            Black by default, and transparent where there is alpha. Colours without an alpha of their own are opaque.
        antialias: Average over footprints where the map shrinks the picture, as in `jaxlens.remap`.

    Returns:
        The warped pixels, in the picture's dtype, with its metadata and path.

    Raises:
        ValueError: a fill of another number of channels than the picture's, or out of its dtype's range; as
            `jaxlens.warp`.

    Example:
        >>> import numpy as np, jaxlens as jl
        >>> picture = jl.images.Picture(np.full((24, 32, 4), 200, np.uint8))
        >>> straight = jl.images.warp(picture, jl.OneToOne(jl.RadialPolynomial([0.3])))
        >>> straight.pixels[0, 0].tolist(), straight.pixels[12, 16].tolist()
        ([0, 0, 0, 0], [200, 200, 200, 200])
    """
    pixels = picture.pixels
    full = _opaque(picture)
    values = _fill_values(picture, fill, full)
    height, width = pixels.shape[:2] if shape is None else shape
    warped = np.empty((height, width, *pixels.shape[2:]), pixels.dtype)
    wide = pixels.dtype.itemsize > (4 if pixels.dtype.kind == "f" else 2)
    with jax.enable_x64(wide):
        dtype = np.float64 if wide else np.float32
        mapping = _as_floating(mapping, dtype)
        inner = frame_for(mapping, *pixels.shape[:2]) if frame is None else _as_floating(frame, dtype)
        outer = inner if output_frame is None else _as_floating(output_frame, dtype)
        source, outside = jnp.asarray(pixels), jnp.asarray(values, dtype)
        blends = picture.has_alpha and (method != "nearest" or antialias)
        if blends:
            source, outside = _premultiplied(source.astype(dtype), full), _premultiplied(outside, full)
        rows = min(height, max(_STRIP_PIXELS // width, _STRIP_ROWS))
        for first, kept in _strips(height, rows):
            strip = warp_array(
                source,
                mapping,
                frame=inner,
                output_frame=Frame(np.asarray(outer.center) - np.asarray([0, first], dtype), outer.scale),
                shape=(rows, width),
                method=method,
                border=border,
                fill=outside,
                antialias=antialias,
            )
            if blends:
                strip = _straight(strip, full, pixels.dtype)
            warped[first + kept.start : first + kept.stop] = np.asarray(strip)[kept]
    return replace(picture, pixels=warped)


def _as_floating(tree, dtype: type[np.floating]):
    """Returns the same map or frame with its floating numbers in this dtype."""

    def converted(leaf):
        # By NumPy, which knows double precision whatever JAX is set to.
        return jnp.asarray(np.asarray(leaf), dtype) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

    return jax.tree.map(converted, tree)


def _strips(height: int, rows: int) -> Iterator[tuple[int, slice]]:
    """Cuts the output into strips of so many rows: where each begins, and which of its rows are to be kept.

    The rows beside a cut are not kept: antialiasing compares each row with its neighbours.
    """
    done = 0
    while done < height:
        first = min(max(done - 1, 0), height - rows)
        stop = height if first + rows == height else first + rows - 1
        yield first, slice(done - first, stop - first)
        done = stop


@jax.jit
def _premultiplied(
    values: Float[Array, "*batch channels"], full: float | Float[Array, ""]
) -> Float[Array, "*batch channels"]:
    """Colours times their opacity, and the opacity from 0 to 1, from colours and alpha."""
    opacity = values[..., -1:] / full
    return jnp.concatenate([values[..., :-1] * opacity, opacity], axis=-1)


@partial(jax.jit, static_argnames=("dtype",))
def _straight(
    values: Float[Array, "*batch channels"], full: float | Float[Array, ""], dtype: np.dtype
) -> Real[Array, "*batch channels"]:
    """Colours and alpha, in the picture's dtype, from what `_premultiplied` makes."""
    opacity = values[..., -1:]
    integer = jnp.issubdtype(dtype, jnp.integer)
    # Less than half of the smallest alpha is none; bicubic kernels may also undershoot, and overshoot.
    seen = opacity > (0.5 / full if integer else jnp.finfo(values.dtype).eps)
    colours = jnp.where(seen, values[..., :-1] / jnp.where(seen, opacity, 1), 0)
    straight = jnp.concatenate([colours, jnp.clip(opacity, 0, 1) * full], axis=-1)
    if integer:
        limits = jnp.iinfo(dtype)
        straight = jnp.clip(jnp.round(straight), float(limits.min), float(limits.max))
    return straight.astype(dtype)


def _fill_values(picture: Picture, fill: ArrayLike | Sequence[float] | None, full: float) -> np.ndarray:
    """Returns one fill value for each channel; without any, black or transparent."""
    channels = picture.pixels.shape[2] if picture.pixels.ndim == 3 else 1
    if fill is None:
        return np.zeros(channels)
    values = np.atleast_1d(np.asarray(fill, np.float64)).tolist()
    colours = channels - 1 if picture.has_alpha else channels
    if len(values) not in {1, colours, channels}:
        counts = " or ".join(str(count) for count in sorted({1, colours, channels}))
        raise ValueError(f"the picture has {channels} channels: fill takes {counts} numbers, got {len(values)}")
    if len(values) == 1:
        values = values * colours
    if len(values) < channels:
        values.append(full)
    dtype = picture.pixels.dtype
    limits = np.iinfo(dtype) if dtype.kind in "iu" else None
    outside = [] if limits is None else [value for value in values if not limits.min <= value <= limits.max]
    if limits is not None and outside:
        raise ValueError(
            f"the picture is {dtype}, from {limits.min} to {limits.max}; fill={outside[0]:g} is not in there"
        )
    return np.array(values)


def _opaque(picture: Picture) -> float:
    """Returns the alpha of an opaque pixel: the largest integer; in floating pictures 1, unless they go beyond."""
    pixels = picture.pixels
    if pixels.dtype.kind in "iu":
        return float(np.iinfo(pixels.dtype).max)
    return max(1.0, float(np.nanmax(pixels[..., -1]))) if picture.has_alpha else 1.0
