"""Studies: lenses recovered, distances on faces, a rotating camera, the unknown picture."""

import itertools
from typing import Annotated, Literal

from jaxlens.experiments.schema.tables import Common, Image, Kappa, Table
from pydantic import Field, model_validator

Noise = Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]


class InversionExperiment(Common):
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


class BoardModel(Table):
    """A lens to calibrate with.

    Attributes:
        name: What the table calls it.
        terms: Coefficients of the Brown–Conrady lens: 4, 5 or 8.
        fixed: Parameters that stay zero.
        reference_rms: The RMS that other software reports on the same corners, if known.
    """

    name: str
    terms: Literal[4, 5, 8]
    fixed: list[str] = Field(default=[])
    reference_rms: float | None = None


class BoardsExperiment(Common):
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


class Surface(Table):
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


class GeodesicsExperiment(Common):
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


class Rotations(Table):
    """A set of rotations of a camera.

    Attributes:
        name: What figures and tables call it.
        turns: Rotation vectors [pan, tilt, roll] in degrees, from one picture to the next: about the camera's y, x
            and z axis (y down, x right, z forward).
    """

    name: str
    turns: list[Annotated[list[float], Field(min_length=3, max_length=3)]] = Field(min_length=1)


class RotationExperiment(Common):
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


class UnknownExperiment(Common):
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
