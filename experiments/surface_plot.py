"""Figures 1 and 8: gray values as heights, and what smoothing leaves of them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field
from rich.console import Console

from jaxlens import figures
from jaxlens.experiments import Configuration, Experiment, Image, Outcome, Value, load_source, plain_table, write_rows

_HEADER = ("heights", "least", "greatest", "mean", "standard_deviation", "steepest_per_px")


class SurfacePlotExperiment(Experiment):
    """An image's gray values as heights, seen in perspective: Figures 1 and 8.

    Attributes:
        image: The image.
        drawings: The ways of drawing, a panel each: a net, a closed surface in the image's grays, lines of equal
            height.
        smoothing: Standard deviation, in pixels, of the Gaussian that the heights are smoothed with.
        perspective: One over the viewer's distance from the image's centre, in half diagonals; 0 is parallel
            projection.
        relief: Height of white, in half diagonals.
        azimuth: By how many degrees the landscape is turned, counterclockwise from above.
        elevation: Of the viewer, in degrees: 90 looks straight down.
    """

    image: Image
    drawings: list[Literal["mesh", "filled", "isolines"]] = Field(
        default=["mesh", "filled", "isolines"], min_length=1, max_length=3
    )
    smoothing: float = Field(default=11.5, ge=0, le=1000)
    perspective: float = Field(default=0.22, ge=0, lt=0.7)
    relief: float = Field(default=0.5, ge=0, le=10)
    azimuth: float = 25.0
    elevation: float = Field(default=50.0, gt=0, le=90)

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: `table.csv` has the gray values before and after smoothing."""
        source = load_source(configuration, self.image)
        figure = figures.surface_figure(
            source.pixels,
            source.peak,
            drawings=self.drawings,
            smoothing=self.smoothing,
            perspective=self.perspective,
            relief=self.relief,
            azimuth=self.azimuth,
            elevation=self.elevation,
        )
        figures.save(figure, folder / "surface.jpg")
        gray = np.asarray(source.gray, np.float64)
        table: list[tuple[Value, ...]] = []
        for name, heights in (("gray values", gray), ("smoothed", figures.smoothed(gray, self.smoothing))):
            steps = [np.abs(np.diff(heights, axis=axis)).max(initial=0.0) for axis in (0, 1)]
            table.append((name, heights.min(), heights.max(), heights.mean(), heights.std(), max(steps)))
        write_rows(folder, _HEADER, table)
        rows = [[str(row[0]), *(f"{float(value):.2f}" for value in row[1:])] for row in table]
        header = ["gray levels", "least", "greatest", "mean", "standard\ndeviation", "steepest step\nto a neighbour"]
        return Outcome([source.facts], {}, [plain_table(self.heading, header, rows)])
