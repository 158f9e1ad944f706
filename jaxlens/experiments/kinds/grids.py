"""Figures 3 and 4: straight lines under k = ±0.3, in the three ways in which the paper writes a lens."""

from pathlib import Path

import numpy as np
from pydantic import Field
from rich.console import Console

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.linegrids import (
    SETTINGS,
    bend_of_curve,
    bend_of_picture,
    curves,
    picture,
    straight_picture,
)
from jaxlens.experiments.outcome import Outcome
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.tables import Value, write_csv
from jaxlens.figures.linegrids import curve_panel, picture_panel
from jaxlens.figures.style import save


class GridsExperiment(Experiment):
    """Line grids through one-parameter lenses: the paper's Figures 3 and 4.

    Attributes:
        k: The coefficients.
        lines: Of the grid, along each side.
        size: Side of the raster grid, in pixels.
    """

    k: list[float] = Field(default=[-0.3, 0.3], min_length=1, max_length=6)
    lines: int = Field(default=11, ge=2, le=101)
    size: int = Field(default=401, ge=16, le=2048)

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_grids(self, folder)


_HEADER = ("setting", "k", "distortion", "bend_of_curve_px", "bend_of_picture_px")


def perform_grids(experiment: GridsExperiment, folder: Path) -> Outcome:
    """Carries out the experiment."""
    size, lines = experiment.size, experiment.lines
    straight = straight_picture(lines, size)
    drawn, pictures, names = {}, {}, {}
    columns: dict[str, list[Value]] = {name: [] for name in _HEADER}
    rows: list[list[str]] = []
    for setting in SETTINGS:
        for k in experiment.k:
            curve, raster = bend_of_curve(setting, k, size), bend_of_picture(setting, k, size)
            drawn[setting, k] = curves(setting, k, lines)
            pictures[setting, k] = np.asarray(picture(setting, k, straight))
            names[setting, k] = curve.name
            values = (setting, k, curve.name, curve.pixels, raster.pixels)
            for name, value in zip(_HEADER, values, strict=True):
                columns[name].append(value)
            rows.append([setting, f"{k:+g}", curve.name, f"{curve.pixels:+.3f}", f"{raster.pixels:+.3f}"])
    write_csv(folder, columns)
    save(curve_panel(drawn, names, experiment.k, lines), folder, "grids", vector=True)
    save(picture_panel(pictures, names, experiment.k), folder, "rasters")
    title = experiment.title or experiment.name
    header = ["", "k", "distortion", "bend of curve, px", "bend of picture, px"]
    return Outcome([], {}, [plain_table(title, header, rows)])
