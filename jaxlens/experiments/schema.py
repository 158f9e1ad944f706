"""What an experiment's TOML file may say: one model a kind of experiment, and the tables that they share.

Only pydantic is imported here, so that a mistake in a file is reported before anything heavy is loaded.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

MOST_LENSES = 1_000_000


def _plain_name(name: str) -> str:
    """A name becomes a folder: letters, digits, dots, dashes and underscores only, and no dot in front."""
    if not name or name.startswith(".") or not all(letter.isalnum() or letter in "-_." for letter in name):
        raise ValueError("must be letters, digits, '-', '_' and '.', and not begin with a '.'")
    return name


Name = Annotated[str, AfterValidator(_plain_name)]
Kappa = Annotated[list[float], Field(min_length=1)]


class _Table(BaseModel):
    """A table of the file: strict types, finite numbers, no unknown keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class Crop(_Table):
    """A rectangle of an image, in pixels."""

    top: int = Field(ge=0)
    left: int = Field(ge=0)
    height: int = Field(ge=1)
    width: int = Field(ge=1)


class Image(_Table):
    """An image: a photograph that every installation has, a pattern made by a formula, or a file.

    Attributes:
        name: What figures and tables call it.
        source: `portrait` is matplotlib's sample portrait (grace_hopper.jpg, 600×512 RGB, public domain); the others
            are patterns of `height` × `width` pixels.
        path: A picture file, relative to the configuration.
        height: Of a pattern.
        width: Of a pattern.
        crop: The part that is used; all of it by default.
        gray: Turn colour to gray (Rec. 601 luma).
        peak: Scale so that this is the largest value; it is then also L of the PSNR. Without it, values stay as they
            are, and L is the range of the file's dtype (255 for 8 bits).
    """

    name: str | None = None
    source: Literal["portrait", "head", "checkerboard", "clouds"] | None = None
    path: str | None = None
    height: int | None = Field(default=None, ge=1, le=8192)
    width: int | None = Field(default=None, ge=1, le=8192)
    crop: Crop | None = None
    gray: bool = True
    peak: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _check(self) -> "Image":
        if (self.source is None) == (self.path is None):
            raise ValueError("must have either 'source' or 'path', and not both")
        pattern = self.source not in (None, "portrait")
        if pattern and (self.height is None or self.width is None):
            raise ValueError(f"source = '{self.source}' is a pattern: it needs 'height' and 'width'")
        if not pattern and (self.height is not None or self.width is not None):
            raise ValueError("'height' and 'width' are for patterns; use 'crop' for a part of a picture")
        return self

    @property
    def label(self) -> str:
        """The name, or what stands for it."""
        return self.name or self.source or str(self.path).replace("\\", "/").rpartition("/")[-1]


class Axis(_Table):
    """Equally spaced values of one coefficient, both ends included."""

    start: float
    stop: float
    count: int = Field(ge=1)

    def values(self) -> list[float]:
        """Returns the values; the ends are exact."""
        if self.count == 1:
            return [self.start]
        steps = self.count - 1
        return [(self.start * (steps - i) + self.stop * i) / steps for i in range(self.count)]


class Lenses(_Table):
    """The polynomial lenses (Eq. 9) of a sweep: a list of coefficient vectors, or axes whose full grid is taken.

    Attributes:
        kappa: κ1, κ2, … of each lens, all of the same order.
        axes: One axis a coefficient; the last one varies fastest.
    """

    kappa: list[Kappa] | None = Field(default=None, min_length=1)
    axes: list[Axis] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _check(self) -> "Lenses":
        if (self.kappa is None) == (self.axes is None):
            raise ValueError("must have either 'kappa' (a list of [κ1, κ2, …]) or 'axes', and not both")
        if self.kappa is not None and len({len(one) for one in self.kappa}) > 1:
            orders = sorted({len(one) for one in self.kappa})
            raise ValueError(f"'kappa' must hold vectors of one length, got lengths {orders}")
        if self.axes is not None and (size := math.prod(axis.count for axis in self.axes)) > MOST_LENSES:
            raise ValueError(f"'axes' must make at most {MOST_LENSES} lenses, got {size}")
        return self

    def coefficients(self) -> Sequence[Sequence[float]]:
        """Returns one vector a lens."""
        if self.kappa is not None:
            return self.kappa
        return list(itertools.product(*(axis.values() for axis in self.axes or ())))


