"""Pixels through a lens: what `jaxlens distort` and `jaxlens undistort` compute."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real, Shaped

from jaxlens.calibrations import Calibration
from jaxlens.diagnostics import coverage, largest_rectangle
from jaxlens.frames import Frame
from jaxlens.lenses import Lens, RadialLens, RadialPolynomial
from jaxlens.maps import CoordinateMap, OneToOne
from jaxlens.sampling import Border, Method
from jaxlens.warping import source_coordinates
from jaxlens.warping import warp as warp_image

Direction = Literal["distort", "undistort"]
Rectangle = tuple[int, int, int, int]

# Large pictures are made in strips of about so many pixels, and at least so many rows, so that what is computed on the
# way (some 100 bytes a pixel) does not grow with them.
_STRIP_PIXELS = 2**24
_STRIP_ROWS = 16


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How a picture is read between its pixels, and beside them.

    Attributes:
        method: As in `jaxlens.remap`.
        border: As in `jaxlens.remap`.
        fill: One value, or one for each channel; None for black, or transparent where there is alpha.
        antialias: As in `jaxlens.remap`.
    """

    method: Method = "bilinear"
    border: Border = "constant"
    fill: tuple[float, ...] | None = None
    antialias: bool = False


@dataclass(frozen=True, kw_only=True)
class Warp(Sampling):
    """A lens, a direction, and how to sample; hashable, so that what depends on it and a size is computed once.

    Attributes:
        direction: Apply the lens, or remove it.
        kappa: Its coefficients.
        center: Of the lens, (x, y) in pixels; None for Eq. 10's.
        calibration: Another lens with a frame of its own, in place of `kappa` and `center`.
    """

    direction: Direction
    kappa: tuple[float, ...] = ()
    center: tuple[float, float] | None = None
    calibration: Calibration | None = None


class FillError(ValueError):
    """A fill value does not fit a picture; the message says which would."""


@dataclass(frozen=True)
class Fold:
    """Where a lens stops being one-to-one, and what that costs a picture.

    Attributes:
        radius: The ideal radius in normalized coordinates (half-diagonals of the picture, in Eq. 10's frame); None for
            a lens that has no one radius.
        pixels: The same in pixels, along the shorter axis of the frame.
        share: The share of the output's pixels that have no preimage.
    """

    radius: float | None
    pixels: float | None
    share: float


def warp_pixels(pixels: Shaped[np.ndarray, "height width *channels"], warp: Warp) -> np.ndarray:
    """Puts a picture through a lens; as `pull_back`."""
    height, width = pixels.shape[:2]

    def place(dtype: type[np.floating]) -> tuple[CoordinateMap, Frame]:
        lens, frame = _lens_and_frame(warp, height, width, dtype)
        return _mapping(lens, warp.direction), frame

    return pull_back(pixels, place, warp)


