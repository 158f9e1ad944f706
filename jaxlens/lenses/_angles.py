"""Angles from and to what is smooth in them, without the functions of the C library, which are not vectorized."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.chebyshev import chebpts1

from jaxlens.numerics import epsilon, polynomial

# In θ² the series of sin θ / θ and cos θ converge so fast that these leave less than rounding, up to π; each term
# follows from the one before.
_ORDERS = np.arange(1, 16)
_SINE = (1.0, *np.cumprod(-1 / (2 * _ORDERS * (2 * _ORDERS + 1))).tolist())
_COSINE = (1.0, *np.cumprod(-1 / (2 * _ORDERS * (2 * _ORDERS - 1))).tolist())
# arctan(t) / t in t², for t up to the tangent of an eighth of the largest angle, to 1e-16: through Chebyshev's nodes.
_REACH = np.tan(np.pi / 8) ** 2
_NODES = _REACH / 2 * (1 + chebpts1(13))
_SERIES = Chebyshev.fit(_NODES, np.arctan(np.sqrt(_NODES)) / np.sqrt(_NODES), 12, [0, _REACH])
_ARCTANGENT = tuple(_SERIES.convert(kind=Polynomial).coef.tolist())

Plane = Float[Array, "*batch"]


def angle_over_radius(squared: Plane, z: Plane) -> Plane:
    """Returns θ / R, where R is the distance of (x, y, z) from the axis and tan θ = R / z; from R² and z.

    Smooth on the axis; large, not infinite, at the antipode.
    """
    # The distance d and z: d + z loses its digits behind, where it is R² / (d − z).
    behind = z < 0
    larger = jnp.sqrt(squared + z * z) + jnp.abs(z)
    least = epsilon(z.dtype) ** 2
    total = jnp.where(behind, jnp.maximum(jnp.where(behind, squared, 1), least) / larger, larger)
    # The tangents of a half, a quarter, an eighth of the angle, each over R.
    half = 1 / total
    quarter = half / (1 + jnp.sqrt(1 + squared * half * half))
    eighth = quarter / (1 + jnp.sqrt(1 + squared * quarter * quarter))
    return 8 * eighth * polynomial(_ARCTANGENT, squared * eighth * eighth)


def sine_and_cosine(squared_angle: Plane) -> tuple[Plane, Plane]:
    """Returns sin θ / θ and cos θ from θ², up to π²."""
    squared_angle = jnp.minimum(squared_angle, np.pi**2)
    return polynomial(_SINE, squared_angle), polynomial(_COSINE, squared_angle)
