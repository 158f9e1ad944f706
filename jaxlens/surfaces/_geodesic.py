"""The geodesic distance of a surface that is given by its depth."""

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from jaxlens.numerics import as_points, epsilon, is_concrete
from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._differences import cubic_at, padded_depth
from jaxlens.surfaces._nose_tip import nose_tip
from jaxlens.surfaces._policies import FAR, Field, costs, improved, length, smallest_excess
from jaxlens.surfaces._sweeps import solve, solve_transposed, weighted_sum

Progress = Callable[[int, int], None] | None

# Sources up to which each is solved for alone, exactly.
_FEW = 8
# Pixels this near to the source are as far as a straight line.
_RADIUS = 1.5
# What a sweep need not gain, in pixels, by the bytes of a number: far below the error of the discretization.
_TOLERANCE = {4: 1e-4, 8: 1e-10}


def geodesic_distance(
    depth_map: DepthMap,
    *,
    source: Float[ArrayLike, "*sources 2"] | Sequence | None = None,
    progress: Progress = None,
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
        source: (x, y) in pixels, also between pixels, or `(K, 2)` of them: the distance is that to the nearest.
            Up to eight are solved for one by one; more at once, in the time of a few. There a pixel may miss a
            source whose region is narrower than a pixel, or take the second nearest where two regions meet, and be
            off by a part of a pixel (up to a quarter was seen, about walls). The nose tip (`nose_tip`), unless given.
        progress: Told after each round of sweeps how many pixels it has left as they were, and how many there are;
            the last round leaves all. Of a few sources each has rounds of its own. Called from another thread.

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
        >>> distance = geodesic_distance(DepthMap(jnp.zeros((5, 7)), spacing=2.0), source=(0.0, 0.0))
        >>> float(distance[4, 3])
        10.0
    """
    points = nose_tip(depth_map) if source is None else as_points(source)
    check_inside(depth_map, points, "source")
    return _distance(depth_map, points, progress)


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


@partial(jax.jit, static_argnames="progress")
def _distance(
    depth_map: DepthMap, points: Float[Array, "*sources 2"], progress: Progress
) -> Float[Array, "height width"]:
    points = points.reshape(-1, 2)
    if len(points) > _FEW:
        return _joint_distance(depth_map, points, progress)
    return jnp.min(lax.map(lambda point: _joint_distance(depth_map, point[None], progress), points), axis=0)


def _joint_distance(
    depth_map: DepthMap, points: Float[Array, "sources 2"], progress: Progress
) -> Float[Array, "height width"]:
    depth, mask, spacing = depth_map.depth, depth_map.mask, depth_map.spacing
    points = points.astype(depth.dtype)
    padded = padded_depth(depth_map)
    heights = jax.vmap(lambda point: cubic_at(padded, point))(points)
    sources = jnp.concatenate([points * spacing[None], heights[:, None]], axis=1)
    field = _solved(*jax.tree.map(lax.stop_gradient, (depth_map, points, sources)), progress=progress)
    u = _excess(depth, spacing, sources, *field)
    label = field[1].label
    chord = length(Field(depth, mask, spacing, sources, label, mask).offsets())
    distances = jnp.where(u < FAR / 2, chord + u, jnp.inf)
    return jnp.where(mask, distances, jnp.nan)


def _solved(depth_map: DepthMap, points: Array, sources: Array, *, progress: Progress) -> tuple[Array, Field]:
    """Returns u, and the field with the pixels' sources and those that are still beside theirs."""
    depth, mask, spacing = depth_map.depth, depth_map.mask, depth_map.spacing
    label, beside = _beside(depth, spacing, points, sources)
    field = Field(depth, mask, spacing, sources, label, mask & ~beside)
    u, nearest = smallest_excess(field, _TOLERANCE[depth.dtype.itemsize] * jnp.min(spacing), progress)
    free = mask & ~(beside & (u == 0) & (nearest == label))
    return u, Field(depth, mask, spacing, sources, nearest, free)


def _beside(depth: Array, spacing: Array, points: Array, sources: Array) -> tuple[Array, Array]:
    """Returns which source is nearest to the pixels within `_RADIUS` of one, and where these are."""
    height, width = depth.shape
    first = jnp.floor(points).astype(jnp.int32)
    around = jnp.arange(-1, 3)
    columns, rows = first[:, 0, None, None] + around[None, None, :], first[:, 1, None, None] + around[None, :, None]
    columns, rows = jnp.broadcast_arrays(columns, rows)
    x, y = (at.astype(depth.dtype) - point[:, None, None] for at, point in zip((columns, rows), points.T, strict=True))
    near = (x * x + y * y < _RADIUS**2) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    pixel = jnp.where(near, rows * width + columns, height * width)
    z = depth.ravel().at[pixel].get(mode="fill", fill_value=0) - sources[:, 2, None, None]
    chord = length((x * spacing[0], y * spacing[1], z))
    least = jnp.full(height * width, jnp.inf, depth.dtype).at[pixel].min(chord, mode="drop")
    number = jnp.arange(len(points))[:, None, None]
    number = jnp.where(chord <= least.at[pixel].get(mode="fill", fill_value=0), number, len(points) - 1)
    label = jnp.full(height * width, len(points) - 1).at[pixel].min(number, mode="drop")
    return label.reshape(depth.shape), jnp.isfinite(least).reshape(depth.shape)


@jax.custom_jvp
def _excess(
    depth: Float[Array, "height width"],
    spacing: Float[Array, "2"],
    sources: Float[Array, "sources 3"],
    u: Float[Array, "height width"],
    field: Field,
) -> Float[Array, "height width"]:
    """Returns u, with its derivatives by the first three, which `field` holds too."""
    return u


@_excess.defjvp
def _excess_jvp(primals, tangents):
    depth, spacing, sources, u, field = primals
    # Each value is a minimum over ways, so to first order the ways stay as they are: du = P du + dc.
    policy = improved(u, field)
    direction, share = policy.directions()

    def cost(depth, spacing, sources):
        return costs(policy, Field(depth, field.mask, spacing, sources, field.label, field.free))

    change = jax.jvp(cost, (depth, spacing, sources), tangents[:3])[1]
    tolerance = 8 * epsilon(u.dtype)
    tangent = lax.custom_linear_solve(
        lambda x: x - weighted_sum(x, direction, share),
        change,
        lambda _, right: solve(right, direction, share, tolerance),
        lambda _, right: solve_transposed(right, direction, share, tolerance),
    )
    return u, tangent
