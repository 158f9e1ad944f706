"""The Brown–Conrady lens in OpenCV's parameters: radial, tangential, and rational terms."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._lens import Lens
from jaxlens.lenses._radial_polynomial import RadialPolynomial
from jaxlens.maps import Inverse, InverseStatus
from jaxlens.newton import determinant, plane_jacobian
from jaxlens.numerics import as_floating, as_points, jitted, join, split

# Points of a ray at which a lens must keep orientation to be called one-to-one up to the ray's end.
_RAY = 8


class BrownConrady(Lens):
    """`x_d = x_u R + (2 p1 x y + p2 (r² + 2 x²), p1 (r² + 2 y²) + 2 p2 x y)` (Brown 1966; OpenCV's model and order).

    R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) with r = |x_u|. The coordinates are those of a
    camera matrix (`Frame.from_camera_matrix`), and the principal point is the centre of distortion.

    Attributes:
        coefficients: k1, k2, p1, p2[, k3[, k4, k5, k6]]: 4, 5 or 8 of them, as OpenCV orders them.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.BrownConrady([-0.28, 0.03, 0.001, 0.0, 0.16])
        >>> bool(lens.invert(np.array([0.3, 0.2])).valid)
        True
    """

    coefficients: Float[Array, " terms"]

    def __init__(self, coefficients: ArrayLike | list | tuple):
        self.coefficients = as_floating(coefficients)
        if self.coefficients.ndim != 1 or self.coefficients.shape[0] not in (4, 5, 8):
            raise ValueError(
                "coefficients must be k1, k2, p1, p2[, k3[, k4, k5, k6]], that is 4, 5 or 8 numbers, got shape "
                f"{self.coefficients.shape}; a batch of lenses is made by jax.vmap(BrownConrady)(coefficients)"
            )

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones, beyond a fold too."""
        x, y = split(as_points(points))
        k1, k2, p1, p2, *rest = self.coefficients
        k3 = rest[0] if rest else 0
        squared = x * x + y * y
        factor = 1 + squared * (k1 + squared * (k2 + squared * k3))
        if len(rest) > 1:
            _, k4, k5, k6 = rest
            factor = factor / (1 + squared * (k4 + squared * (k5 + squared * k6)))
        cross = 2 * x * y
        return join(
            x * factor + p1 * cross + p2 * (squared + 2 * x * x),
            y * factor + p1 * (squared + 2 * y * y) + p2 * cross,
        )

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the ideal points of observed ones, as `CoordinateMap.invert`; valid only this side of a fold.

        A step of Newton's may leap over a fold to where the lens keeps orientation again: such a root is no preimage.
        """
        found = super().invert(points)
        lost = (found.status == InverseStatus.CONVERGED) & ~lax.stop_gradient(self.one_to_one(found.points))
        status = jnp.where(lost, jnp.int8(InverseStatus.NO_PREIMAGE), found.status)
        return Inverse(found.points, status == InverseStatus.CONVERGED, status)

    def first_guess(self, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns preimages under the radial part; for a rational lens, points drawn in to where it is one-to-one."""
        k1, k2, _, _, *rest = self.coefficients
        if len(rest) <= 1:
            return RadialPolynomial(jnp.stack([k1, k2, *rest])).invert(points).points
        share = jnp.arange(_RAY + 1, dtype=points.dtype) / _RAY
        ray = jnp.einsum("...c,s->...sc", points, share)
        inside = determinant(plane_jacobian(self.distort, ray)[1]) > 0
        reached = jnp.sum(jnp.cumprod(inside, axis=-1), axis=-1) - 1
        return points * share[jnp.maximum(reached, 0)][..., None]

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Whether the lens keeps orientation all the way (at eight places) from the centre to ideal points."""
        points = as_points(points)
        share = jnp.arange(1, _RAY + 1, dtype=points.dtype) / _RAY
        ray = jnp.einsum("...c,s->...sc", points, share)
        return jnp.all(determinant(plane_jacobian(self.distort, ray)[1]) > 0, axis=-1)
