"""Eqs. 1 and 2: the radial geodesic distance from the tip of the nose, beside the shortest one and the planar one."""

import itertools
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator
from rich.console import Console, RenderableType
from rich.text import Text

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.geodesic_distances import (
    Convergence,
    Distances,
    Way,
    cap_convergence,
    surface_distances,
    ways_to,
)
from jaxlens.experiments.outcome import Outcome, progress_bar
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import Surface
from jaxlens.experiments.tables import write_csv
from jaxlens.figures.geodesics import convergence_chart, distance_maps, path_panel, ratio_maps
from jaxlens.figures.style import save


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
    def _check(self) -> "GeodesicsExperiment":
        if any(b <= a for a, b in itertools.pairwise(self.sizes)):
            raise ValueError(f"'sizes' must grow, got {self.sizes}")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_geodesics(configuration, self, folder, progress)


def perform_geodesics(
    configuration: Configuration, experiment: GeodesicsExperiment, folder: Path, progress: Console
) -> Outcome:
    """Carries out the experiment: `table.csv` has the drawn paths, `errors.csv` the errors on a sphere's cap."""
    with progress_bar(progress, experiment.name, 2) as advance:
        found = surface_distances(experiment.surface, configuration.path.parent)
        ways = ways_to(found, experiment.paths, experiment.reach)
        advance(1)
        cap = cap_convergence(experiment.sizes, experiment.slope, experiment.dtype)
        advance(1)
    write_csv(folder, _columns(ways))
    write_csv(folder, _convergence_columns(experiment.sizes, cap), "errors.csv")
    unit = experiment.surface.unit
    save(distance_maps(found, experiment.step, unit), folder, "maps")
    save(ratio_maps(found), folder, "ratios")
    save(path_panel(found, ways, unit), folder, "paths")
    save(convergence_chart(experiment.sizes, cap), folder, "convergence", vector=True)
    return Outcome([], _facts(found), _report(experiment, found, ways, cap))


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


def _facts(found: Distances) -> dict[str, object]:
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
    experiment: GeodesicsExperiment, found: Distances, ways: list[Way], cap: list[Convergence]
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
        plain_table(
            experiment.title or experiment.name,
            [f"way, in {unit}", "planar", "radial", "geodesic", "radial longer"],
            rows,
        ),
        Text(
            f"Nose tip at pixel ({x:.2f}, {y:.2f}). Over all pixels the radial distance is "
            f"{100 * (float(str(facts['radial_over_geodesic_mean'])) - 1):.2f} % longer than the shortest one in the "
            f"mean, {100 * (float(str(facts['radial_over_geodesic_largest'])) - 1):.1f} % at most.\n"
        ),
        plain_table(
            "A sphere's cap: errors in radii", ["distance, size", "mean", "largest", "order of the mean"], errors
        ),
    ]
