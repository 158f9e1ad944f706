"""Images through coordinate maps: every output pixel is sent to its source, and the source is sampled there."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Real, Shaped

from jaxlens.frames import Frame
from jaxlens.lenses import Lens
from jaxlens.maps import CoordinateMap, Inverted, OneToOne
from jaxlens.numerics import join, split
from jaxlens.sampling import Border, Method, resample

_STATIC = ("shape", "method", "border", "antialias")


@partial(jax.jit, static_argnames=_STATIC)
def warp(
    image: Shaped[ArrayLike, "height width *channels"],
    mapping: CoordinateMap,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
    method: Method = "bilinear",
    border: Border = "constant",
    fill: Real[ArrayLike, "*fill"] = 0.0,
    antialias: bool = False,
) -> Shaped[Array, "new_height new_width *channels"]:
    """Pulls an image back through a map: `output(p) = image(mapping(p))`.

    Args:
        image: `(H, W)` or `(H, W, C)`, any real dtype.
        mapping: From points of the output to points of the source, both normalized. A point that it sends to NaN
            takes the fill value.
        frame: Ties the source's pixels to normalized coordinates; Eq. 10's by default.
        output_frame: The same for the output; by default that of the source.
        shape: `(height, width)` of the output; by default that of the source.
        method: The interpolation, as in `remap`.
        border: What lies outside the source, as in `remap`.
        fill: The value of pixels without a source: a number, or one for each channel.
        antialias: Average over footprints where the map shrinks the image, as in `remap`.

    Returns:
        The warped image, in the dtype of `image`. Differentiable as `remap`, and with respect to the map's
        parameters. The coordinates are computed in the dtype of the map's parameters.

    Raises:
        ValueError: as `remap`.
    """
    image = jnp.asarray(image)
    if image.ndim not in (2, 3) or 0 in image.shape:
        raise ValueError(f"an image has shape (H, W) or (H, W, C) and at least one pixel, got {image.shape}")
    height, width = image.shape[:2]
    size = (height, width) if shape is None else shape

    def sources() -> tuple[Array, Array]:
        return _source_planes(mapping, height, width, frame, output_frame, size)

    return resample(image, size, sources, method=method, border=border, fill=fill, antialias=antialias)


@partial(jax.jit, static_argnames=_STATIC)
def distort_image(
    image: Shaped[ArrayLike, "height width *channels"],
    lens: Lens,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
    method: Method = "bilinear",
    border: Border = "constant",
    fill: Real[ArrayLike, "*fill"] = 0.0,
    antialias: bool = False,
) -> Shaped[Array, "new_height new_width *channels"]:
    """Makes the picture that a lens would take of an undistorted one.

    Each output pixel is an observed point; its source is the exact preimage, `lens.undistort`. Pixels without a
    preimage take the fill value: the paper's black borders (Eq. 11, read as the functional inverse).

    Args and returns are those of `warp`, with a lens for the map.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> jl.distort_image(jnp.ones((4, 6)), jl.RadialPolynomial([0.0, 1.0])).shape
        (4, 6)
    """
    return warp(
        image,
        Inverted(_as_lens(lens)),
        frame=frame,
        output_frame=output_frame,
        shape=shape,
        method=method,
        border=border,
        fill=fill,
        antialias=antialias,
    )


@partial(jax.jit, static_argnames=_STATIC)
def undistort_image(
    image: Shaped[ArrayLike, "height width *channels"],
    lens: Lens,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
    method: Method = "bilinear",
    border: Border = "constant",
    fill: Real[ArrayLike, "*fill"] = 0.0,
    antialias: bool = False,
) -> Shaped[Array, "new_height new_width *channels"]:
    """Removes a lens from a picture.

    Each output pixel is an ideal point; its source is `lens.distort`. Ideal points beyond the lens's fold radius
    are seen by nobody, and take the fill value.

    Args and returns are those of `warp`, with a lens for the map.
    """
    return warp(
        image,
        OneToOne(_as_lens(lens)),
        frame=frame,
        output_frame=output_frame,
        shape=shape,
        method=method,
        border=border,
        fill=fill,
        antialias=antialias,
    )


def distortion_map(
    lens: Lens,
    height: int,
    width: int,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
) -> Float[Array, "new_height new_width 2"]:
    """Returns where `distort_image` samples: `(H, W, 2)` source pixels, (x, y) order, to use with `remap` many times.

    Args:
        lens: The lens.
        height: Height of the source, in pixels.
        width: Width of the source, in pixels.
        frame: As in `warp`.
        output_frame: As in `warp`.
        shape: As in `warp`.

    Returns:
        The coordinates, NaN where a pixel has no preimage.
    """
    return source_coordinates(
        Inverted(_as_lens(lens)), height, width, frame=frame, output_frame=output_frame, shape=shape
    )


def undistortion_map(
    lens: Lens,
    height: int,
    width: int,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
) -> Float[Array, "new_height new_width 2"]:
    """Returns where `undistort_image` samples: as `distortion_map`, for the other direction."""
    return source_coordinates(
        OneToOne(_as_lens(lens)), height, width, frame=frame, output_frame=output_frame, shape=shape
    )


@partial(jax.jit, static_argnames=("height", "width", "shape"))
def source_coordinates(
    mapping: CoordinateMap,
    height: int,
    width: int,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
) -> Float[Array, "new_height new_width 2"]:
    """Sends every output pixel to its source, in pixels; args as in `distortion_map`, for any map."""
    return join(
        *_source_planes(mapping, height, width, frame, output_frame, (height, width) if shape is None else shape)
    )


def _source_planes(
    mapping: CoordinateMap,
    height: int,
    width: int,
    frame: Frame | None,
    output_frame: Frame | None,
    shape: tuple[int, int],
) -> tuple[Float[Array, "new_height new_width"], Float[Array, "new_height new_width"]]:
    """Returns the x and y of `source_coordinates`."""
    source = frame_for(mapping, height, width) if frame is None else frame
    output = source if output_frame is None else output_frame

    def points() -> Array:
        return output.normalize(pixel_grid(*shape, output.scale.dtype))

    if not isinstance(mapping, OneToOne):
        return split(source.denormalize(mapping(points())))
    right, bottom = shape[1] - 1, shape[0] - 1
    pixels = [[0, 0], [right, 0], [0, bottom], [right, bottom]]
    corners = jnp.stack([join(*(jnp.asarray(value, output.scale.dtype) for value in pixel)) for pixel in pixels])
    sure = mapping.mapping.surely_one_to_one(output.normalize(corners))
    if sure is None:
        inside = mapping.one_to_one(points())
    else:
        inside = lax.cond(jnp.all(sure), lambda: jnp.ones(shape, bool), lambda: mapping.one_to_one(points()))
    x, y = split(source.denormalize(mapping.mapping(points())))
    return jnp.where(inside, x, jnp.nan), jnp.where(inside, y, jnp.nan)


def pixel_grid(height: int, width: int, dtype: jax.typing.DTypeLike) -> Float[Array, "height width 2"]:
    """Returns the coordinates of every pixel of an image, (x, y) order."""
    x, y = jnp.arange(width, dtype=dtype), jnp.arange(height, dtype=dtype)
    return join(*jnp.meshgrid(x, y))


def frame_for(mapping: CoordinateMap, height: int, width: int) -> Frame:
    """Returns Eq. 10's frame in the dtype that the map's parameters promote to.

    Raises:
        ValueError: the map is written in a camera's coordinates.
    """
    if mapping.needs_frame:
        raise ValueError(
            "this lens is written in the coordinates of a camera, not in Eq. 10's: give its frame, "
            "frame=jl.Frame.from_camera_matrix([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])"
        )
    leaves = [leaf for leaf in jax.tree.leaves(mapping) if jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating)]
    dtype = jnp.result_type(*leaves) if leaves else jnp.result_type(float)
    return jax.tree.map(lambda leaf: leaf.astype(dtype), Frame.half_diagonal(height, width))


def _as_lens(lens: Lens) -> Lens:
    if not isinstance(lens, Lens):
        raise ValueError(
            f"expected a lens, got {type(lens).__name__}: coefficients become one by jl.RadialPolynomial([-0.3, 0.1])"
        )
    return lens
