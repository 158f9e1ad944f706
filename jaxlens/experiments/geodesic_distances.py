"""Three distances from the tip of a nose, and how fast two of them converge where the truth is known: on a sphere."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxlens import meshes
from jaxlens.experiments.errors import ExperimentError
from jaxlens.experiments.schema import Surface
from jaxlens.surfaces import (
    DepthMap,
    face,
    face_albedo,
    from_mesh,
    geodesic_distance,
    geodesic_path,
    normals_from_mesh,
    nose_tip,
    radial_geodesic_distance,
    shade,
)

# Where the second source on the cap stands, as shares of its radius to the right and downwards.
_OFF_APEX = (0.4, -0.3)
# What the picture of the cap shows beyond its rim.
_CAP_MARGIN = 1.05


@dataclass(frozen=True, eq=False)
class Distances:
    """How far all points of a surface are from one of them.

    Attributes:
        depth_map: The surface.
        picture: `(H, W)`, shaded, 0 to 1; NaN where there is no surface.
        features: The same, lit from the front.
        source: (x, y) in pixels; the tip of the nose, of a face.
        planar: `(H, W)`, straight in the picture's plane. NaN where there is no surface, as the others.
        radial: `(H, W)`, of the curve above that straight line (Eqs. 1 and 2); infinite where it leaves the surface.
        geodesic: `(H, W)`, of the shortest curve on the surface.
    """

    depth_map: DepthMap
    picture: Float[np.ndarray, "height width"]
    features: Float[np.ndarray, "height width"]
    source: Float[np.ndarray, "2"]
    planar: Float[np.ndarray, "height width"]
    radial: Float[np.ndarray, "height width"]
    geodesic: Float[np.ndarray, "height width"]

    @property
    def known(self) -> Bool[np.ndarray, "height width"]:
        """Where all three are finite and not zero."""
        return np.isfinite(self.radial) & np.isfinite(self.geodesic) & (self.planar > 0)


@dataclass(frozen=True, eq=False)
class Way:
    """A shortest path to the tip of the nose.

    Attributes:
        start: (x, y) in pixels.
        points: `(N, 2)` (x, y) in pixels, from the start to the nose.
        planar: Distance of the start in the picture's plane, in world units.
        radial: Likewise along the curve above the straight line.
        geodesic: Likewise along the shortest way.
    """

    start: Float[np.ndarray, "2"]
    points: Float[np.ndarray, "points 2"]
    planar: float
    radial: float
    geodesic: float


@dataclass(frozen=True)
class Convergence:
    """Errors on the cap of a sphere of radius one, one entry a size.

    Attributes:
        name: What was measured.
        largest: The largest error, in radii.
        mean: The mean of its absolute value.
        orders: By which power of the spacing the mean fell since the size before; NaN for the first.
    """

    name: str
    largest: tuple[float, ...]
    mean: tuple[float, ...]
    orders: tuple[float, ...]


def surface_distances(surface: Surface, folder: Path) -> Distances:
    """Makes or reads a surface, finds its nose, and measures.

    Args:
        surface: As the configuration says.
        folder: From which the path of a mesh is taken.

    Raises:
        ExperimentError: the mesh cannot be read, or its library is not installed.
    """
    height, width = surface.height, surface.width
    if surface.path is None:
        depth_map, albedo, lit_by = face(height, width), face_albedo(height, width), None
    else:
        try:
            mesh = meshes.read(folder / surface.path)
            depth_map, albedo = from_mesh(mesh, height, width), None
            lit_by = normals_from_mesh(mesh, height, width)
        except (ValueError, OSError, ImportError) as error:
            raise ExperimentError(f"{surface.path}: {error}") from error
    return measure_distances(depth_map, albedo=albedo, normals=lit_by)


def measure_distances(
    depth_map: DepthMap,
    *,
    source: Float[np.ndarray, "2"] | None = None,
    albedo: Float[Array, "height width"] | None = None,
    normals: Float[Array, "height width 3"] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Distances:
    """Measures a surface.

    Args:
        depth_map: The surface.
        source: (x, y) in pixels; what `nose_tip` finds, unless given.
        albedo: `(H, W)`, for the shaded picture.
        normals: `(H, W, 3)`, for it too; the depth map's own, unless given.
        progress: Of the shortest distances; as `jaxlens.surfaces.geodesic_distance`.

    Raises:
        ValueError: as `jaxlens.surfaces.geodesic_distance`.
    """
    height, width = depth_map.shape
    mask = np.asarray(depth_map.mask)
    picture, features = (
        np.where(mask, np.asarray(shade(depth_map, albedo=albedo, normals=normals, **light)), np.nan)
        for light in ({}, {"light": (0.0, 0.0, 1.0)})
    )
    place = nose_tip(depth_map) if source is None else jnp.asarray(source, depth_map.depth.dtype)
    radial = radial_geodesic_distance(depth_map, place)
    geodesic = geodesic_distance(depth_map, source=place, progress=progress)
    offsets = (depth_map.points()[..., :2] - (place * depth_map.spacing)[None, None]).reshape(height, width, 2)
    planar = np.where(mask, np.hypot(*np.moveaxis(np.asarray(offsets), -1, 0)), np.nan)
    return Distances(depth_map, picture, features, np.asarray(place), planar, np.asarray(radial), np.asarray(geodesic))


def ways_to(found: Distances, count: int, reach: float) -> list[Way]:
    """Returns shortest paths from points about the nose, evenly spaced by angle, the first to the right.

    Args:
        found: The distances.
        count: Of points.
        reach: How far out they lie, as a share of the way to the border of what was measured.
    """
    starts = np.array([_last_on_ray(found, 2 * np.pi * i / count, reach) for i in range(count)])
    descend = jax.vmap(lambda start: geodesic_path(found.depth_map, jnp.asarray(found.geodesic), start))
    paths = descend(jnp.asarray(starts, found.geodesic.dtype))
    ways = []
    for start, points, number in zip(starts, np.asarray(paths.points), np.asarray(paths.count), strict=True):
        column, row = start.astype(int)
        lengths = (float(one[row, column]) for one in (found.planar, found.radial, found.geodesic))
        ways.append(Way(start, points[:number], *lengths))
    return ways


def _last_on_ray(found: Distances, angle: float, reach: float) -> Float[np.ndarray, "2"]:
    """The pixel nearest to a share of the way to where a ray first leaves what was measured."""
    height, width = found.planar.shape
    steps = np.arange(0.0, np.hypot(height, width), 0.5)
    places = found.source + steps[:, None] * np.array([np.cos(angle), np.sin(angle)])
    pixels = np.round(places).astype(int)
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    columns, rows = np.clip(pixels, 0, [width - 1, height - 1]).T
    good = inside & (found.known[rows, columns] | (steps < 1.5))
    end = steps[-1] if good.all() else steps[np.argmin(good)]
    near = int(reach * end / 0.5)
    return pixels[near].astype(float)


def cap_convergence(sizes: Sequence[int], slope: float, dtype: str) -> list[Convergence]:
    """Measures distances on the cap of a sphere of radius one, against arcs of great circles.

    From the apex a point at the planar distance ρ is asin(ρ) away, on the radial curve as on the shortest; from
    another source, the shortest way is the angle between the two.

    Args:
        sizes: Sides of the depth maps, in pixels.
        slope: Of the cap at its rim.
        dtype: In which it is computed.
    """
    rows: dict[str, list[tuple[float, float]]] = {}
    for size in sizes:
        rim = slope / np.hypot(1, slope)
        spacing = 2 * _CAP_MARGIN * rim / size
        x, y = np.meshgrid(*[(np.arange(size) - (size - 1) / 2) * spacing] * 2)
        squared = x**2 + y**2
        mask = squared < rim**2
        z = np.sqrt(np.where(mask, 1 - squared, 1))
        cap = DepthMap(jnp.asarray(z, dtype), mask=jnp.asarray(mask), spacing=spacing)
        middle = (size - 1) / 2
        apex = np.array([middle, middle])
        other = np.array(_OFF_APEX) * rim
        cosine = x * other[0] + y * other[1] + z * np.sqrt(1 - np.sum(other**2))
        from_apex = np.arcsin(np.sqrt(np.where(mask, squared, 0)))
        from_other = np.arccos(np.clip(cosine, -1, 1))
        for name, found, truth in (
            ("radial, from the apex", radial_geodesic_distance(cap, jnp.asarray(apex, dtype)), from_apex),
            ("geodesic, from the apex", geodesic_distance(cap, source=jnp.asarray(apex, dtype)), from_apex),
            (
                "geodesic, from elsewhere",
                geodesic_distance(cap, source=jnp.asarray(apex + other / spacing, dtype)),
                from_other,
            ),
        ):
            error = np.abs(np.asarray(found) - truth)[mask]
            rows.setdefault(name, []).append((float(error.max()), float(error.mean())))
    return [
        Convergence(
            name,
            tuple(largest for largest, _ in errors),
            tuple(mean for _, mean in errors),
            tuple(_orders(sizes, [mean for _, mean in errors])),
        )
        for name, errors in rows.items()
    ]


def _orders(sizes: Sequence[int], errors: Sequence[float]) -> list[float]:
    """The slopes between neighbours on logarithmic scales."""
    steps = np.diff(np.log(np.maximum(errors, 1e-300))) / -np.diff(np.log(sizes))
    return [np.nan, *(float(step) for step in steps)]
