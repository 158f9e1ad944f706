"""Solves r / P(r) = tan θ for the radius, P a polynomial with P(0) = 1, for angles past a right one as well."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.maps import InverseStatus
from jaxlens.newton import implicit_root
from jaxlens.numerics import epsilon, jitted

Plane = Float[Array, "*batch"]

_POLISHING_STEPS = 2


class Quotient(eqx.Module):
    """A polynomial P, one at zero. With r the ray (r, P(r)) turns away from the axis, up to a fold."""

    @abc.abstractmethod
    def depth(self, squared: Plane) -> Plane:
        """Returns P at squared radii."""

    @abc.abstractmethod
    def fold_radius(self) -> Float[Array, ""]:
        """Returns the radius at which the ray stops turning, where P = r dP/dr; ∞ if it never does."""

    @abc.abstractmethod
    def limit(self) -> Float[Array, ""]:
        """Returns the limit of P(r) / r at infinity, −∞ included, where there is no fold."""

    def ratio(self, squared: Plane, z: Plane) -> tuple[Plane, Bool[Array, "*batch"]]:
        """Returns r / R for rays (R, z) of any length, finite everywhere, and which of them have a radius.

        Args:
            squared: R².
            z: z.
        """
        found, reached = _solve(*lax.stop_gradient((self, squared, z)))
        return implicit_root(_residual, found, (self, squared, z)), reached


def _residual(ratio: Plane, parameters: tuple[Quotient, Plane, Plane]) -> Plane:
    quotient, squared, z = parameters
    return z * ratio - quotient.depth(squared * ratio * ratio)


def _solve(quotient: Quotient, squared: Plane, z: Plane) -> tuple[Plane, Bool[Array, "*batch"]]:
    ahead = z + jnp.sqrt(z * z + squared)
    some = ahead > 0
    doubled = 2 / jnp.where(some, ahead, 1)
    ratio, status = _HalfAngle(quotient, squared.dtype).ideal_scale(squared * doubled * doubled)
    reached = some & (status == InverseStatus.CONVERGED)
    ratio = jnp.where(reached, ratio * doubled, 1)
    # Far from the axis the half angle may hardly change with the radius; there this equation is nearly linear.
    for _ in range(_POLISHING_STEPS):
        left, slope = jax.jvp(lambda ratio: _residual(ratio, (quotient, squared, z)), (ratio,), (jnp.ones_like(ratio),))
        better = ratio - left / jnp.where(slope > 0, slope, 1)
        ratio = jnp.where(jnp.abs(_residual(better, (quotient, squared, z))) < jnp.abs(left), better, ratio)
    return ratio, reached


class _HalfAngle(RadialLens):
    """From r to 2 tan(θ/2), which is finite past a right angle, and about r near the axis."""

    quotient: Quotient
    center: Float[Array, "2"]

    def __init__(self, quotient: Quotient, dtype: jnp.dtype):
        self.quotient = quotient
        self.center = as_center(None, dtype)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        depth = self.quotient.depth(squared_radius)
        length = jnp.sqrt(depth * depth + squared_radius)
        ahead = depth > 0
        in_front = 2 / jnp.where(ahead, depth + length, 1)
        return jnp.where(ahead, in_front, 2 * (length - depth) / jnp.where(ahead, 1, squared_radius))

    @jitted
    def fold_radius(self) -> Float[Array, ""]:
        return self.quotient.fold_radius()

    def edge_radius(self) -> Float[Array, ""]:
        limit = self.quotient.limit()
        bounded = limit > -jnp.inf
        limit = jnp.where(bounded, limit, 0)
        # Infinity itself is not reached.
        end = 2 * (jnp.sqrt(1 + limit * limit) - limit) * (1 - 2 * epsilon(limit.dtype))
        return jnp.where(jnp.isfinite(self.fold_radius()), super().edge_radius(), jnp.where(bounded, end, jnp.inf))