class Warp(_Table):
    """How images are sampled; see `jaxlens.remap`."""

    method: Literal["nearest", "bilinear", "bicubic", "bicubic_opencv"] = "bilinear"
    border: Literal["constant", "edge", "reflect", "wrap"] = "constant"
    fill: float = 0.0
    antialias: bool = False


class _Experiment(_Table):
    """What every experiment says.

    Attributes:
        name: Of the results' folder.
        title: Of the report and the figures.
        dtype: In which everything is computed.
        seed: Of random patterns.
    """

    name: Name
    title: str | None = None
    dtype: Literal["float32", "float64"] = "float64"
    seed: int = Field(default=0, ge=0, lt=2**32)


class SweepExperiment(_Experiment):
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


class ReadingsExperiment(_Experiment):
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


class GridsExperiment(_Experiment):
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


class PanelsExperiment(_Experiment):
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


Noise = Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]


class InversionExperiment(_Experiment):
    """Lenses recovered from what they did: from points, and from pairs of pictures, under noise.

    Attributes:
        image: The undistorted image.
        kappa: The lenses, all of the same order.
        picture_noise: Standard deviations of the noise of gray values, as shares of the peak.
        picture_seeds: Distorted pictures of each lens and noise level.
        gain: Of the distorted picture's gray values, unknown to the fit.
        offset: Likewise, as a share of the peak.
        point_noise: Standard deviations of the noise of a coordinate, in pixels.
        point_seeds: Sets of points of each lens and noise level.
        points: In a set, spread evenly over the distorted picture.
    """

    kind: Literal["inversion"]
    image: Image
    kappa: list[Kappa] = Field(min_length=1, max_length=7)
    picture_noise: Noise
    picture_seeds: int = Field(default=5, ge=2, le=1000)
    gain: float = Field(default=0.9, gt=0)
    offset: float = 0.05
    point_noise: Noise
    point_seeds: int = Field(default=200, ge=2, le=10000)
    points: int = Field(default=200, ge=4, le=100_000)

    @model_validator(mode="after")
    def _check(self) -> "InversionExperiment":
        if len({len(one) for one in self.kappa}) > 1:
            raise ValueError("'kappa' must hold vectors of one length")
        return self


class BoardModel(_Table):
    """A lens to calibrate with.

    Attributes:
        name: What the table calls it.
        terms: Coefficients of the Brown–Conrady lens: 4, 5 or 8.
        fixed: Parameters that stay zero.
        reference_rms: The RMS that other software reports on the same corners, if known.
    """

    name: str
    terms: Literal[4, 5, 8]
    fixed: list[str] = []
    reference_rms: float | None = None


class BoardsExperiment(_Experiment):
    """A camera calibrated from corners of a board, with several lenses, and tried on views held out.

    Attributes:
        corners: A CSV file of corners, relative to the configuration (see `jaxlens calibrate --corners`).
        image_size: Width and height of the pictures.
        models: The lenses.
        held_out: Every so manieth view is held out, in turn, to be judged by the others.
    """

    kind: Literal["boards"]
    corners: str
    image_size: Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=2, max_length=2)]
    models: list[BoardModel] = Field(min_length=1, max_length=7)
    held_out: int = Field(default=4, ge=2)


Experiment = (
    SweepExperiment | ReadingsExperiment | GridsExperiment | PanelsExperiment | InversionExperiment | BoardsExperiment
)
KINDS: dict[str, type[Experiment]] = {
    "sweep": SweepExperiment,
    "readings": ReadingsExperiment,
    "grids": GridsExperiment,
    "panels": PanelsExperiment,
    "inversion": InversionExperiment,
    "boards": BoardsExperiment,
}