def pull_back(
    pixels: Shaped[np.ndarray, "height width *channels"],
    place: Callable[[type[np.floating]], tuple[CoordinateMap, Frame]],
    sampling: Sampling,
    *,
    size: tuple[int, int] | None = None,
) -> np.ndarray:
    """Warps a picture: each pixel of the result is looked up where a map sends it.

    Pixels of up to 16 bits are computed in single precision, others in double. A picture with alpha (2 or 4 channels)
    is interpolated with its colours multiplied by their opacity and divided by it afterwards, so that the colours
    of transparent pixels, which nobody sees, do not bleed; where the result is transparent they are zero. Without
    interpolation (`nearest`) the pixels are copied as they are.

    Args:
        pixels: As `jaxlens.images` reads them.
        place: Makes, in a dtype, the map from the result to the picture, and the frame of both.
        sampling: How to read the picture.
        size: Height and width of the result; those of the picture by default.

    Returns:
        Pixels in the picture's dtype.

    Raises:
        FillError: the fill value does not fit the picture.
    """
    full = _opaque(pixels)
    fill = _fill_values(pixels, sampling.fill, full)
    height, width = pixels.shape[:2] if size is None else size
    warped = np.empty((height, width, *pixels.shape[2:]), pixels.dtype)
    with jax.enable_x64(_is_wide(pixels.dtype)):
        dtype = _working_dtype(pixels.dtype)
        mapping, frame = place(dtype)
        source, outside = jnp.asarray(pixels), jnp.asarray(fill, dtype)
        blends = _has_alpha(pixels) and (sampling.method != "nearest" or sampling.antialias)
        if blends:
            source, outside = _premultiplied(source.astype(dtype), full), _premultiplied(outside, full)
        rows = min(height, max(_STRIP_PIXELS // width, _STRIP_ROWS))
        for first, kept in _strips(height, rows):
            strip = warp_image(
                source,
                mapping,
                frame=frame,
                output_frame=Frame(frame.center - jnp.asarray([0, first], dtype), frame.scale),
                shape=(rows, width),
                method=sampling.method,
                border=sampling.border,
                fill=outside,
                antialias=sampling.antialias,
            )
            if blends:
                strip = _straight(strip, full, pixels.dtype)
            warped[first + kept.start : first + kept.stop] = np.asarray(strip)[kept]
    return warped


@cache
def inner_rectangle(warp: Warp, height: int, width: int) -> Rectangle:
    """Finds the largest upright rectangle of the output that draws from inside the picture throughout.

    Returns:
        (top, left, height, width) in pixels, all zero where there is none.
    """
    with jax.enable_x64(False):
        lens, frame = _lens_and_frame(warp, height, width, np.float32)
        covered = coverage(_mapping(lens, warp.direction), height, width, frame=frame)
        top, left, tall, wide = (int(value) for value in largest_rectangle(covered))
    return top, left, tall, wide


@cache
def find_fold(warp: Warp, height: int, width: int) -> Fold | None:
    """Tells whether the lens folds inside a picture of this size, and what that costs; None if it does not."""
    with jax.enable_x64(False):
        lens, frame = _lens_and_frame(warp, height, width, np.float32)
        if not isinstance(lens, RadialLens):
            share = float(_share_without_source(_mapping(lens, warp.direction), frame, height, width))
            return Fold(None, None, share) if share > 0 else None
        (x, y), (wide, tall) = (np.asarray(part).tolist() for part in (frame.denormalize(lens.center), frame.scale))
        corner = math.hypot(max(x, width - 1 - x) / wide, max(y, height - 1 - y) / tall)
        radius, edge = (float(value) for value in _fold_radii(lens))
        # Of distorting, pixels beyond the fold's observed radius are without a preimage; and what of the source lies
        # beyond the fold itself is seen nowhere.
        if radius >= corner and (warp.direction == "undistort" or edge >= corner):
            return None
        share = float(_share_without_source(_mapping(lens, warp.direction), frame, height, width))
    return Fold(radius, radius * min(wide, tall), share)


def _mapping(lens: Lens, direction: Direction) -> CoordinateMap:
    return lens.inverse() if direction == "distort" else OneToOne(lens)


@jax.jit
def _fold_radii(lens: RadialLens) -> tuple[Float[Array, ""], Float[Array, ""]]:
    return lens.fold_radius(), lens.edge_radius()


@partial(jax.jit, static_argnames=("height", "width"))
def _share_without_source(mapping: CoordinateMap, frame: Frame, height: int, width: int) -> Float[Array, ""]:
    sources = source_coordinates(mapping, height, width, frame=frame)
    return jnp.mean(jnp.isnan(sources[..., 0]).astype(sources.dtype))


def _center(warp: Warp, height: int, width: int) -> tuple[float, float]:
    return (width / 2, height / 2) if warp.center is None else warp.center


def _lens_and_frame(warp: Warp, height: int, width: int, dtype: type[np.floating]) -> tuple[Lens, Frame]:
    if warp.calibration is not None:
        pair = warp.calibration.lens(), warp.calibration.frame(height, width)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), pair)
    half_diagonal = math.hypot(width, height) / 2
    frame = Frame(jnp.asarray(_center(warp, height, width), dtype), jnp.asarray(half_diagonal, dtype))
    return RadialPolynomial(jnp.asarray(warp.kappa, dtype)), frame


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


def _fill_values(pixels: np.ndarray, fill: tuple[float, ...] | None, full: float) -> np.ndarray:
    """One fill value for each channel; without any, black or transparent."""
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if fill is None:
        return np.zeros(channels)
    colours = channels - 1 if _has_alpha(pixels) else channels
    if len(fill) not in {1, colours, channels}:
        counts = " or ".join(str(count) for count in sorted({1, colours, channels}))
        raise FillError(f"it has {channels} channels: --fill takes {counts} numbers, got {len(fill)}")
    values = list(fill) if len(fill) > 1 else list(fill) * colours
    if len(values) < channels:
        values.append(full)
    _check_range(values, pixels.dtype)
    return np.array(values)


def _check_range(values: list[float], dtype: np.dtype) -> None:
    if dtype.kind not in "iu":
        return
    limits = np.iinfo(dtype)
    outside = [value for value in values if not limits.min <= value <= limits.max]
    if outside:
        raise FillError(f"it is {dtype}, from {limits.min} to {limits.max}; --fill {outside[0]:g} is not in there")


def _has_alpha(pixels: np.ndarray) -> bool:
    return pixels.ndim == 3 and pixels.shape[2] in (2, 4)


def _opaque(pixels: np.ndarray) -> float:
    """The alpha of an opaque pixel: the largest integer; in floating pictures 1, unless they go beyond."""
    if pixels.dtype.kind in "iu":
        return float(np.iinfo(pixels.dtype).max)
    return max(1.0, float(np.nanmax(pixels[..., -1]))) if _has_alpha(pixels) else 1.0


def _is_wide(dtype: np.dtype) -> bool:
    return dtype.itemsize > (4 if dtype.kind == "f" else 2)


def _working_dtype(dtype: np.dtype) -> type[np.floating]:
    return np.float64 if _is_wide(dtype) else np.float32
