"""Numbers on the command line: finite ones, however many, negative ones too."""

import math
from pathlib import Path
from typing import Any

from tyro.constructors import PrimitiveConstructorSpec


class Numbers(tuple[float, ...]):
    """Finite numbers in the order given.

    A class of its own, for tyro checks a plain `tuple[float, ...]` with a library that takes longer to import than
    the help may take to appear.
    """


class Paths(tuple[Path, ...]):
    """Paths in the order given; a class for the same reason as `Numbers`."""


# κ of more than this is a slip of the pen, and single precision ends at 3e38.
LARGEST = 1e9


def numbers(metavar: str, *, count: int | None = None) -> PrimitiveConstructorSpec[Any]:
    """Returns how to read an option that takes numbers.

    Args:
        metavar: Stands for them in the help.
        count: How many there must be; None for one or more.
    """
    return PrimitiveConstructorSpec(
        nargs="*" if count is None else count,
        metavar=metavar,
        instance_from_str=_read_numbers,
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


def _read_numbers(words: list[str]) -> Numbers:
    if not words:
        raise ValueError("it takes at least one number, got none")
    return Numbers(_read_number(word) for word in words)


def _read_number(word: str) -> float:
    try:
        number = float(word)
    except ValueError:
        raise ValueError(
            f"{word!r} is not a number; write it like -0.2 or 5e-2; files come before the options"
        ) from None
    if not math.isfinite(number):
        raise ValueError(f"{word!r} is not finite; give a number like -0.2 or 5e-2")
    if abs(number) > LARGEST:
        raise ValueError(f"{word!r} is beyond ±{LARGEST:g}; give a number like -0.2 or 5e-2")
    return number


def _read_paths(words: list[str]) -> Paths:
    if not words:
        raise ValueError("it takes at least one, got none; files come before the options")
    return Paths(Path(word) for word in words)
