"""A face of our own making: a smooth surface in closed form, whose nose tip is known exactly, and its colouring."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.numerics import as_floating, jitted, split
from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._face_features import albedo, outlines, relief, skull
from jaxlens.warping import pixel_grid

# Where the skull ends: the share by which a point must lie inside its outline, where the sides become too steep.
_RIM = 0.035


def _measure(default: float) -> Any:
    return eqx.field(default=default, converter=as_floating)


class FaceShape(eqx.Module):
    """The measures of a face, in units of the head's height from chin to crown (about 23 cm).

    The origin lies midway between the pupils, at half the head's height; x points to the right of the picture,
    y downwards, z towards the viewer, from the head's middle plane. So the crown is at y = −0.5 and the chin at 0.5;
    the base of the nose stands a third of the way from the brows to the chin's lower end. The defaults are rounded
    proportions of adults. The surface is smooth (C∞ in x and y) and differentiable in every measure.

    Attributes:
        head_width: Breadth of the skull.
        head_depth: From the middle plane to the front, without features.
        jaw_width: Breadth of the lower face.
        brow: Height of the ridges above the eyes.
        eye_distance: Between the pupils.
        eye_radius: Radius of the eyeballs.
        socket: Depth of the eye sockets.
        nose_y: Where the nose tip stands, below the pupils.
        nose_height: How far the nose tip stands out from the face without features.
        nose_width: Between the outer edges of the wings.
        cheek: Height of the cheekbones.
        mouth_y: Where the mouth line stands, below the pupils.
        mouth_width: Between the corners of the mouth.
        lips: Height of the lips.
        chin: Height of the chin.

    Example:
        >>> import jax
        >>> from jaxlens.surfaces import FaceShape
        >>> shape = FaceShape(nose_height=0.13)
        >>> tip = shape.nose_tip()
        >>> bool(abs(jax.grad(shape.depth_at, argnums=1)(tip[0], tip[1])) < 1e-5)
        True
    """

    head_width: Float[Array, ""] = _measure(0.64)
    head_depth: Float[Array, ""] = _measure(0.40)
    jaw_width: Float[Array, ""] = _measure(0.54)
    brow: Float[Array, ""] = _measure(0.022)
    eye_distance: Float[Array, ""] = _measure(0.27)
    eye_radius: Float[Array, ""] = _measure(0.056)
    socket: Float[Array, ""] = _measure(0.05)
    nose_y: Float[Array, ""] = _measure(0.155)
    nose_height: Float[Array, ""] = _measure(0.115)
    nose_width: Float[Array, ""] = _measure(0.155)
    cheek: Float[Array, ""] = _measure(0.022)
    mouth_y: Float[Array, ""] = _measure(0.29)
    mouth_width: Float[Array, ""] = _measure(0.20)
    lips: Float[Array, ""] = _measure(0.022)
    chin: Float[Array, ""] = _measure(0.03)

    @jitted
    def depth_at(self, x: Float[ArrayLike, "*batch"], y: Float[ArrayLike, "*batch"]) -> Float[Array, "*batch"]:
        """Returns the height z of the surface at (x, y), all in head heights."""
        x, y = jnp.broadcast_arrays(as_floating(x), as_floating(y))
        # The neighbours of the tip slope there: without their tangent plane the tip is where `nose_tip` says.
        tip = self.nose_tip()
        height, slope = jax.jvp(partial(relief, self, tip[0]), (tip[1],), (jnp.ones_like(tip[1]),))
        dx, dy = x - tip[0], y - tip[1]
        excess = height - tip[2] + slope * dy  # along x it is even
        near = jnp.exp(-(((dx**2 + dy**2) / 0.03**2) ** 2))
        return relief(self, x, y) - near * excess

    @jitted
    def inside(self, x: Float[ArrayLike, "*batch"], y: Float[ArrayLike, "*batch"]) -> Bool[Array, "*batch"]:
        """Tells whether (x, y) lies on the head."""
        return jnp.maximum(*outlines(self, as_floating(x), as_floating(y))) > _RIM

    @jitted
    def nose_tip(self) -> Float[Array, "3"]:
        """Returns (x, y, z) of the tip of the nose: the highest point of the surface, in head heights."""
        zero = jnp.zeros_like(self.nose_y)
        return jnp.stack([zero, self.nose_y, skull(self, zero, self.nose_y) + self.nose_height])

    def nose_tip_pixel(self, height: int, width: int, *, view: Float[ArrayLike, ""] = 1.15) -> Float[Array, "2"]:
        """Returns where the nose tip is seen in `face(height, width, view=view)`: (x, y) in pixels, fractional."""
        x, y, _ = self.nose_tip() / (jnp.asarray(view) / height)
        return jnp.stack([x + 0.5 * (width - 1), y + 0.5 * (height - 1)])


@partial(jax.jit, static_argnames=("height", "width"))
def face(height: int, width: int, *, shape: FaceShape | None = None, view: Float[ArrayLike, ""] = 1.15) -> DepthMap:
    """Makes the depth map of a face seen from the front.

    Args:
        height: Height of the picture, in pixels.
        width: Width of the picture, in pixels.
        shape: The face's measures; a mean face by default.
        view: What the picture's height shows, in head heights; the width shows as much as its pixels, which are
            square, hold. The head, about 0.64 wide, is cut off where the picture is narrower.

    Returns:
        A `DepthMap` in units of the head's height: spacing `view / height`, the point midway between the pupils in the
        middle of the picture, the mask true on the head. The same face at every resolution. Differentiable
        with respect to `shape` and `view`.

    Raises:
        ValueError: a picture without pixels.

    Example:
        >>> from jaxlens.surfaces import FaceShape, face
        >>> face(60, 50).depth.shape
        (60, 50)
        >>> [round(float(value), 2) for value in FaceShape().nose_tip_pixel(60, 50)]
        [24.5, 37.59]
    """
    x, y, pitch, shape = _grid(height, width, shape, view)
    return DepthMap(shape.depth_at(x, y), mask=shape.inside(x, y), spacing=pitch)


@partial(jax.jit, static_argnames=("height", "width"))
def face_albedo(
    height: int, width: int, *, shape: FaceShape | None = None, view: Float[ArrayLike, ""] = 1.15
) -> Float[Array, "height width"]:
    """Makes the picture of what the face reflects: skin, hair, brows, eyes and lips, between 0 (black) and 1.

    Args are those of `face`, whose surface it colours. Smooth; differentiable with respect to `shape` and `view`.
    """
    x, y, _, shape = _grid(height, width, shape, view)
    return albedo(shape, x, y)


def _grid(height: int, width: int, shape: FaceShape | None, view: ArrayLike):
    if height < 1 or width < 1:
        raise ValueError(f"a picture needs at least one pixel, got height {height} and width {width}")
    shape = FaceShape() if shape is None else shape
    dtype = jnp.result_type(*jax.tree.leaves(shape))
    pitch = as_floating(view).astype(dtype) / height
    x, y = split(pixel_grid(height, width, dtype))
    return (x - (width - 1) / 2) * pitch, (y - (height - 1) / 2) * pitch, pitch, shape
