"""What an experiment's TOML file may say: one model a kind of experiment, and the tables that they share.

Only pydantic is imported here, so that a mistake in a file is reported before anything heavy is loaded.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

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
            are made, in `height` × `width` pixels: `face` is the picture of a modelled face in three dimensions, lit
            from the upper left; `head`, `checkerboard` and `clouds` are patterns.
        path: A picture file, relative to the configuration.
        height: Of an image that is made.
        width: Of an image that is made.
        crop: The part that is used; all of it by default.
        gray: Turn colour to gray (Rec. 601 luma).
        peak: Scale so that this is the largest value; it is then also L of the PSNR. Without it, values stay as they
            are, and L is the range of the file's dtype (255 for 8 bits).
    """

    name: str | None = None
    source: Literal["portrait", "face", "head", "checkerboard", "clouds"] | None = None
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
        made = self.source not in (None, "portrait")
        if made and (self.height is None or self.width is None):
            raise ValueError(f"source = '{self.source}' is made to measure: it needs 'height' and 'width'")
        if not made and (self.height is not None or self.width is not None):
            raise ValueError("'height' and 'width' are for images that are made; use 'crop' for a part of a picture")
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
        order: Of its section on the page that `jaxlens reproduce` writes; the least comes first.
        caption: What the section begins with: what was done, and what came out.
        captions: Of figures and tables, by the names of their files without the suffix, in the order of the page.
    """

    # What is only shown: it changes no result.
    presentation: ClassVar = ("order", "caption", "captions")

    name: Name
    title: str | None = None
    dtype: Literal["float32", "float64"] = "float64"
    seed: int = Field(default=0, ge=0, lt=2**32)
    order: int = 1000
    caption: str = ""
    captions: dict[str, str] = {}


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


class SurfacePlotExperiment(_Experiment):
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

    kind: Literal["surface_plot"]
    image: Image
    drawings: list[Literal["mesh", "filled", "isolines"]] = Field(
        default=["mesh", "filled", "isolines"], min_length=1, max_length=3
    )
    smoothing: float = Field(default=11.5, ge=0, le=1000)
    perspective: float = Field(default=0.22, ge=0, lt=0.7)
    relief: float = Field(default=0.5, ge=0, le=10)
    azimuth: float = 25.0
    elevation: float = Field(default=50.0, gt=0, le=90)


class ControlPointMove(_Table):
    """What becomes of one control point of a free-form deformation.

    Attributes:
        column: i, from 0 at the left to the degree m.
        row: j, from 0 at the top to the degree n.
        dx: To the right, in pixels.
        dy: Downwards, in pixels.
        weight: Of the control point, relative to those left alone.
    """

    column: int = Field(ge=0)
    row: int = Field(ge=0)
    dx: float = 0.0
    dy: float = 0.0
    weight: float = Field(default=1.0, gt=0)


class FreeFormExperiment(_Experiment):
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

    kind: Literal["free_form"]
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


class ProjectionsExperiment(_Experiment):
    """Integral projections of an image and of what one-parameter lenses make of it: Figure 5.

    Attributes:
        image: The image.
        k: Coefficients of Section 2.4, where 1 + k r² takes output to source: k > 0 is barrel.
        window: Length of the pieces of a projection that are compared, in pixels, odd.
        largest: The largest displacement that is looked for, in pixels.
        least_score: Correlation of two pieces below which they do not count as the same.
        warp: How the image is sampled.
    """

    kind: Literal["projections"]
    image: Image
    k: list[float] = Field(default=[0.3, -0.3], min_length=1, max_length=3)
    window: int = Field(default=31, ge=3)
    largest: int = Field(default=16, ge=1)
    least_score: float = Field(default=0.9, ge=-1, le=1)
    warp: Warp = Warp()

    @model_validator(mode="after")
    def _check(self) -> "ProjectionsExperiment":
        if self.window % 2 == 0:
            raise ValueError(f"'window' must be odd, got {self.window}")
        if len(set(self.k)) < len(self.k):
            raise ValueError("'k' must hold each coefficient once")
        return self


class NoiseExperiment(_Experiment):
    """Noise that is the same over the entire image, and what MSE does not see of errors: Figure 7.

    Attributes:
        image: The image.
        other: The picture that the same errors are added to; scaled to the image's size.
        noise: Standard deviation of the noise, as a share of the peak; by default that of the root of the mean square
            of the lens's errors.
        kappa: The lens whose errors stand beside the noise.
        block: Side of the blocks in which the errors' spread is measured, in pixels.
        warp: How the image is sampled.
    """

    kind: Literal["noise"]
    image: Image
    other: Image
    noise: float | None = Field(default=None, gt=0)
    kappa: Kappa
    block: int = Field(default=16, ge=2)
    warp: Warp = Warp()


class Surface(_Table):
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
    path: str | None = None
    height: int = Field(ge=16, le=4096)
    width: int = Field(ge=16, le=4096)
    unit: str = "head heights"

    @model_validator(mode="after")
    def _check(self) -> "Surface":
        if (self.source is None) == (self.path is None):
            raise ValueError("must have either 'source' or 'path', and not both")
        return self


class GeodesicsExperiment(_Experiment):
    """Three distances from the tip of the nose, and two of them on a sphere, where they are known: Eqs. 1 and 2.

    Attributes:
        surface: The face.
        step: From one drawn curve of equal distance to the next, in the surface's unit.
        paths: Points about the nose, evenly spaced by angle, from which shortest paths are drawn.
        reach: How far out these points lie, as a share of the way to the border of the surface.
        sizes: Sides of the depth maps of the sphere's cap, in pixels, each larger than the one before.
        slope: Of the cap at its rim.
    """

    kind: Literal["geodesics"]
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


class Rotations(_Table):
    """A set of rotations of a camera.

    Attributes:
        name: What figures and tables call it.
        turns: Rotation vectors [pan, tilt, roll] in degrees, from one picture to the next: about the camera's y, x
            and z axis (y down, x right, z forward).
    """

    name: str
    turns: list[Annotated[list[float], Field(min_length=3, max_length=3)]] = Field(min_length=1)


class RotationExperiment(_Experiment):
    """The focal length that a rotating camera with a distorting lens finds for itself, as the conclusion claims.

    Attributes:
        k: Coefficients of the lens x_d = x_u (1 + k r²), r in half diagonals; positive is pincushion.
        focal_length: Of the camera, in half diagonals of its picture.
        aspect: Width over height of the picture.
        rotations: The sets.
        points: Of the calibration from which a lens is fitted, spread evenly over the picture.
        noise: Standard deviation of a coordinate of these points, in half diagonals.
        seeds: Calibrations of each lens.
    """

    kind: Literal["rotation"]
    k: list[float] = Field(min_length=2)
    focal_length: float = Field(default=1.5, gt=0)
    aspect: float = Field(default=4 / 3, gt=0)
    rotations: list[Rotations] = Field(min_length=1, max_length=7)
    points: int = Field(default=200, ge=4, le=100_000)
    noise: float = Field(default=0.001, gt=0)
    seeds: int = Field(default=20, ge=2, le=1000)

    @model_validator(mode="after")
    def _check(self) -> "RotationExperiment":
        if any(b <= a for a, b in itertools.pairwise(self.k)):
            raise ValueError(f"'k' must grow, got {self.k}")
        names = [one.name for one in self.rotations]
        if len(set(names)) < len(names):
            raise ValueError("'rotations' must have different names")
        return self


class UnknownExperiment(_Experiment):
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

    kind: Literal["unknown"]
    size: int = Field(default=128, ge=16, le=512)
    candidates: int = Field(default=200, ge=1, le=100_000)
    starts: int = Field(default=4, ge=1, le=1000)
    noise: float = Field(default=0.3, gt=0)
    profile: list[Annotated[float, Field(ge=0.5, le=2.7)]] = Field(default=[0.8, 1.0, 1.25, 1.6], min_length=2)
    fine: int = Field(default=400, ge=16, le=2048)

    @model_validator(mode="after")
    def _check(self) -> "UnknownExperiment":
        if self.starts > self.candidates:
            raise ValueError(f"'starts' must not exceed 'candidates' ({self.candidates}), got {self.starts}")
        return self


Experiment = (
    SweepExperiment
    | ReadingsExperiment
    | GridsExperiment
    | PanelsExperiment
    | InversionExperiment
    | BoardsExperiment
    | SurfacePlotExperiment
    | FreeFormExperiment
    | ProjectionsExperiment
    | NoiseExperiment
    | GeodesicsExperiment
    | RotationExperiment
    | UnknownExperiment
)
KINDS: dict[str, type[Experiment]] = {
    "sweep": SweepExperiment,
    "readings": ReadingsExperiment,
    "grids": GridsExperiment,
    "panels": PanelsExperiment,
    "inversion": InversionExperiment,
    "boards": BoardsExperiment,
    "surface_plot": SurfacePlotExperiment,
    "free_form": FreeFormExperiment,
    "projections": ProjectionsExperiment,
    "noise": NoiseExperiment,
    "geodesics": GeodesicsExperiment,
    "rotation": RotationExperiment,
    "unknown": UnknownExperiment,
}
