"""Eqs. 1 and 2: the radial geodesic distance from the tip of the nose, beside the shortest one and the planar one."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from rich.console import Console, RenderableType
from rich.text import Text

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import (
    Configuration,
    Experiment,
    ExperimentError,
    InputFile,
    Outcome,
    Table,
    plain_table,
    progress_bar,
    write_csv,
)

# Where the second source on the cap stands, as shares of its radius to the right and downwards.
_OFF_APEX = (0.4, -0.3)
# What the picture of the cap shows beyond its rim.
_CAP_MARGIN = 1.05


class Surface(Table):
    """A surface seen from the front: the face that is made by a formula, or a mesh file.

    Attributes:
        source: `face`, the mean face of `jaxlens.surfaces`.
        path: A mesh file (OBJ, PLY, STL; needs the extra `meshes`), relative to the configuration. Its x runs to the
            right, its y upwards, and it looks towards +z.
        height: Of the depth map, in pixels.
        width: Of the depth map, in pixels.
        unit: What figures and tables call the surface's unit of length.
    """

    source: Literal["face"] | None = None
    path: Annotated[str | None, InputFile("mesh file")] = None
    height: int = Field(ge=16, le=4096)
    width: int = Field(ge=16, le=4096)
    unit: str = "head heights"

    @model_validator(mode="after")
    def _check(self) -> Surface:
        if (self.source is None) == (self.path is None):
            raise ValueError("must have either 'source' or 'path', and not both")
        return self


class GeodesicsExperiment(Experiment):
    """Three distances from the tip of the nose, and two of them on a sphere, where they are known: Eqs. 1 and 2.

    Attributes:
        surface: The face.
        step: From one drawn curve of equal distance to the next, in the surface's unit.
        paths: Points about the nose, evenly spaced by angle, from which shortest paths are drawn.
        reach: How far out these points lie, as a share of the way to the border of the surface.
        sizes: Sides of the depth maps of the sphere's cap, in pixels, each larger than the one before.
        slope: Of the cap at its rim.
    """

    surface: Surface
    step: float = Field(default=0.05, gt=0)
    paths: int = Field(default=12, ge=1, le=24)
    reach: float = Field(default=0.9, gt=0, le=1)
    sizes: list[Annotated[int, Field(ge=16, le=2048)]] = Field(default=[64, 128, 256, 512], min_length=2)
    slope: float = Field(default=2.0, gt=0, le=20)

    @model_validator(mode="after")
    def _check(self) -> GeodesicsExperiment:
        if any(b <= a for a, b in itertools.pairwise(self.sizes)):
            raise ValueError(f"'sizes' must grow, got {self.sizes}")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the self: `table.csv` has the drawn paths, `errors.csv` the errors on a sphere's cap."""
        from . import panels

        with progress_bar(progress, self.name, 2) as advance:
            found = surface_distances(self.surface, configuration.path.parent)
            ways = ways_to(found, self.paths, self.reach)
            advance(1)
            cap = cap_convergence(self.sizes, self.slope, self.dtype)
            advance(1)
        write_csv(folder, _columns(ways))
        write_csv(folder, _convergence_columns(self.sizes, cap), "errors.csv")
        unit = self.surface.unit
        figures.save(figures.distance_maps(found, self.step, unit), folder / "maps.jpg")
        figures.save(panels.ratio_maps(found), folder / "ratios.png")
        figures.save(panels.path_panel(found, ways, unit), folder / "paths.jpg")
        figures.save(panels.convergence_chart(self.sizes, cap), folder / "convergence.svg")
        return Outcome([], _facts(found), _report(self, found, ways, cap))


def _columns(ways: list[Way]) -> dict[str, np.ndarray]:
    columns = {
        "start_x": np.array([way.start[0] for way in ways]),
        "start_y": np.array([way.start[1] for way in ways]),
        "planar": np.array([way.planar for way in ways]),
        "radial": np.array([way.radial for way in ways]),
        "geodesic": np.array([way.geodesic for way in ways]),
    }
    return columns | {"radial_over_geodesic": columns["radial"] / columns["geodesic"]}


def _convergence_columns(sizes: list[int], found: list[Convergence]) -> dict[str, list]:
    return {
        "distance": [one.name for one in found for _ in sizes],
        "size": [size for _ in found for size in sizes],
        "mean_error": [error for one in found for error in one.mean],
        "largest_error": [error for one in found for error in one.largest],
        "order": [order for one in found for order in one.orders],
    }


def _facts(found: figures.Distances) -> dict[str, object]:
    known = found.known
    planar, radial, geodesic = (one[known] for one in (found.planar, found.radial, found.geodesic))
    return {
        "nose_tip": [round(float(value), 4) for value in found.source],
        "pixels": int(np.isfinite(found.picture).sum()),
        "pixels_off_the_ray": int((np.isfinite(found.geodesic) & np.isinf(found.radial)).sum()),
        "geodesic_over_planar_mean": float(np.mean(geodesic / planar)),
        "geodesic_over_planar_largest": float(np.max(geodesic / planar)),
        "radial_over_geodesic_mean": float(np.mean(radial / geodesic)),
        "radial_over_geodesic_largest": float(np.max(radial / geodesic)),
    }


