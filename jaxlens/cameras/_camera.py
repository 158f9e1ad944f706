"""A camera: what ties rays to pixels."""

import operator
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.cameras._boxes import bound_boxes
from jaxlens.cameras._sight import as_rotation, move, sight
from jaxlens.cameras._views import Keep, ViewProjection, view_lens_and_frame
from jaxlens.frames import Frame
from jaxlens.lenses import Lens
from jaxlens.numerics import as_floating, as_rays, jitted, join, shown, split

if TYPE_CHECKING:
    import jaxlie


class Camera(eqx.Module):
    """A lens, the frame that ties it to pixels, and the size of the pictures.

    Rays have x to the right, y down and z forward; pixels are (x, y), the first pixel's centre at (0, 0). A camera is a
    pytree of the numbers of its lens and its frame: `jax.grad` by them and `jax.vmap` over a batch of cameras work as
    on any array.

    Attributes:
        lens: The lens, `Perspective()` for a camera without distortion.
        frame: Ties pixels to the lens's coordinates: `Frame.from_camera_matrix(K)` of a calibrated camera.
        width: Width of the pictures, in pixels.
        height: Height of the pictures, in pixels.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.BrownConrady([-0.28, 0.07, 0.001, -0.002])
        >>> camera = jl.Camera(lens, jl.Frame([319.5, 239.5], 530.0), 640, 480)
        >>> pixel = camera.project(np.array([0.2, -0.1, 1.0]))
        >>> ray = camera.unproject(pixel)
        >>> bool(np.allclose(ray / ray[2], [0.2, -0.1, 1.0], atol=1e-6))
        True
    """

    lens: Lens
    frame: Frame
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)

    def __init__(self, lens: Lens, frame: Frame, width: int, height: int):
        if not isinstance(lens, Lens):
            raise ValueError(
                f"a camera has a lens, got {type(lens).__name__}: jl.Perspective() is the one that distorts nothing"
            )
        if not isinstance(frame, Frame):
            raise ValueError(
                f"a camera has a frame, got {type(frame).__name__}: of a camera matrix it is "
                "jl.Frame.from_camera_matrix([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])"
            )
        self.lens, self.frame = lens, frame
        self.width, self.height = _count(width, "width"), _count(height, "height")

    def __repr__(self) -> str:
        return shown(self)

    @jitted
    def project(
        self, points: Float[ArrayLike, "*batch 3"], pose: "jaxlie.SE3 | None" = None
    ) -> Float[Array, "*batch 2"]:
        """Maps points of space to pixels, also to such outside the picture.

        Args:
            points: `(..., 3)` in the camera's coordinates, x to the right, y down, z forward; or in the world's.
            pose: From the world's coordinates to the camera's; its batch axes broadcast against those of the points.

        Returns:
            `(..., 2)` pixels, (x, y) order; NaN where the lens does not see (`Lens.project`).
        """
        rays = as_rays(points)
        if pose is not None:
            rays = move(pose, rays)
        return self.frame.denormalize(self.lens.project(rays))

    @jitted
    def unproject(self, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 3"]:
        """Maps pixels `(..., 2)` to unit rays `(..., 3)` in the camera's coordinates; NaN where there is none."""
        return self.lens.unproject(self.frame.normalize(pixels))

    def resized(self, width: int, height: int) -> "Camera":
        """Returns the camera of its pictures resized: the corners of the picture, at −1/2, keep their place."""
        wide, tall = _count(width, "width") / self.width, _count(height, "height") / self.height
        return Camera(self.lens, self.frame.stretched(wide, tall), width, height)

    def cropped(self, top: int, left: int, height: int, width: int) -> "Camera":
        """Returns the camera of a part of its pictures, as `diagnostics.largest_rectangle` names one; or of more."""
        corner = jnp.asarray([left, top], self.frame.center.dtype)
        return Camera(self.lens, Frame(self.frame.center - corner, self.frame.scale), width, height)

    def rotated(self, quarters: int) -> "Camera":
        """Returns the camera of its pictures turned by quarters, counter-clockwise, as `np.rot90(image, quarters)`."""
        camera = self
        for _ in range(operator.index(quarters) % 4):
            # The pixel (x, y) comes to (y, width − 1 − x).
            (x, y), scale = camera.frame.center, camera.frame.scale
            frame = Frame(join(y, camera.width - 1 - x), scale[::-1])
            camera = Camera(camera.lens.turned(1), frame, camera.height, camera.width)
        return camera

    def view(
        self,
        *,
        keep: Keep = "same",
        fov: float | int | None = None,
        size: tuple[int, int] | None = None,
        projection: ViewProjection = "perspective",
    ) -> "Camera":
        """Returns the lens-free camera that looks the same way: what `reproject` makes a picture for without its lens.

        Args:
            keep: `same` keeps the frame: what is in the middle keeps its place and size. `valid` shows only what was
                seen, `all` shows all that was: in perspective as far as nine points a side tell, whose exact preimages
                make OpenCV's `getOptimalNewCameraMatrix` with alpha 0 and 1. Pixels need not be square then.
            fov: The horizontal field in degrees, from edge to edge, in place of `keep`: pixels are square and the axis
                is in the middle.
            size: (width, height) of the pictures; the camera's own unless given.
            projection: `perspective` keeps lines straight, and sees less than 180°; `cylindrical` keeps verticals
                straight; `equirectangular` is the panorama of longitudes and latitudes; `stereographic` keeps angles.

        Returns:
            A camera whose lens is the projection. Differentiable with respect to the camera's parameters.

        Raises:
            ValueError: `keep` and `fov` at once, a field or a size that cannot be; nothing, or a plane without end, is
                what `keep` asks for: `all` in perspective of a lens that sees past 90° from its axis.
        """
        own = self.width, self.height
        width, height = own if size is None else size
        new_size = _count(width, "width"), _count(height, "height")
        lens, frame = view_lens_and_frame(
            self.lens, self.frame, own, keep=keep, fov=fov, new_size=new_size, projection=projection
        )
        return Camera(lens, frame, *new_size)

    def transfer(
        self,
        labels: Float[ArrayLike, "*batch 2"] | Float[ArrayLike, "*batch 4"],
        target: "Camera",
        rotation: "jaxlie.SO3 | Float[ArrayLike, '3 3'] | None" = None,
    ) -> Float[Array, "*batch labels"]:
        """Sends what is marked in a picture to its place in another camera's, as `reproject` sends the pixels.

        Args:
            labels: `(..., 2)` points in pixels, (x, y); or `(..., 4)` boxes, x0, y0, x1, y1.
            target: The camera to whose pictures they shall belong.
            rotation: As in `reproject`: from the target's directions to this camera's.

        Returns:
            Points, exact; NaN where one of the cameras does not see the ray, or where the point lies outside the
            target's picture. Or boxes: the bounds of the bent outlines, as far as they are seen, in full where they
            reach beyond the target's picture, and NaN where nothing lies in it. Differentiable.

        Raises:
            ValueError: the last axis has another length, or the rotation is none.
        """
        labels = as_floating(labels)
        if labels.ndim == 0 or labels.shape[-1] not in (2, 4):
            raise ValueError(
                f"labels are points of shape (..., 2) or boxes of shape (..., 4), x0, y0, x1, y1, got {labels.shape}"
            )
        return _transfer(self, labels, target, as_rotation(rotation))


@jax.jit
def _transfer(source: Camera, labels: Array, target: Camera, rotation: Array | None) -> Array:
    mapping = sight(target.lens, source.lens, None if rotation is None else rotation.T)

    def place(points: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
        return target.frame.denormalize(mapping(source.frame.normalize(points)))

    if labels.shape[-1] == 2:
        first = last = found = place(labels)
    else:
        found = bound_boxes(place, labels.reshape(-1, 4)).reshape(labels.shape)
        first, last = found[..., :2], found[..., 2:]
    end = jnp.asarray([target.width, target.height], found.dtype) - 0.5
    (left, top), (right, bottom), (wide, tall) = split(first), split(last), end
    seen = (right >= -0.5) & (left <= wide) & (bottom >= -0.5) & (top <= tall)
    return jnp.where(seen[..., None], found, jnp.nan)


def _count(value: int, name: str) -> int:
    try:
        count = operator.index(value)
    except TypeError:
        raise ValueError(f"the {name} of pictures is a whole number of pixels, got {value!r}") from None
    if count < 1:
        raise ValueError(f"the {name} of pictures is at least one pixel, got {count}")
    return count
