"""What every metric takes: a reference, an image, a mask; checked here, and brought to one floating dtype."""

from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float, Real, Shaped

Image: TypeAlias = Real[ArrayLike, "height width *channels"] | Bool[ArrayLike, "height width *channels"]
Mask: TypeAlias = Bool[ArrayLike, "height width"]
RealScalar: TypeAlias = Real[ArrayLike, ""]


class Pair(NamedTuple):
    """Two images ready to be compared.

    Attributes:
        reference: the reference, floating, 0 where the mask is False.
        image: the image, the same dtype, 0 where the mask is False.
        mask: True where a pixel counts, `(H, W)`; None when every pixel does.
        samples: how many samples count, channels included, in the images' dtype.
    """

    reference: Float[Array, "height width *channels"]
    image: Float[Array, "height width *channels"]
    mask: Bool[Array, "height width"] | None
    samples: Float[Array, ""]


def check_shapes(reference: ArrayLike, image: ArrayLike) -> None:
    """Refuses what is not a pair of images.

    Raises:
        ValueError: if the images are not `(H, W)` or `(H, W, C)`, are empty, complex, or differ in shape.
    """
    for name, array in (("reference", reference), ("image", image)):
        shape = np.shape(array)
        if len(shape) not in (2, 3):
            raise ValueError(
                f"{name} has shape {shape}; an image is (H, W) or (H, W, C). Use jax.vmap to compare a batch of images."
            )
        if 0 in shape:
            raise ValueError(f"{name} has shape {shape}: it holds no pixels.")
        if jnp.issubdtype(jnp.result_type(array), jnp.complexfloating):
            raise ValueError(f"{name} is complex; compare its real part or its magnitude instead.")
    if np.shape(reference) != np.shape(image):
        raise ValueError(
            f"reference has shape {np.shape(reference)} and image {np.shape(image)}; they must be equal. "
            "Resize or crop one of them first."
        )


def check_images(reference: ArrayLike, image: ArrayLike, mask: ArrayLike | None) -> tuple[Array, Array, Array | None]:
    """Refuses what is not a pair of images, and hands back JAX arrays.

    Raises:
        ValueError: if the images are not `(H, W)` or `(H, W, C)`, are empty, complex, or differ in shape,
            or if the mask is not boolean of shape `(H, W)`.
    """
    check_shapes(reference, image)
    if mask is None:
        return _to_jax(reference), _to_jax(image), None
    if np.shape(mask) != np.shape(reference)[:2]:
        raise ValueError(
            f"mask has shape {np.shape(mask)}; these images need {np.shape(reference)[:2]}: "
            "one mask serves all channels."
        )
    if jnp.result_type(mask) != jnp.bool_:
        raise ValueError(
            f"mask has dtype {jnp.result_type(mask)}; it must be boolean, True where a pixel counts (write mask > 0)."
        )
    return _to_jax(reference), _to_jax(image), jnp.asarray(mask)


def check_positive(name: str, value: RealScalar, advice: str) -> None:
    """Refuses a concrete number that is not above 0; a traced one cannot be judged here.

    Raises:
        ValueError: if the value is known now and is 0, negative or NaN.
    """
    if not isinstance(value, Tracer) and not np.asarray(value) > 0:
        raise ValueError(f"{name} is {value}; it must be above 0. {advice}")


def check_data_range(data_range: RealScalar) -> None:
    """Refuses a concrete dynamic range that is not above 0.

    Raises:
        ValueError: if the range is known now and is 0, negative or NaN.
    """
    check_positive("data_range", data_range, "It is L of Eq. 8: 255 for 8-bit images, 1 for those in [0, 1].")


def check_window(name: str, size: int, shape: tuple[int, ...]) -> None:
    """Refuses a window that is empty or that no image of this shape holds.

    Raises:
        ValueError: if the side is not a positive integer, or is larger than the image.
    """
    if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
        raise ValueError(f"{name} is {size!r}; it is a square window's side in pixels, an int of at least 1.")
    if size > min(shape[:2]):
        raise ValueError(
            f"{name} is {size}, but the image is {shape[0]}×{shape[1]}: no window fits. "
            "Ask for a smaller one, or use a metric without windows."
        )


def pair(reference: Array, image: Array, mask: Array | None) -> Pair:
    """Brings checked images to one floating dtype, with whatever the mask hides replaced by 0.

    Hidden samples are replaced before anything is computed from them, so neither their values nor their
    derivatives can be NaN.
    """
    dtype = jnp.promote_types(_working_dtype(reference), _working_dtype(image))
    x, y = reference.astype(dtype), image.astype(dtype)
    if mask is None:
        return Pair(x, y, None, jnp.asarray(x.size, dtype))
    seen = over_channels(mask, x)
    channels = x.size // mask.size
    count = jnp.sum(mask).astype(dtype) * channels
    return Pair(jnp.where(seen, x, 0), jnp.where(seen, y, 0), mask, count)


def over_channels(mask: Bool[Array, "rows columns"], image: Shaped[Array, "..."]) -> Bool[Array, "..."]:
    """Gives a mask the rank of an image, so that it broadcasts over the channels."""
    return mask.reshape(mask.shape + (1,) * (image.ndim - 2))


def _working_dtype(array: Array) -> jnp.dtype:
    """Returns float32 for half precision, the default float for integers and booleans, other floats as they are."""
    if jnp.issubdtype(array.dtype, jnp.floating):
        return jnp.promote_types(array.dtype, jnp.float32)
    return jnp.result_type(float)


def _to_jax(array: ArrayLike) -> Array:
    # Without x64, JAX would wrap 64-bit integers round to 32 bits; as floats they only lose low digits.
    if isinstance(array, np.ndarray) and array.dtype.kind in "iu" and array.dtype.itemsize == 8:
        return jnp.asarray(array.astype(jnp.result_type(float)))
    return jnp.asarray(array)
