"""The geodesic distance of a surface that is given by its depth."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.numerics import as_points, epsilon, is_concrete
from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._differences import depth_at
from jaxlens.surfaces._nose_tip import nose_tip
from jaxlens.surfaces._policies import FAR, Field, costs, improved, length, smallest_excess
from jaxlens.surfaces._sweeps import solve, solve_transposed, weighted_sum

# Pixels this near to the source are as far as a straight line.
_RADIUS = 1.5
# What a sweep need not gain, in pixels, by the bytes of a number: far below the error of the discretization.
_TOLERANCE = {4: 1e-4, 8: 1e-10}


def geodesic_distance(
    depth_map: DepthMap, source: Float[ArrayLike, "*sources 2"] | Sequence | None = None
) -> Float[Array, "height width"]:
    """Returns how far each pixel's point is from a source, along the surface.

    The surface is z(x, y), and the distance T solves the eikonal equation ∇Tᵀ G⁻¹ ∇T = 1 with the metric
    G = [[1 + p², p q], [p q, 1 + q²]], p = z_x, q = z_y, in the sense of shortest ways: T(X) is the smallest
    T(Y) + |X − Y| over the points Y between neighbours of X. What T exceeds the straight line to the source by is
    interpolated, not T. So planes, however tilted, are exact, and elsewhere the error falls with the spacing h as
    O(h), with a small constant: on sphere caps with slopes up to 2 at most 1.2e-4 of T at 512² pixels, 1e-3 at 64².
    Slopes are not limited. The surface is the one that the pixels show: what a ridge or a wall does between two of them
    is cut off, and on meshes with creases that is the larger error.

    Sweeps over whole rows and columns in four directions (as Weber et al., "Parallel algorithms for approximation of
    distance maps on parametric surfaces", 2008) are repeated until none lowers a distance by more than 1e-10 of a
    pixel (1e-4 in single precision, which is several times faster).

    Args:
        depth_map: The surface. Ways lead through its mask only, from pixel to pixel in eight directions.
        source: (x, y) in pixels, also between pixels, or `(K, 2)` of them: the distance is that to the nearest. The
            nose tip (`nose_tip`), unless given.

    Returns:
        `(H, W)` distances in world units; NaN outside the mask, ∞ where no way leads to a source.
        Differentiable once, forwards and backwards, with respect to the depth, the spacing and the source: as the
        shortest ways' lengths change (along one of them, where there are several). That is the derivative of the
        minimum, which the sweeps reach to O(h²): differences of the values agree with it to about 1e-3. Zero where the
        value is not finite.

    Raises:
        ValueError: a source that is not finite, or lies outside the picture or the mask. Under `jax.jit` nothing is
            raised: a source with no surface about it leaves all distances infinite.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxlens.surfaces import DepthMap, geodesic_distance
        >>> distance = geodesic_distance(DepthMap(jnp.zeros((5, 7)), spacing=2.0), (0.0, 0.0))
        >>> float(distance[4, 3])
        10.0
    """
    points = nose_tip(depth_map) if source is None else as_points(source)
    check_inside(depth_map, points, "source")
    return _distance(depth_map, points)


def check_inside(depth_map: DepthMap, points: Float[Array, "*points 2"], name: str) -> None:
    """Refuses concrete points that lie off the surface."""
    if points.ndim > 2 or points.size == 0:
        raise ValueError(f"{name} must be one point (x, y) or (K, 2) of them, got shape {points.shape}")
    if not is_concrete(depth_map, points):
        return
    height, width = depth_map.shape
    mask = np.asarray(depth_map.mask)
    for x, y in np.asarray(points, np.float64).reshape(-1, 2):
        if not (np.isfinite(x) and np.isfinite(y)):
            raise ValueError(f"{name} must be finite, got ({x:g}, {y:g})")
        if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
            raise ValueError(f"{name} ({x:g}, {y:g}) lies outside the picture of {width}×{height} pixels")
        column, row = (min(max(round(v), 0), size - 1) for v, size in ((x, width), (y, height)))
        if not mask[row, column]:
            raise ValueError(f"{name} ({x:g}, {y:g}) lies outside the mask: there is no surface at pixel {column, row}")


@jax.jit
def _distance(depth_map: DepthMap, sources: Float[Array, "*sources 2"]) -> Float[Array, "height width"]:
    depth, mask, spacing = depth_map.depth, depth_map.mask, depth_map.spacing
    sources = sources.astype(depth.dtype)

    def one(source):
        fixed = lax.stop_gradient(source)
        columns = jnp.arange(depth.shape[1], dtype=depth.dtype)[None, :] - fixed[0]
        rows = jnp.arange(depth.shape[0], dtype=depth.dtype)[:, None] - fixed[1]
        free = mask & (_squares(columns, rows) >= _RADIUS**2)
        place = jnp.stack([source[0] * spacing[0], source[1] * spacing[1], depth_at(depth_map, source)])
        u = _excess(depth, spacing, place, mask, free)
        chord = length(Field(depth, mask, spacing, place, free).offsets())
        return jnp.where(u < FAR / 2, chord + u, FAR)

    distances = one(sources) if sources.ndim == 1 else jnp.min(lax.map(one, sources), axis=0)
    distances = jnp.where(distances < FAR / 2, distances, jnp.inf)
    return jnp.where(mask, distances, jnp.nan)


def _squares(columns: Array, rows: Array) -> Array:
    shape = (rows.shape[0], columns.shape[1])
    return jnp.broadcast_to(columns * columns, shape) + jnp.broadcast_to(rows * rows, shape)


@jax.custom_jvp
def _excess(
    depth: Float[Array, "height width"],
    spacing: Float[Array, "2"],
    place: Float[Array, "3"],
    mask: Bool[Array, "height width"],
    free: Bool[Array, "height width"],
) -> Float[Array, "height width"]:
    field = Field(depth, mask, spacing, place, free)
    return smallest_excess(field, _TOLERANCE[depth.dtype.itemsize] * jnp.min(spacing))


@_excess.defjvp
def _excess_jvp(primals, tangents):
    depth, spacing, place, mask, free = primals
    u = _excess(*primals)
    # Each value is a minimum over ways, so to first order the ways stay as they are: du = P du + dc.
    policy = improved(u, Field(depth, mask, spacing, place, free))
    direction, share = policy.directions()

    def cost(depth, spacing, place):
        return costs(policy, Field(depth, mask, spacing, place, free))

    change = jax.jvp(cost, (depth, spacing, place), tangents[:3])[1]
    tolerance = 8 * epsilon(u.dtype)
    tangent = lax.custom_linear_solve(
        lambda x: x - weighted_sum(x, direction, share),
        change,
        lambda _, right: solve(right, direction, share, tolerance),
        lambda _, right: solve_transposed(right, direction, share, tolerance),
    )
    return u, tangent
