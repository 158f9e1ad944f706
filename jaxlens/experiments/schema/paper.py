"""Lenses over pictures: Table 1, the readings of Eq. 11, Figures 3, 4 and 6."""

from typing import Literal

from jaxlens.experiments.schema.tables import Common, Image, Kappa, Lenses, Warp
from pydantic import Field, model_validator


class SweepExperiment(Common):
    """An image through many lenses, with every metric for each.

    Attributes:
        image: The undistorted image.
        lenses: The grid.
        warp: How it is sampled.
        memory_mb: What one step of the sweep may take, estimated, in megabytes. A step is never less than one lens.
        compare: Report beside the paper's Table 1.
    """

    kind: Literal["sweep"]
    image: Image
    lenses: Lenses
    warp: Warp = Warp()
    memory_mb: float = Field(default=256.0, gt=0)
    compare: Literal["table1"] | None = None


class ReadingsExperiment(Common):
    """The three readings of Eq. 11 against Table 1, over several images.

    Attributes:
        images: The images, each with a peak.
        warp: How they are sampled.
        memory_mb: As in a sweep.
    """

    kind: Literal["readings"]
    images: list[Image] = Field(min_length=1)
    warp: Warp = Warp()
    memory_mb: float = Field(default=256.0, gt=0)

    @model_validator(mode="after")
    def _check(self) -> "ReadingsExperiment":
        labels = [image.label for image in self.images]
        if len(set(labels)) < len(labels):
            raise ValueError("'images' must have different names; give each a 'name'")
        return self


class GridsExperiment(Common):
    """Line grids through one-parameter lenses: the paper's Figures 3 and 4.

    Attributes:
        k: The coefficients.
        lines: Of the grid, along each side.
        size: Side of the raster grid, in pixels.
    """

    kind: Literal["grids"]
    k: list[float] = Field(default=[-0.3, 0.3], min_length=1, max_length=6)
    lines: int = Field(default=11, ge=2, le=101)
    size: int = Field(default=401, ge=16, le=2048)


class PanelsExperiment(Common):
    """One image and what lenses make of it, with the count of its pixels that land on several: Figure 6.

    Attributes:
        image: The undistorted image.
        kappa: The lenses.
        warp: How it is sampled.
    """

    kind: Literal["panels"]
    image: Image
    kappa: list[Kappa] = Field(min_length=1, max_length=11)
    warp: Warp = Warp()
