"""The picture behind Table 1: how near a rendered face comes, and what the table can tell of it and what not."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator
from rich.console import Console

from jaxlens.experiments import Configuration, Experiment, Outcome


class UnknownExperiment(Experiment):
    """Table 1's picture, which was never published, sought among pictures of a face: what the table tells of it.

    Attributes:
        size: Of the square grid of pixels on which pictures are compared; they need not be square themselves.
        candidates: Random pictures that are looked at for each way to read Eq. 11 and the table.
        starts: So many of them, the nearest to the table, are fitted.
        noise: How far a figure of the table may be off, as a standard deviation, in decibels.
        profile: Heights of the picture, in head heights, at which the rest is fitted anew.
        fine: Height in pixels of the pictures, with square pixels and whole gray levels, on which fits are measured
            again.
    """

    size: int = Field(default=128, ge=16, le=512)
    candidates: int = Field(default=200, ge=1, le=100_000)
    starts: int = Field(default=4, ge=1, le=1000)
    noise: float = Field(default=0.3, gt=0)
    profile: list[Annotated[float, Field(ge=0.5, le=2.7)]] = Field(default=[0.8, 1.0, 1.25, 1.6], min_length=2)
    fine: int = Field(default=400, ge=16, le=2048)

    @model_validator(mode="after")
    def _check(self) -> UnknownExperiment:
        if self.starts > self.candidates:
            raise ValueError(f"'starts' must not exceed 'candidates' ({self.candidates}), got {self.starts}")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: `table.csv` has the figures of the nearest pictures, `parameters.csv` theirs."""
        from .study import study

        return study(self, folder, progress)