def _report(
    experiment: GeodesicsExperiment, found: figures.Distances, ways: list[Way], cap: list[Convergence]
) -> list[RenderableType]:
    facts = _facts(found)
    unit = experiment.surface.unit
    rows = []
    for number, way in enumerate(ways, 1):
        lengths = [f"{length:.4f}" for length in (way.planar, way.radial, way.geodesic)]
        rows.append([str(number), *lengths, f"{100 * (way.radial / way.geodesic - 1):.2f} %"])
    errors = []
    for one in cap:
        columns = zip(experiment.sizes, one.mean, one.largest, one.orders, strict=True)
        for index, (size, mean, largest, order) in enumerate(columns):
            name = f"{size}²" if index else f"{one.name}, {size}²"
            errors.append([name, f"{mean:.2e}", f"{largest:.2e}", f"{order:.2f}" if index else ""])
    x, y = found.source
    return [
        plain_table(experiment.heading, [f"way, in {unit}", "planar", "radial", "geodesic", "radial longer"], rows),
        Text(
            f"Nose tip at pixel ({x:.2f}, {y:.2f}). Over all pixels the radial distance is "
            f"{100 * (float(str(facts['radial_over_geodesic_mean'])) - 1):.2f} % longer than the shortest one in the "
            f"mean, {100 * (float(str(facts['radial_over_geodesic_largest'])) - 1):.1f} % at most.\n"
        ),
        plain_table(
            "A sphere's cap: errors in radii", ["distance, size", "mean", "largest", "order of the mean"], errors
        ),
    ]


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


def surface_distances(surface: Surface, folder: Path) -> figures.Distances:
    """Makes or reads a surface, finds its nose, and measures.

    Args:
        surface: As the configuration says.
        folder: From which the path of a mesh is taken.

    Raises:
        ExperimentError: the mesh cannot be read, or its library is not installed.
    """
    height, width = surface.height, surface.width
    if surface.path is None:
        depth_map, albedo, lit_by = jl.surfaces.face(height, width), jl.surfaces.face_albedo(height, width), None
    else:
        try:
            mesh = jl.meshes.read(folder / surface.path)
            depth_map, albedo = jl.surfaces.from_mesh(mesh, height, width), None
            lit_by = jl.surfaces.normals_from_mesh(mesh, height, width)
        except (ValueError, OSError, ImportError) as error:
            raise ExperimentError(f"{surface.path}: {error}") from error
    return figures.measure_distances(depth_map, albedo=albedo, normals=lit_by)


def ways_to(found: figures.Distances, count: int, reach: float) -> list[Way]:
    """Returns shortest paths from points about the nose, evenly spaced by angle, the first to the right.

    Args:
        found: The distances.
        count: Of points.
        reach: How far out they lie, as a share of the way to the border of what was measured.
    """
    import jax
    import jax.numpy as jnp

    starts = np.array([_last_on_ray(found, 2 * np.pi * i / count, reach) for i in range(count)])
    descend = jax.vmap(lambda start: jl.surfaces.geodesic_path(found.depth_map, jnp.asarray(found.geodesic), start))
    paths = descend(jnp.asarray(starts, found.geodesic.dtype))
    ways = []
    for start, points, number in zip(starts, np.asarray(paths.points), np.asarray(paths.count), strict=True):
        column, row = start.astype(int)
        lengths = (float(one[row, column]) for one in (found.planar, found.radial, found.geodesic))
        ways.append(Way(start, points[:number], *lengths))
    return ways


def _last_on_ray(found: figures.Distances, angle: float, reach: float) -> Float[np.ndarray, "2"]:
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
    import jax.numpy as jnp

    rows: dict[str, list[tuple[float, float]]] = {}
    for size in sizes:
        rim = slope / np.hypot(1, slope)
        spacing = 2 * _CAP_MARGIN * rim / size
        x, y = np.meshgrid(*[(np.arange(size) - (size - 1) / 2) * spacing] * 2)
        squared = x**2 + y**2
        mask = squared < rim**2
        z = np.sqrt(np.where(mask, 1 - squared, 1))
        cap = jl.surfaces.DepthMap(jnp.asarray(z, dtype), mask=jnp.asarray(mask), spacing=spacing)
        middle = (size - 1) / 2
        apex = np.array([middle, middle])
        other = np.array(_OFF_APEX) * rim
        cosine = x * other[0] + y * other[1] + z * np.sqrt(1 - np.sum(other**2))
        from_apex = np.arcsin(np.sqrt(np.where(mask, squared, 0)))
        from_other = np.arccos(np.clip(cosine, -1, 1))
        for name, found, truth in (
            ("radial, from the apex", jl.surfaces.radial_geodesic_distance(cap, jnp.asarray(apex, dtype)), from_apex),
            ("geodesic, from the apex", jl.surfaces.geodesic_distance(cap, source=jnp.asarray(apex, dtype)), from_apex),
            (
                "geodesic, from elsewhere",
                jl.surfaces.geodesic_distance(cap, source=jnp.asarray(apex + other / spacing, dtype)),
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
