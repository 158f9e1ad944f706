"""Numbers on the command line: finite ones, however many, negative ones too."""

import math
from functools import partial
from pathlib import Path
from typing import Any

from tyro.constructors import PrimitiveConstructorSpec


class Numbers(tuple[float, ...]):
    """Numbers in the order given.

    A class of its own, for tyro checks a plain `tuple[float, ...]` with a library that takes longer to import than
    the help may take to appear.
    """


class Paths(tuple[Path, ...]):
    """Paths in the order given; a class for the same reason as `Numbers`."""


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


def paths(metavar: str) -> PrimitiveConstructorSpec[Any]:
    """Returns how to read one or more paths; whether there is anything there is for the command to see."""
    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=metavar,
        instance_from_str=_read_paths,
        is_instance=lambda value: isinstance(value, Paths),
        str_from_instance=lambda value: [str(path) for path in value],
    )


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


def _read_paths(words: list[str]) -> Paths:
    if not words:
        raise ValueError("it takes at least one, got none; files come before the options")
    if "" in words:
        raise ValueError("a path is empty; a variable in your script may be unset")
    return Paths(Path(word) for word in words)
