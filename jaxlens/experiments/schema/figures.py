"""The paper's other figures: 1, 2, 5, 7 and 8."""

from typing import Annotated, Literal

from jaxlens.experiments.schema.tables import Common, Crop, Image, Kappa, Table, Warp
from pydantic import Field, model_validator


class SurfacePlotExperiment(Common):
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


class ControlPointMove(Table):
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


class FreeFormExperiment(Common):
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


class ProjectionsExperiment(Common):
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


class NoiseExperiment(Common):
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
