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

# Rays from the centre, and places on each of them: neighbours are 1.4 % apart.
_DIRECTIONS = 64
_PLACES = 1024
_NEAREST, _FARTHEST = 1e-3, 1e3
# Looks at fewer places, each between the last before a fold and the first beyond it: in the fourth they are 1e-9 apart.
_ROUNDS, _NARROWED = 4, 64
# Between two rays the edge may lie this share nearer, or farther, than on both.
_MARGIN = 0.01
# Where the edges on two rays differ by more than this share, a fold ends between them; places to look at there.
_JUMP = 0.05
_FOLLOWED = 64


class Region(eqx.Module):
    """The region about a centre where a lens keeps orientation: all points before the first fold on their ray.

    Attributes:
        center: The centre, in ideal coordinates.
        rays: Unit vectors along the rays.
        edges: The ideal radius of the fold on each ray, ∞ where there is none.
        observed: Its observed radius about the centre's image, ∞ where there is none.
        pole: The ideal radius of a known pole, ∞ if there is none: beyond it nothing lies in the region.
    """

    center: Float[Array, "2"]
    rays: Float[Array, "directions 2"]
    edges: Float[Array, " directions"]
    observed: Float[Array, " directions"]
    pole: Float[Array, ""]

    def surely(self, x: Float[Array, "*batch"], y: Float[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Tells whether points at offsets (x, y) from the centre lie before the nearest fold of all."""
        nearest = (1 - _MARGIN) * jnp.min(self.edges)
        return x * x + y * y <= nearest * nearest

    def contains(
        self,
        distort: PlaneMap,
        x: Float[Array, "*batch"],
        y: Float[Array, "*batch"],
        determinant: Float[Array, "*batch"],
    ) -> Bool[Array, "*batch"]:
        """Whether points at offsets (x, y) from the centre, of these Jacobian determinants, lie in the region.

        The rays beside a point say between which radii the edge lies; there the point's own determinant decides. Where
        a fold ends between the two rays, it does not tell points before the fold from those beyond its far side: then
        the sign is followed along the point's own ray.
        """
        radius = jnp.sqrt(x * x + y * y)
        after = jnp.floor(_turn(x, y)).astype(jnp.int32) % _DIRECTIONS
        near, far = (bound[after] for bound in self._between_rays())
        inside = (radius <= (1 - _MARGIN) * near) | (
            (radius <= (1 + _MARGIN) * far) & (radius < self.pole) & (determinant > 0)
        )
        begin = (1 - _MARGIN) * jnp.minimum(near, radius)

        def least(first: Array, last: Array) -> tuple[Array, Array]:
            """The least determinant on a part of the way to a point, and its share of the way."""

            def step(place: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
                share = first + (last - first) * (place + 1).astype(radius.dtype) / _FOLLOWED
                scale = (begin + share * (radius - begin)) / jnp.where(radius > 0, radius, 1)
                size = _determinants(distort, join(self.center[0] + x * scale, self.center[1] + y * scale))
                size = jnp.where(size == size, size, -jnp.inf)  # a pole
                return jnp.where(size < found[0], size, found[0]), jnp.where(size < found[0], share, found[1])

            return lax.fori_loop(0, _FOLLOWED, step, (jnp.full_like(radius, jnp.inf), first))

        def look() -> Array:
            # A fold that is about to end is narrow: it is where the determinant is least, looked at closely.
            _, share = least(jnp.zeros_like(radius), jnp.ones_like(radius))
            lowest, _ = least(jnp.maximum(share - 1 / _FOLLOWED, 0), jnp.minimum(share + 1 / _FOLLOWED, 1))
            return inside & ((lowest > 0) | ~_jumps(near, far))

        return lax.cond(jnp.any(_jumps(*self._between_rays())), look, lambda: inside)

    def _between_rays(self) -> tuple[Float[Array, " directions"], Float[Array, " directions"]]:
        """The nearest and the farthest edge of each ray, the next, and one more to both sides.

        Of those, because a fold that is about to end is narrow, and may be missed on one ray.
        """
        edges = jnp.stack([jnp.roll(self.edges, -k) for k in (-1, 0, 1, 2)])
        return jnp.min(edges, axis=0), jnp.max(edges, axis=0)

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


def find_region(distort: PlaneMap, center: Float[Array, "2"], pole: Float[Array, ""]) -> Region:
    """Follows the sign of the Jacobian determinant along rays from the centre: all the way first, then where it turns.

    A place where the lens is not finite (a pole, an overflow) ends the region too; `pole` is the radius of one that is
    known, which may be too narrow to be found by looking.
    """
    dtype = center.dtype
    rays = jnp.asarray(_rays(), dtype)

    def narrow(places: int, low: Array, high: Array) -> tuple[Array, Array, Array]:
        shares = jnp.asarray(np.linspace(0, 1, places), dtype)
        radii = low[:, None] * (high / low)[:, None] ** shares[None]
        regular = (_determinants(distort, _along(center, rays[:, None], radii)) > 0) & (radii < pole)
        found = ~jnp.all(regular, axis=1)
        # A later look may miss, by rounding, the end that an earlier one has found.
        first = jnp.where(found, jnp.argmin(regular, axis=1), places - 1)
        low, high = (jnp.take_along_axis(radii, jnp.maximum(first + k, 0)[:, None], axis=1)[:, 0] for k in (-1, 0))
        return low, high, found

    low, high, folds = narrow(_PLACES, *(jnp.full(_DIRECTIONS, radius, dtype) for radius in (_NEAREST, _FARTHEST)))
    low, _ = lax.fori_loop(0, _ROUNDS, lambda _, bracket: narrow(_NARROWED, *bracket)[:2], (low, high))
    offset = distort(_along(center, rays, low)) - distort(center)[None]
    observed = jnp.sqrt(jnp.sum(offset * offset, axis=-1))
    return Region(center, rays, jnp.where(folds, low, jnp.inf), jnp.where(folds, observed, jnp.inf), pole)


def _determinants(distort: PlaneMap, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return determinant(value_and_jacobian(distort, points)[1])


def _jumps(near: Float[Array, "*batch"], far: Float[Array, "*batch"]) -> Bool[Array, "*batch"]:
    return far > (1 + _JUMP) * near


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
