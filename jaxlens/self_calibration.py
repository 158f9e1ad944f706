"""A camera that only rotates: its focal length from what it sees, and what lens distortion does to that.

Between the images of a rotating pinhole camera lies the homography `H = K R K⁻¹`, whatever the scene. The image of the
absolute conic, `ω = K⁻ᵀ K⁻¹`, is the same in all of them: `ω = H⁻ᵀ ω H⁻¹` for H of determinant one (Hartley 1994;
de Agapito, Hayman & Reid 2001). With square pixels and a known principal point `ω = diag(w, w, 1)`, `w = 1/f²`, and
every entry of that equation is linear in w.

A lens bends the rays, and then there is no such H. The one fitted all the same has w about 2 to 3 κ too large (in half
diagonals, for `x_d = x_u (1 + κ r²)`): pincushion, κ > 0, makes the focal length come out too short and barrel too
long; and barrel of κ below about −0.4/f² makes w negative, that is the focal length "longer than infinite".
"""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.deformations import direct_linear_transform
from jaxlens.fitting import rotation_matrix
from jaxlens.lenses import Lens
from jaxlens.numerics import as_floating, as_points, epsilon, join

# Pans, tilts and what lies between, as shares of the field of view.
_DIRECTIONS = np.arange(8) * np.pi / 4
_SHARE = 0.3


class SelfCalibration(eqx.Module):
    """What `self_calibrate_focal_length` returns.

    Attributes:
        focal_length: In the units of the homographies; infinite where `inverse_square` is not positive.
        inverse_square: 1/f², the unknown of the linear equations. It is meaningful, as a measure of how far the images
            are from those of a pinhole camera, even where it is negative.
        valid: Whether there is a focal length: `inverse_square` is positive, and the rotations determine it.
    """

    focal_length: Float[Array, ""]
    inverse_square: Float[Array, ""]
    valid: Bool[Array, ""]


class RotatingCamera(eqx.Module):
    """A camera with square pixels whose axis goes through the middle of its pictures, and a lens.

    Lengths in the image are in half diagonals of the picture, from its middle: Eq. 10's normalized coordinates.

    Attributes:
        lens: Takes ideal to observed points.
        focal_length: In half diagonals.
        half_field: Half the picture's (width, height), in half diagonals; its norm is one.
    """

    lens: Lens
    focal_length: Float[Array, ""]
    half_field: Float[Array, "2"]

    def __init__(self, lens: Lens, focal_length: Float[ArrayLike, ""], *, aspect: float = 4 / 3):
        """Makes a camera.

        Args:
            lens: Takes ideal to observed points.
            focal_length: In half diagonals of the picture, positive.
            aspect: Width over height of the picture.
        """
        self.lens = lens
        self.focal_length = as_floating(focal_length)
        self.half_field = as_floating([aspect / (1 + aspect**2) ** 0.5, 1 / (1 + aspect**2) ** 0.5])

    def correspondences(
        self, rotation: Float[Array, "3 3"], *, side: int = 25
    ) -> tuple[Float[Array, "points 2"], Float[Array, "points 2"], Bool[Array, " points"]]:
        """Follows far points from one picture to the next, between which the camera has rotated.

        Args:
            rotation: Takes the camera's coordinates before (x right, y down, z forward) to those after.
            side: The first picture is covered by a grid of so many points each way.

        Returns:
            Observed points in the first and in the second picture, and which of them are seen in both: inside the
            pictures, before the camera, and where the lens is one-to-one. The others are finite.
        """
        steps = jnp.linspace(-1, 1, side, dtype=self.half_field.dtype)
        x, y = jnp.meshgrid(steps * self.half_field[0], steps * self.half_field[1])
        before = join(x.ravel(), y.ravel())
        inverse = self.lens.invert(before)
        rays = jnp.concatenate([inverse.points / self.focal_length, jnp.ones_like(before[:, :1])], axis=1) @ rotation.T
        ahead = rays[:, 2] > 0.05
        turned = self.focal_length * rays[:, :2] / jnp.where(ahead, rays[:, 2], 1)[:, None]
        after = self.lens.distort(turned)
        inside = jnp.all(jnp.abs(after) <= self.half_field[None, :], axis=1)
        seen = inverse.valid & ahead & inside & self.lens.one_to_one(turned)
        return before, after, seen


