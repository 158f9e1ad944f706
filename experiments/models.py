"""What each lens does to a grid of straight lines, and how far it sees."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, model_validator
from rich.console import Console

import jaxlens as jl
from jaxlens import figures
from jaxlens.calibrations import Calibration, CalibrationError
from jaxlens.experiments import Configuration, Experiment, Outcome, Table, plain_table, progress_bar, write_csv

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 5
_TITLE, _GAP, _MARGIN = 0.34, 0.12, 0.05
# On the plane z = 1: where the grid's lines are, and those of a lens that sees past it; and points on each line.
_LINES = np.linspace(-1, 1, 9)
_FAR_LINES = np.array([-8, -4, -2.5, -1.6, 1.6, 2.5, 4, 8])
_POINTS = 401
# What lies farther out in a panel is cut off.
_WIDEST = 2.2


class Model(Table):
    """A lens by its name in files, and its parameters.

    Attributes:
        model: The name.
        parameters: What makes it.
    """

    model: str
    parameters: dict[str, float | list[float]] = Field(default={})

    def lens(self) -> jl.Lens:
        """Returns the lens."""
        pairs = {key: tuple(value) if isinstance(value, list) else value for key, value in self.parameters.items()}
        return Calibration(self.model, tuple(sorted(pairs.items()))).lens()


class ModelsExperiment(Experiment):
    """Grids through lenses.

    Attributes:
        lenses: The lenses, in the order of the figure.
        angles: At which the table gives the observed radius, in degrees.
    """

    lenses: list[Model] = Field(min_length=1, max_length=40)
    angles: list[float] = Field(min_length=1, max_length=12)

    @model_validator(mode="after")
    def _check(self) -> ModelsExperiment:
        for one in self.lenses:
            try:
                one.lens()
            except CalibrationError as error:
                raise ValueError(f"'lenses': {error}") from error
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: a row of `table.csv` is a lens."""
        radians = np.radians(self.angles)
        # Rounded, so that 90° is not a hair before it.
        rays = np.round(np.stack([np.sin(radians), np.zeros_like(radians), np.cos(radians)], -1), 15)
        fields, radii, grids = [], [], []
        with progress_bar(progress, self.name, len(self.lenses)) as advance:
            for one in self.lenses:
                lens = one.lens()
                fields.append(float(np.degrees(lens.field_of_view())))
                radii.append(np.asarray(lens.project(rays))[:, 0])
                grids.append([np.asarray(lens.project(line)) for line in _grid(isinstance(lens, jl.lenses.WideLens))])
                advance(1)
        columns: dict[str, list] = {
            "model": [one.model for one in self.lenses],
            "field_of_view": fields,
            **{f"x_at_{angle:g}": [row[i] for row in radii] for i, angle in enumerate(self.angles)},
        }
        write_csv(folder, columns)
        names = [one.model for one in self.lenses]
        figures.save(grid_panels(names, fields, grids), folder / "grids.svg")
        header = ["lens", "field of view", *(f"{angle:g}°" for angle in self.angles)]
        rows = [
            [name, f"{field:.1f}°", *("" if np.isnan(value) else f"{value:.4f}" for value in row)]
            for name, field, row in zip(names, fields, radii, strict=True)
        ]
        return Outcome([], {}, [plain_table(self.heading, header, rows)])


def _grid(wide: bool) -> Iterator[Float[np.ndarray, "points 3"]]:
    """Returns the lines of a square grid on the plane z = 1 as rays: for a wide lens, longer and more of them."""
    reach = 8.0 if wide else 1.0
    # Near the axis a step as small as far from it, in angle.
    along = np.tan(np.linspace(-np.arctan(reach), np.arctan(reach), _POINTS))
    for place in np.concatenate([_LINES, _FAR_LINES]) if wide else _LINES:
        across = np.full(_POINTS, place)
        yield np.stack([along, across, np.ones(_POINTS)], -1)
        yield np.stack([across, along, np.ones(_POINTS)], -1)


def grid_panels(names: list[str], fields: list[float], grids: list[list[np.ndarray]]) -> Figure:
    """Draws the grid of each lens.

    Args:
        names: Of the lenses.
        fields: Their fields of view, in degrees from the axis.
        grids: For each lens its lines, observed.
    """
    side = (figures.WIDTH - 2 * _MARGIN - (_COLUMNS - 1) * _GAP) / _COLUMNS
    rows = -(-len(names) // _COLUMNS)
    pitch = _TITLE + side + _GAP
    figure = figures.new_figure(figures.WIDTH, rows * pitch + _MARGIN, by_hand=True)
    for index, (name, field, lines) in enumerate(zip(names, fields, grids, strict=True)):
        row, column = divmod(index, _COLUMNS)
        axes = figures.place(figure, _MARGIN + column * (side + _GAP), row * pitch + _TITLE, side, side)
        _draw(axes, lines)
        seen = "all" if field > 179.9 else f"to {field:.0f}°"
        axes.set_title(f"{name}\n{seen}", fontsize="small", linespacing=1.1)
    return figure


def _draw(axes: Axes, lines: list[np.ndarray]) -> None:
    near = 2 * len(_LINES)
    for place, line in enumerate(lines):
        axes.plot(*line.T, color=figures.BLUE if place < near else figures.SKY, linewidth=0.8 if place < near else 0.5)
    reach = 1.05 * min(_WIDEST, max(float(np.nanmax(np.abs(line))) for line in lines))
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal")
    figures.bare(axes)
