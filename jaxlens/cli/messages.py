"""What a command says to people: lines on stderr, for stdout is kept for results, and errors in place of tracebacks."""

import contextlib
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlens.images import Picture

_OUT_OF_MEMORY = ("RESOURCE_EXHAUSTED", "out of memory")
# What messages of the library call things, and what those are called here.
_OPTIONS = {
    "max_pixels=": "--max-pixels ",
    "max_pixels": "--max-pixels",
    "overwrite=True": "--overwrite",
    "quality=": "--quality ",
    "fill=": "--fill ",
    "fill takes": "--fill takes",
    "keep=": "--view ",
    "fov=": "--fov ",
    "projection=": "--projection ",
    "by `free`": "by a smaller --terms",
    "One of your own is known once the module that registers it has been imported": (
        "For one of your own pass --model package.module:Class, too: that module is imported, and thus run"
    ),
}


class CommandError(Exception):
    """The work could not be done: a damaged file, a full disk. The message says what failed and what to do."""

    exit_code = 1


class UsageError(CommandError):
    """The arguments ask for something that cannot be; nothing was begun."""

    exit_code = 2


def say(message: str) -> None:
    """Writes a line to stderr; above the progress bar, if there is one.

    Args:
        message: For people, without a full stop. Names of files in it are quoted by `repr`, which keeps whatever a
            name may hold from the terminal.
    """
    # Where nobody listens there is nobody to tell about it.
    with contextlib.suppress(OSError, ValueError):
        print(f"jaxlens: {message}", file=sys.stderr)  # noqa: T201


def in_options(error: Exception, path: object = None) -> str:
    """Returns a message of the library in the words of the command line.

    Args:
        error: What the library raised.
        path: A file that the message may begin with, whose name is left as it is.
    """
    name, quoted, rest = str(error).partition(repr(str(path)))
    if not quoted:
        name, rest = "", name
    for term, option in _OPTIONS.items():
        rest = rest.replace(term, option)
    return name + quoted + rest


def describe(picture: "Picture") -> str:
    """Returns a picture's size and kind, as in "640 × 480, 8-bit RGB"."""
    pixels = picture.pixels
    height, width = pixels.shape[:2]
    layout = {1: "gray", 2: "gray and alpha", 3: "RGB", 4: "RGBA"}[pixels.shape[2] if pixels.ndim == 3 else 1]
    bits = 8 * pixels.dtype.itemsize
    kind = {"u": f"{bits}-bit", "i": f"{bits}-bit signed", "f": f"{bits}-bit float"}[pixels.dtype.kind]
    return f"{width} × {height}, {kind} {layout}"


def describe_unexpected(error: Exception) -> str:
    """Returns what to say of an exception that no command foresaw."""
    # XLA's exhaustion of memory is a RuntimeError with a word in it.
    if isinstance(error, MemoryError) or any(sign in str(error) for sign in _OUT_OF_MEMORY):
        return "not enough memory; try a smaller picture"
    return (
        f"unexpected {type(error).__name__}: {error}\n"
        "This is a fault of jaxlens. Please report what it prints when run again with JAXLENS_TRACEBACK=1."
    )


def wants_traceback() -> bool:
    """Whether the user asks, by JAXLENS_TRACEBACK, to see tracebacks of unexpected exceptions."""
    return bool(os.environ.get("JAXLENS_TRACEBACK"))