@jax.jit
def self_calibrate_focal_length(
    homographies: Float[ArrayLike, "views 3 3"],
    *,
    center: Float[ArrayLike, "2"] | Sequence[ArrayLike] = (0.0, 0.0),
    unit: Float[ArrayLike, ""] = 1.0,
) -> SelfCalibration:
    """Finds the focal length of a rotating camera from homographies between its pictures, in closed form.

    Args:
        homographies: `(V, 3, 3)`, from the points of one picture to those of another, of any scale; at least one whose
            rotation is not about the optical axis alone.
        center: The principal point.
        unit: A length of the picture's size, such as half its diagonal in pixels: the least-squares equations of all
            views are balanced in these units. With exact homographies it does not matter.

    Returns:
        A `SelfCalibration`. Differentiable. Homographies of a camera with a lens give a biased focal length:
        estimate them from undistorted points.

    Raises:
        ValueError: a wrong shape.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxlens.self_calibration import self_calibrate_focal_length
        >>> pan = jnp.asarray([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
        >>> camera_matrix = jnp.diag(jnp.asarray([2.0, 2.0, 1.0]))
        >>> homography = camera_matrix @ pan @ jnp.linalg.inv(camera_matrix)
        >>> round(float(self_calibrate_focal_length(homography[None]).focal_length), 4)
        2.0
    """
    matrices, center, unit = as_floating(homographies), as_points(center), as_floating(unit)
    if matrices.ndim != 3 or matrices.shape[1:] != (3, 3) or matrices.shape[0] == 0:
        raise ValueError(f"homographies must have shape (V, 3, 3), one at least, got {matrices.shape}")
    dtype = matrices.dtype
    center, unit = center.astype(dtype), unit.astype(dtype)
    inverse, zero, one = 1 / unit, jnp.zeros_like(unit), jnp.ones_like(unit)
    rows = [[inverse, zero, -center[0] * inverse], [zero, inverse, -center[1] * inverse], [zero, zero, one]]
    towards = jnp.stack([jnp.stack(row) for row in rows])
    matrices = jnp.einsum("ij,vjk,kl->vil", towards, matrices, jnp.linalg.inv(towards))
    matrices = matrices / jnp.max(jnp.abs(matrices), axis=(1, 2), keepdims=True)
    matrices = matrices / jnp.cbrt(jnp.linalg.det(matrices))[:, None, None]
    # Hᵀ ω H = ω, entry by entry: w (h1i h1j + h2i h2j − δij, i and j not 3) + h3i h3j − δ33 = 0.
    products = jnp.einsum("vri,vrj->vrij", matrices, matrices)
    coefficients = products[:, 0] + products[:, 1] - jnp.diag(jnp.asarray([1, 1, 0], dtype))[None]
    constants = products[:, 2] - jnp.diag(jnp.asarray([0, 0, 1], dtype))[None]
    # Each of the six entries once.
    once = jnp.triu(jnp.ones((3, 3), dtype))[None]
    strength = jnp.sum(once * coefficients**2)
    determined = strength > 64 * epsilon(dtype) * matrices.shape[0]
    inverse_square = -jnp.sum(once * coefficients * constants) / jnp.where(determined, strength, 1)
    positive = inverse_square > 0
    length = unit * jax.lax.rsqrt(jnp.where(positive, inverse_square, 1))
    return SelfCalibration(
        jnp.where(positive, length, jnp.inf), inverse_square / unit**2, determined & positive & jnp.isfinite(length)
    )


def pan_and_tilt(camera: RotatingCamera, *, share: float = _SHARE) -> Float[Array, "views 3 3"]:
    """Returns eight rotations: pans and tilts to both sides, and the four between.

    Args:
        camera: For its field of view (without the lens).
        share: How far to turn, as a share of the field of view along that direction.
    """
    field = 2 * jnp.arctan(camera.half_field / camera.focal_length)
    cosine, sine = jnp.asarray(np.cos(_DIRECTIONS), field.dtype), jnp.asarray(np.sin(_DIRECTIONS), field.dtype)
    vectors = share * jnp.stack([sine * field[1], cosine * field[0], jnp.zeros_like(sine)], axis=1)
    return rotation_matrix(vectors)


@partial(jax.jit, static_argnames=("undistorted", "side"))
def calibrate_by_rotation(
    camera: RotatingCamera,
    *,
    rotations: Float[Array, "views 3 3"] | None = None,
    undistorted: bool = False,
    side: int = 25,
) -> SelfCalibration:
    """Simulates a rotating camera, fits homographies to what it sees, and self-calibrates its focal length from them.

    Args:
        camera: The camera. A pytree: `jax.vmap` over cameras makes a study.
        rotations: `(V, 3, 3)` between the pictures of each pair; those of `pan_and_tilt` by default.
        undistorted: Fit the homographies to undistorted points, as one should.
        side: Points along each side of the first picture.

    Returns:
        A `SelfCalibration`, in half diagonals.
    """
    rotations = pan_and_tilt(camera) if rotations is None else rotations
    follow = jax.vmap(partial(camera.correspondences, side=side))
    before, after, seen = follow(rotations)
    if undistorted:
        before, after = jax.vmap(lambda points: camera.lens.invert(points).points)(jnp.stack([before, after]))
    homographies = jax.vmap(direct_linear_transform)(before, after, seen.astype(before.dtype))
    return self_calibrate_focal_length(homographies)


def focal_length_bias(
    camera: RotatingCamera,
    *,
    rotations: Float[Array, "views 3 3"] | None = None,
    undistorted: bool = False,
    side: int = 25,
) -> Float[Array, ""]:
    """Returns the relative error of the self-calibrated focal length: estimate / truth − 1.

    Args are those of `calibrate_by_rotation`. Negative for pincushion and positive for barrel lenses, infinite for
    barrel so strong that no focal length fits.

    Example:
        >>> import jaxlens as jl
        >>> from jaxlens.self_calibration import RotatingCamera, focal_length_bias
        >>> [round(float(focal_length_bias(RotatingCamera(jl.RadialPolynomial([k]), 1.5))), 2) for k in (-0.03, 0.03)]
        [0.1, -0.07]
    """
    found = calibrate_by_rotation(camera, rotations=rotations, undistorted=undistorted, side=side)
    return found.focal_length / camera.focal_length - 1
