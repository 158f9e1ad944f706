"""Pictures from camera to camera."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real, Shaped

from jaxlens.cameras._camera import Camera
from jaxlens.cameras._sight import sight
from jaxlens.sampling import Border, Method
from jaxlens.warping import warp

if TYPE_CHECKING:
    import jaxlie


def reproject(
    image: Shaped[ArrayLike, "height width *channels"],
    source_camera: Camera,
    target_camera: Camera,
    rotation: "jaxlie.SO3 | Float[ArrayLike, '3 3'] | None" = None,
    *,
    method: Method = "bilinear",
    border: Border = "constant",
    fill: Real[ArrayLike, "*fill"] = 0.0,
    antialias: bool = False,
) -> Shaped[Array, "new_height new_width *channels"]:
    """Makes the picture that another camera would have taken from the same place.

    Undistorting is the way to `camera.view()`, distorting the way from it; rectifying, a panorama, a crop and a zoom
    are other targets. Each pixel of the target is sent along its ray to where the source observes it
    (`Camera.transfer` sends points the other way), and the picture is sampled there.

    Args:
        image: `(H, W)` or `(H, W, C)`, any real dtype, taken by `source_camera`.
        source_camera: The camera that took it.
        target_camera: The camera that shall have taken it; its size is that of the result.
        rotation: From the target's directions to the source's: `jaxlie.SO3`, or a matrix of shape (3, 3). None where
            both look the same way.
        method: The interpolation, as in `remap`. `nearest` is for labels: it gives values of the image, or `fill`.
        border: What lies outside the picture, as in `remap`. What the source's lens does not see takes the fill value,
            whatever the border.
        fill: The value of pixels without a source: a number, or one for each channel.
        antialias: Average over footprints where the picture shrinks, as in `remap`.

    Returns:
        The picture, in the dtype of `image`. Differentiable as `remap`, and with respect to both cameras and the
        rotation; a batch of cameras goes by `jax.vmap`.

    Raises:
        ValueError: the image has not the source camera's size, the rotation is none; as `remap`.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> fisheye = jl.Camera(jl.KannalaBrandt([0.05, -0.01]), jl.Frame([319.5, 239.5], 260.0), 640, 480)
        >>> panorama = fisheye.view(fov=180, size=(720, 360), projection="equirectangular")
        >>> jl.reproject(jnp.ones((480, 640)), fisheye, panorama).shape
        (360, 720)
    """
    image = jnp.asarray(image)
    if image.ndim >= 2 and image.shape[:2] != (source_camera.height, source_camera.width):
        raise ValueError(
            f"the image is {image.shape[1]} × {image.shape[0]} pixels, and the source camera's are "
            f"{source_camera.width} × {source_camera.height}: camera.resized(width, height) is the camera of a resized "
            "image, camera.cropped(top, left, height, width) that of a part"
        )
    # Left to be `warp`'s own, zero is known when the program is made, and what another fill value takes is not in it.
    options = {} if isinstance(fill, float | int) and fill == 0 else {"fill": fill}
    return warp(
        image,
        sight(source_camera.lens, target_camera.lens, rotation),
        frame=source_camera.frame,
        output_frame=target_camera.frame,
        shape=(target_camera.height, target_camera.width),
        method=method,
        border=border,
        antialias=antialias,
        **options,
    )
