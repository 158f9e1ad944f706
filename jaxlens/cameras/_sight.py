"""From what one lens observes to what another does, in the same place: by the ray between."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses import Lens, Perspective, WideLens, on_the_plane
from jaxlens.maps import CoordinateMap, OneToOne
from jaxlens.numerics import as_floating, as_points, is_concrete, join, split

if TYPE_CHECKING:
    import jaxlie

# How far the columns of a matrix may be from unit vectors at right angles.
_ORTHOGONAL = 1e-3


def sight(source: Lens, target: Lens, rotation: "jaxlie.SO3 | Float[ArrayLike, '3 3'] | None" = None) -> CoordinateMap:
    """Returns the map from the target's observed points to those where the source observes the same rays.

    Args:
        source: The lens that has seen something.
        target: The lens that shall have seen it.
        rotation: From the target's directions to the source's; None where both look the same way.

    Returns:
        A map of normalized coordinates that sends what the source does not see to NaN: what `jaxlens.warp` takes.

    Raises:
        ValueError: as `as_rotation`.
    """
    matrix = as_rotation(rotation)
    if not isinstance(target, Perspective):
        return _ByRays(source, target, matrix)
    # The plane's points are ideal points already.
    return OneToOne(source if matrix is None else _TurnedPlane(source, matrix))


def as_rotation(rotation: "jaxlie.SO3 | ArrayLike | None") -> Float[Array, "3 3"] | None:
    """Returns a rotation as a matrix; None stays None.

    Raises:
        ValueError: it is no single rotation.
    """
    if rotation is None:
        return None
    matrix = as_floating(rotation.as_matrix() if hasattr(rotation, "as_matrix") else rotation)
    if matrix.shape != (3, 3):
        raise ValueError(
            f"a rotation is a jaxlie.SO3 or a matrix of shape (3, 3), got shape {matrix.shape}; a batch goes by "
            "jax.vmap"
        )
    if is_concrete(matrix) and not bool(jnp.max(jnp.abs(matrix @ matrix.T - jnp.eye(3))) < _ORTHOGONAL):
        raise ValueError(f"the matrix is no rotation: its rows are not of length one and at right angles: {matrix}")
    return matrix


def rotate(matrix: Float[Array, "*#batch 3 3"], rays: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Returns rays turned by a matrix: on planes, which fuses."""
    x, y, z = split(rays)
    return join(*(matrix[..., i, 0] * x + matrix[..., i, 1] * y + matrix[..., i, 2] * z for i in range(3)))


def move(pose: "jaxlie.SE3", points: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Returns points in the coordinates to which a pose leads."""
    shift = pose.translation()
    turned = rotate(pose.rotation().as_matrix(), points)
    return join(*(turned[..., i] + shift[..., i] for i in range(3)))


class _ByRays(CoordinateMap):
    """The target's points, their rays, turned, and where the source observes them."""

    source: Lens
    target: Lens
    rotation: Float[Array, "3 3"] | None

    @property
    def needs_frame(self) -> bool:
        return True

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        rays = self.target.unproject(points)
        return self.source.project(rays if self.rotation is None else rotate(self.rotation, rays))


class _TurnedPlane(CoordinateMap):
    """What a lens observes of the points of a plane that does not stand square to its axis."""

    lens: Lens
    rotation: Float[Array, "3 3"]

    @property
    def needs_frame(self) -> bool:
        return True

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        if isinstance(self.lens, WideLens):
            return self.lens.observe(self._rays(points))[0]
        return self.lens.distort(self._ideal(points)[0])

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether the lens sees points of the plane."""
        if isinstance(self.lens, WideLens):
            return self.lens.observe(self._rays(points))[1]
        ideal, ahead = self._ideal(points)
        return ahead & self.lens.one_to_one(ideal)

    def surely_one_to_one(self, points: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"] | None:
        """As of the lens, before it: from plane to plane, what is convex stays convex."""
        ideal, ahead = self._ideal(points)
        surely = self.lens.surely_one_to_one(ideal)
        return None if surely is None else ahead & surely

    def _rays(self, points: ArrayLike) -> Float[Array, "*batch 3"]:
        x, y = split(as_points(points))
        return rotate(self.rotation, join(x, y, jnp.ones_like(x)))

    def _ideal(self, points: ArrayLike) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """The points in the lens's own plane, and whether they lie ahead of it; those that do not are on its axis."""
        return on_the_plane(self._rays(points))
