"""Figure 2: a free-form deformation of a part of an image, with its border free and with frozen rows."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import ArrayLike
from pydantic import Field, model_validator
from rich.console import Console

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.deforming import Deformed, deform, lattice_of, moved
from jaxlens.experiments.errors import ConfigError
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.outcome import Outcome, progress_bar
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import ControlPointMove, Crop, Image, Warp
from jaxlens.experiments.sources import load_source
from jaxlens.experiments.tables import Value, write_csv
from jaxlens.figures.free_forms import continuity_panel, lattice_panel
from jaxlens.figures.style import save


class FreeFormExperiment(Experiment):
    """A free-form deformation of a part of an image, with a free border and with frozen ones: Figure 2.

    Attributes:
        image: The image.
        region: The pixels whose area is the rectangle that is deformed.
        degrees: m along x and n along y: there are m + 1 columns and n + 1 rows of control points.
        moves: The control points that do not stay in place.
        continuity: Orders of continuity across the rectangle's border, each of which freezes rows of control points;
            the deformation without any frozen is drawn besides.
        warp: How the image is sampled.
    """

    image: Image
    region: Crop
    degrees: Annotated[list[Annotated[int, Field(ge=1, le=32)]], Field(min_length=2, max_length=2)]
    moves: list[ControlPointMove] = Field(min_length=1)
    continuity: list[Annotated[int, Field(ge=0)]] = Field(default=[0, 1], max_length=3)
    warp: Warp = Warp()

    @model_validator(mode="after")
    def _check(self) -> "FreeFormExperiment":
        m, n = self.degrees
        for move in self.moves:
            if move.column > m or move.row > n:
                raise ValueError(
                    f"'moves' must name control points of columns 0 to {m} and rows 0 to {n}, got column "
                    f"{move.column}, row {move.row}"
                )
        places = [(move.column, move.row) for move in self.moves]
        if len(set(places)) < len(places):
            raise ValueError("'moves' must name each control point once")
        if self.continuity and min(m, n) < 2 * max(self.continuity) + 2:
            raise ValueError(
                f"'continuity' of order {max(self.continuity)} leaves no control point free: it takes 'degrees' of at "
                f"least {2 * max(self.continuity) + 2}, got {self.degrees}"
            )
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_free_form(configuration, self, folder, progress)


_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_LATTICE = ("border", "column", "row", "initial_x", "initial_y", "x", "y", "weight", "frozen")


def perform_free_form(
    configuration: Configuration, experiment: FreeFormExperiment, folder: Path, progress: Console
) -> Outcome:
    """Carries out the experiment: a row of `table.csv` is a border, one of `lattice.csv` a control point.

    Raises:
        ConfigError: the region does not fit into the image.
    """
    source = load_source(configuration, experiment.image)
    region, (height, width) = experiment.region, source.pixels.shape[:2]
    bottom, right = region.top + region.height, region.left + region.width
    if bottom > height or right > width:
        raise ConfigError(
            f"{configuration.path}: region: got rows {region.top} to {bottom} and columns {region.left} to {right}; "
            f"must lie within the image's {height} rows and {width} columns"
        )
    still = lattice_of(region, experiment.degrees, experiment.dtype)
    free = moved(still, experiment.moves)
    found: dict[str, Deformed] = {}
    lattice: dict[str, list[Value]] = {name: [] for name in _LATTICE}
    with progress_bar(progress, experiment.name, 1 + len(experiment.continuity)) as advance:
        for order in (None, *experiment.continuity):
            mapping = free if order is None else free.freeze(order)
            name = _name(order)
            found[name] = deform(source.pixels, mapping, experiment.warp)
            frozen = np.zeros(mapping.control_points.shape[:2], bool) if order is None else free.frozen(order)
            for row in _control_points(name, still.control_points, found[name], frozen):
                for column, value in zip(_LATTICE, row, strict=True):
                    lattice[column].append(value)
            advance(1)
    names = list(next(iter(found.values())).measures)
    columns = {name: [one.measures[name] for one in found.values()] for name in names}
    write_csv(folder, {"border": list(found)} | columns)
    write_csv(folder, lattice, "lattice.csv")
    save(lattice_panel(source.pixels, source.peak, still, found[_name(None)]), folder, "lattice")
    save(continuity_panel(source.peak, still, found), folder, "continuity")
    header = ["", *found]
    rows = [
        [name.removesuffix("_px").replace("_", " ") + (", px" if name.endswith("_px") else "")]
        + [f"{one.measures[name]:.4g}" for one in found.values()]
        for name in names
    ]
    return Outcome([source.facts], {}, [plain_table(experiment.title or experiment.name, header, rows)])


def _name(order: int | None) -> str:
    if order is None:
        return "border free"
    return f"{order + 1} row{'s' if order else ''} frozen (C{str(order).translate(_SUPERSCRIPTS)})"


def _control_points(
    name: str, initial: ArrayLike, deformed: Deformed, frozen: np.ndarray
) -> Iterator[tuple[Value, ...]]:
    """The rows of `lattice.csv` for one border."""
    before, after = np.asarray(initial), np.asarray(deformed.mapping.control_points)
    weights = deformed.mapping.weights
    weights = np.ones(after.shape[:2]) if weights is None else np.asarray(weights)
    for i, j in np.ndindex(*after.shape[:2]):
        state = "yes" if frozen[i, j] else "no"
        (x, y), (new_x, new_y) = before[i, j], after[i, j]
        yield name, i, j, float(x), float(y), float(new_x), float(new_y), float(weights[i, j]), state
