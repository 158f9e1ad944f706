"""Figures 1 and 8: gray values as heights, and what smoothing leaves of them."""

from pathlib import Path

import numpy as np

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.kinds.outcome import Outcome
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import SurfacePlotExperiment
from jaxlens.experiments.sources import load_source
from jaxlens.experiments.tables import Value, write_csv
from jaxlens.figures.style import save
from jaxlens.figures.surfaces import smoothed, surface_figure

_HEADER = ("heights", "least", "greatest", "mean", "standard_deviation", "steepest_per_px")


def perform_surface_plot(configuration: Configuration, experiment: SurfacePlotExperiment, folder: Path) -> Outcome:
    """Carries out the experiment: `table.csv` has the gray values before and after smoothing."""
    source = load_source(configuration, experiment.image)
    figure = surface_figure(
        source.pixels,
        source.peak,
        drawings=experiment.drawings,
        smoothing=experiment.smoothing,
        perspective=experiment.perspective,
        relief=experiment.relief,
        azimuth=experiment.azimuth,
        elevation=experiment.elevation,
    )
    save(figure, folder / "surface.jpg")
    gray = np.asarray(source.pixels, np.float64)
    gray = gray.mean(axis=-1) if gray.ndim == 3 else gray
    columns: dict[str, list[Value]] = {name: [] for name in _HEADER}
    for name, heights in (("gray values", gray), ("smoothed", smoothed(gray, experiment.smoothing))):
        steps = [np.abs(np.diff(heights, axis=axis)).max(initial=0.0) for axis in (0, 1)]
        row = (name, heights.min(), heights.max(), heights.mean(), heights.std(), max(steps))
        for column, value in zip(_HEADER, row, strict=True):
            columns[column].append(value)
    write_csv(folder, columns)
    rows = [[str(row[0]), *(f"{float(value):.2f}" for value in row[1:])] for row in zip(*columns.values(), strict=True)]
    header = ["gray levels", "least", "greatest", "mean", "standard\ndeviation", "steepest step\nto a neighbour"]
    return Outcome([source.facts], {}, [plain_table(experiment.title or experiment.name, header, rows)])
