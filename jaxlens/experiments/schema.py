"""The tables of an experiment's TOML file that several kinds of experiment share.

Only pydantic is imported here, so that a mistake in a file is reported before anything heavy is loaded.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class InputFile:
    """Marks a key that names a file to read, relative to the configuration: `Annotated[str, InputFile("mesh file")]`.

    Attributes:
        noun: What messages call it.
    """

    noun: str


class Table(BaseModel):
    """A table of the file: strict types, finite numbers, no unknown keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    def input_files(self, prefix: str = "") -> Iterator[tuple[str, str, str]]:
        """Yields key, value and noun of every key, in tables of the table too, that is marked as an `InputFile`."""
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            noun = next((mark.noun for mark in field.metadata if isinstance(mark, InputFile)), None)
            if noun is not None and value is not None:
                yield prefix + name, value, noun
            parts = {f"{name}[{i}]": one for i, one in enumerate(value)} if isinstance(value, list) else {name: value}
            for key, part in parts.items():
                if isinstance(part, Table):
                    yield from part.input_files(f"{prefix}{key}.")


class Crop(Table):
    """A rectangle of an image, in pixels."""

    top: int = Field(ge=0)
    left: int = Field(ge=0)
    height: int = Field(ge=1)
    width: int = Field(ge=1)


class Image(Table):
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
    path: Annotated[str | None, InputFile("picture file")] = None
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

    def replaced_by(self, path: str) -> "Image":
        """Returns a picture file, all of it, with this image's `gray` and `peak`."""
        return Image(path=path, gray=self.gray, peak=self.peak)

    @property
    def label(self) -> str:
        """The name, or what stands for it."""
        return self.name or self.source or str(self.path).replace("\\", "/").rpartition("/")[-1]


class Axis(Table):
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


class Lenses(Table):
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


class Warp(Table):
    """How images are sampled; see `jaxlens.remap`."""

    method: Literal["nearest", "bilinear", "bicubic", "bicubic_opencv"] = "bilinear"
    border: Literal["constant", "edge", "reflect", "wrap"] = "constant"
    fill: float = 0.0
    antialias: bool = False
