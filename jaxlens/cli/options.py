"""Options that several commands have, each written out once: how it is read, what the help says, what is refused."""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Optional

from tyro.conf import arg
from tyro.constructors import PrimitiveConstructorSpec

from jaxlens.cli.messages import UsageError


class Numbers(tuple[float, ...]):
    """Numbers in the order given.

    A class of its own, for tyro checks a plain `tuple[float, ...]` with a library that takes longer to import than
    the help may take to appear.
    """


class Paths(tuple[Path, ...]):
    """Paths in the order given; a class for the same reason as `Numbers`."""


class Names(tuple[str, ...]):
    """Names in the order given; a class for the same reason as `Numbers`."""


# Single precision ends at 3.4e38.
_LARGEST = 3e38


def numbers(
    metavar: str, *, count: int | None = None, largest: float = _LARGEST, nan: bool = False
) -> PrimitiveConstructorSpec[Any]:
    """Returns how to read an option that takes numbers, with spaces or commas between.

    Args:
        metavar: Stands for them in the help.
        count: How many there must be; None for one or more.
        largest: The largest magnitude that makes sense; what is beyond is a slip of the pen.
        nan: Whether NaN makes sense.
    """
    return PrimitiveConstructorSpec(
        nargs="*" if count is None else count,
        metavar=metavar,
        instance_from_str=partial(_read_numbers, count=count, largest=largest, nan=nan),
        is_instance=lambda value: isinstance(value, Numbers),
        # For the help's defaults; an option that may be left out has None there, and its own words.
        str_from_instance=lambda value: [f"{number:g}" for number in value or ()],
    )


def numbers_or_file(metavar: str, *, largest: float = _LARGEST) -> PrimitiveConstructorSpec[Any]:
    """Returns how to read an option that takes numbers as `numbers` does, or one file; what is no number is a file."""

    def read(given: list[str]) -> Numbers | Path:
        if len(given) == 1 and given[0] and not _looks_like_numbers(given[0]):
            return Path(given[0])
        return _read_numbers(given, count=None, largest=largest, nan=False)

    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, Numbers | Path),
        str_from_instance=lambda value: (
            [str(value)] if isinstance(value, Path) else [f"{one:g}" for one in value or ()]
        ),
    )


def words(kind: type[Paths] | type[Names], metavar: str) -> PrimitiveConstructorSpec[Any]:
    """Returns how to read one or more paths or names; whether there is anything there is for the command to see."""

    def read(given: list[str]) -> Paths | Names:
        if not given:
            raise ValueError("it takes at least one, got none; files come before the options")
        if "" in given:
            raise ValueError("a path is empty; a variable in your script may be unset")
        return Paths(map(Path, given)) if kind is Paths else Names(given)

    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, kind),
        str_from_instance=lambda value: [str(one) for one in value],
    )


def _looks_like_numbers(word: str) -> bool:
    try:
        return bool([float(part) for part in word.split(",")])
    except ValueError:
        return False


def _read_numbers(words: list[str], *, count: int | None, largest: float, nan: bool) -> Numbers:
    if not words:
        raise ValueError("it takes at least one number, got none")
    found = Numbers(_read_number(part, largest, nan) for word in words for part in word.split(","))
    if count is not None and len(found) != count:
        raise ValueError(f"it takes {count} numbers, got {len(found)}")
    return found


def _read_number(word: str, largest: float, nan: bool) -> float:
    try:
        number = float(word)
    except ValueError:
        raise ValueError(
            f"{word!r} is not a number; write it like -0.2 or 5e-2; files come before the options"
        ) from None
    if nan and math.isnan(number):
        return number
    if not math.isfinite(number):
        raise ValueError(f"{word!r} is not finite; give a number like -0.2 or 5e-2")
    if abs(number) > largest:
        raise ValueError(f"{word!r} is beyond ±{largest:g}; give a number like -0.2 or 5e-2")
    return number


# Those of jaxlens.sampling, which imports JAX; a test holds them together.
Method = Literal["nearest", "bilinear", "bicubic", "bicubic_opencv"]
Border = Literal["constant", "edge", "reflect", "wrap"]
# And those of jaxlens.cameras.
Keep = Literal["same", "valid", "all"]
ViewProjection = Literal["perspective", "cylindrical", "equirectangular", "stereographic"]

Kappa = Annotated[Optional[Numbers], numbers("K1 [K2 ...]", largest=1e6), arg(aliases=["-k"], help_behavior_hint="")]


def _shared(text: str, metavar: str | None = None, *, hint: str = "") -> Any:
    """Returns what the help says of an option that several commands have."""
    return arg(help=text, metavar=metavar, help_behavior_hint=hint)


ImageSize = Annotated[Optional[str], _shared("The points are pixels of pictures of this size.", "WIDTHxHEIGHT")]
FitCenter = Annotated[bool, _shared("Fit the lens's centre of distortion, too.")]
Lens = Annotated[
    Optional[Path],
    _shared("A calibration by jaxlens fit or jaxlens calibrate, whose lens is taken in place of --kappa.", "FILE.json"),
]
LensModel = Annotated[
    Optional[str],
    _shared(
        "The class of the lens in --lens where it is one of your own.\n"
        "That module is looked for in the current folder, too, and is run.",
        "package.module:Class",
    ),
]
Quality = Annotated[
    Optional[int],
    _shared("How good JPEG and WebP files are; the better, the larger.", "1-100", hint="(default: 95, WebP lossless)"),
]
Overwrite = Annotated[bool, _shared("Replace files that exist.")]
MaxPixels = Annotated[
    Optional[int],
    _shared("Refuse pictures with more pixels, before they are decoded.", "COUNT", hint="(default: 200 million)"),
]


def check_quality(quality: int | None) -> None:
    """Refuses a quality that no file has.

    Raises:
        UsageError: it is out of bounds.
    """
    if quality is not None and not 1 <= quality <= 100:
        raise UsageError(f"--quality is from 1 to 100, got {quality}")


def check_max_pixels(max_pixels: int | None) -> None:
    """Refuses a limit that no picture meets.

    Raises:
        UsageError: it is below one.
    """
    if max_pixels is not None and max_pixels < 1:
        raise UsageError(f"--max-pixels is at least 1, got {max_pixels}")


def parse_size(text: str, option: str) -> tuple[int, int]:
    """Reads two counts as in `640x480`.

    Raises:
        UsageError: it is not that.
    """
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) == 2 and all(part.strip().isdecimal() and int(part) > 0 for part in parts):
        return int(parts[0]), int(parts[1])
    example = "9x6" if option == "--board" else "640x480"
    raise UsageError(f"{option} is two counts with an x between, such as {example}; got {text!r}")
