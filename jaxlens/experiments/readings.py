"""The three ways to read Φ⁻¹(r²) in Eq. 11: which point of the source an output pixel shows, as maps.

The library's own is the functional inverse. The other two live here, for the experiment that compares them.
"""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.experiments.paper import Reading
from jaxlens.lenses import RadialPolynomial
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import as_points


class Reciprocal(CoordinateMap):
    """`x → x / Φ(r²)`: the inverse of the number."""

    lens: RadialPolynomial

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Divides points by the lens's factor at them."""
        points = as_points(points)
        return points / self.lens.factor(jnp.sum(points**2, axis=-1))[..., None]


class Direct(CoordinateMap):
    """`x → x Φ(r²)`: no inverse at all."""

    lens: RadialPolynomial

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Multiplies points by the lens's factor at them."""
        return self.lens.distort(points)


def source_map(kappa: Float[Array, " order"], reading: Reading = "functional inverse") -> CoordinateMap:
    """Returns the map from output to source of Eq. 11 under one of its readings, for the lens with coefficients κ."""
    lens = RadialPolynomial(kappa)
    if reading == "functional inverse":
        return lens.inverse()
    return Reciprocal(lens) if reading == "reciprocal" else Direct(lens)
