"""Where a lens is one-to-one: a region that is star-shaped about its centre, found once a lens."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxlens.newton import determinant, value_and_jacobian
from jaxlens.numerics import join

PlaneMap = Callable[[Float[Array, "*batch 2"]], Float[Array, "*batch 2"]]

# Rays from the centre, and places on each of them: neighbours are 5 % apart.
_DIRECTIONS = 64
_PLACES = 256
_NEAREST, _FARTHEST = 1e-3, 1e3
# Looks, each between the last place before a fold and the first beyond it: in the fourth they are 1e-9 apart.
_ROUNDS = 4
# Between two rays the edge may lie this share nearer, or farther, than on both.
_MARGIN = 0.01


class Region(eqx.Module):
    """The region about a centre where a lens keeps orientation: all points before the first fold on their ray.

    Attributes:
        center: The centre, in ideal coordinates.
        rays: Unit vectors along the rays.
        edges: The ideal radius of the fold on each ray, ∞ where there is none.
        observed: Its observed radius about the centre's image, ∞ where there is none.
    """

    center: Float[Array, "2"]
    rays: Float[Array, "directions 2"]
    edges: Float[Array, " directions"]
    observed: Float[Array, " directions"]

    def surely(self, x: Float[Array, "*batch"], y: Float[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Tells whether points at offsets (x, y) from the centre lie before the nearest fold of all."""
        nearest = (1 - _MARGIN) * jnp.min(self.edges)
        return x * x + y * y <= nearest * nearest

    def contains(
        self, x: Float[Array, "*batch"], y: Float[Array, "*batch"], determinant: Float[Array, "*batch"]
    ) -> Bool[Array, "*batch"]:
        """Tells whether points at offsets (x, y) from the centre, of these Jacobian determinants, lie in the region.

        The rays beside a point say between which radii the edge lies; there the point's own determinant decides.
        """
        radius = jnp.sqrt(x * x + y * y)
        after = jnp.floor(_turn(x, y)).astype(jnp.int32) % _DIRECTIONS
        pair = self.edges[after], self.edges[(after + 1) % _DIRECTIONS]
        near, far = jnp.minimum(*pair), jnp.maximum(*pair)
        return (radius <= (1 - _MARGIN) * near) | ((radius <= (1 + _MARGIN) * far) & (determinant > 0))

    def edge(self, x: Float[Array, "*batch"], y: Float[Array, "*batch"]) -> Float[Array, "*batch 2"]:
        """Returns the points of the edge in the directions of offsets (x, y), between rays by linear interpolation."""
        turn = _turn(x, y)
        after = jnp.floor(turn).astype(jnp.int32)
        share = turn - after
        near, far = self.edges[after % _DIRECTIONS], self.edges[(after + 1) % _DIRECTIONS]
        radius = jnp.where(jnp.isfinite(near) & jnp.isfinite(far), near * (1 - share) + far * share, 0)
        size = jnp.sqrt(x * x + y * y)
        scale = radius / jnp.where(size > 0, size, 1)
        return join(self.center[0] + x * scale, self.center[1] + y * scale)

    def beyond(self, x: Float[Array, "*batch"], y: Float[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Tells whether observed points, at offsets (x, y) from the centre's image, lie beyond every fold's image."""
        farthest = (1 + _MARGIN) * jnp.max(self.observed)
        return x * x + y * y > farthest * farthest


def find_region(distort: PlaneMap, center: Float[Array, "2"]) -> Region:
    """Follows the sign of the Jacobian determinant along rays from the centre: all the way first, then where it turns.

    A place where the lens is not finite (a pole, an overflow) ends the region too.
    """
    dtype = center.dtype
    rays, shares = jnp.asarray(_rays(), dtype), jnp.asarray(np.linspace(0, 1, _PLACES), dtype)
    low, high = (jnp.full(_DIRECTIONS, radius, dtype) for radius in (_NEAREST, _FARTHEST))

    def narrow(look, bracket):
        low, high, folds = bracket
        radii = low[:, None] * (high / low)[:, None] ** shares[None]
        regular = determinant(value_and_jacobian(distort, _along(center, rays[:, None], radii))[1]) > 0
        found = ~jnp.all(regular, axis=1)
        # A later look may miss, by rounding, the end that an earlier one has found.
        first = jnp.where(found, jnp.argmin(regular, axis=1), _PLACES - 1)
        ends = (jnp.take_along_axis(radii, jnp.maximum(first + k, 0)[:, None], axis=1)[:, 0] for k in (-1, 0))
        return *ends, jnp.where(look == 0, found, folds)

    low, _, folds = lax.fori_loop(0, _ROUNDS, narrow, (low, high, jnp.ones(_DIRECTIONS, bool)))
    offset = distort(_along(center, rays, low)) - distort(center)[None]
    observed = jnp.sqrt(jnp.sum(offset * offset, axis=-1))
    return Region(center, rays, jnp.where(folds, low, jnp.inf), jnp.where(folds, observed, jnp.inf))


def _along(center: Array, rays: Array, radius: Array) -> Array:
    return join(center[0] + radius * rays[..., 0], center[1] + radius * rays[..., 1])


def _rays() -> Float[np.ndarray, "directions 2"]:
    """Returns unit vectors whose `_turn`s are the whole numbers."""
    turn = 4 * np.arange(_DIRECTIONS) / _DIRECTIONS
    corners = np.stack([np.abs(turn - 2), np.abs((turn - 1) % 4 - 2)], axis=-1) - 1
    return corners / np.hypot(*corners.T)[:, None]


def _turn(x: Array, y: Array) -> Array:
    """Grows from 0 to the number of directions as a vector turns once: an angle without trigonometry."""
    size = jnp.abs(x) + jnp.abs(y)
    share = y / jnp.where(size > 0, size, 1)
    quarter = jnp.where(x >= 0, jnp.where(y >= 0, share, 4 + share), 2 - share)
    return quarter * (_DIRECTIONS / 4)
