"""What lenses share that are given backwards: the ideal radius as a function of the observed one."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int8

from jaxlens.lenses._lens import RadialLens, _in_common_dtype
from jaxlens.maps import InverseStatus, inverse_status
from jaxlens.numerics import jitted


class ReversedLens(RadialLens):
    """A radial lens whose `undistort` is another one's `distort`, and whose `distort` is that one's exact inverse."""

    @abc.abstractmethod
    def reverse(self) -> RadialLens:
        """Returns the lens, of the same centre of distortion, that takes observed points to ideal ones."""

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones; NaN beyond the fold radius, where nothing is seen."""
        return self.reverse().preimages(points)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ, the ratio of observed to ideal radius, at squared ideal radii; NaN beyond the fold."""
        scale, status = self.reverse().ideal_scale(squared_radius)
        return jnp.where(status == InverseStatus.CONVERGED, scale, jnp.nan)

    def fold_radius(self) -> Float[Array, ""]:
        """Returns the largest ideal radius that is seen, where the observed one reaches its edge; ∞ if none is."""
        return self.reverse().edge_radius()

    def edge_radius(self) -> Float[Array, ""]:
        """Returns the observed radius at which the ideal one stops growing; ∞ if it never does."""
        return self.reverse().fold_radius()

    def ideal_scale(self, squared: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Int8[Array, "*batch"]]:
        """Returns the ratio of ideal to observed radius, and the status (see `RadialLens.ideal_scale`)."""
        finite = squared <= jnp.finfo(squared.dtype).max
        lens, squared = _in_common_dtype(self, jnp.where(finite, squared, 0))
        edge = lens.edge_radius()
        inside = squared <= edge * edge
        scale = lens.reverse().factor(jnp.where(inside, squared, 0))
        finite &= squared * scale * scale < jnp.inf
        scale = jnp.where(finite, scale, 1)
        # A point beyond the edge goes to the fold on its own ray.
        beyond = lens.fold_radius() / jnp.sqrt(jnp.where(inside, 1, squared))
        return jnp.where(inside, scale, beyond), inverse_status(finite, inside, jnp.ones_like(inside))
