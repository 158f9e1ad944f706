"""Picture files for the commands: errors in the words of the command line, warnings as messages."""

import warnings
from pathlib import Path

from jaxlens.cli.errors import CommandError
from jaxlens.cli.messages import say
from jaxlens.images import DEFAULT_MAX_PIXELS, ImageError, Picture, read_image, write_image

# What messages of the library call their arguments, and what those are called here.
_OPTIONS = {
    "max_pixels=": "--max-pixels ",
    "max_pixels": "--max-pixels",
    "overwrite=True": "--overwrite",
    "quality=": "--quality ",
}


def read_picture(path: Path, max_pixels: int | None) -> Picture:
    """Reads a picture, and says what the reader warns of.

    Args:
        path: The file.
        max_pixels: The largest size accepted; None for the library's own.

    Raises:
        CommandError: as `jaxlens.images.read_image`.
    """
    limit = DEFAULT_MAX_PIXELS if max_pixels is None else max_pixels
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            picture = read_image(path, max_pixels=limit)
    except ImageError as error:
        raise _in_options(error, path) from error
    # Decoders warn of their own affairs as well; those of the library are UserWarnings.
    for warning in caught:
        if issubclass(warning.category, UserWarning):
            say(f"warning: {str(path)!r}: {warning.message}")
    return picture


def write_picture(path: Path, picture: Picture, *, overwrite: bool, quality: int | None) -> None:
    """Writes a picture, whole or not at all.

    Args:
        path: The file.
        picture: Pixels and metadata.
        overwrite: Replace an existing file.
        quality: Of JPEG and WebP.

    Raises:
        CommandError: as `jaxlens.images.write_image`.
    """
    try:
        write_image(path, picture, overwrite=overwrite, quality=quality)
    except ImageError as error:
        raise _in_options(error, path) from error


def describe(picture: Picture) -> str:
    """Returns a picture's size and kind, as in "640 × 480, 8-bit RGB"."""
    pixels = picture.pixels
    height, width = pixels.shape[:2]
    layout = {1: "gray", 2: "gray and alpha", 3: "RGB", 4: "RGBA"}[pixels.shape[2] if pixels.ndim == 3 else 1]
    bits = 8 * pixels.dtype.itemsize
    kind = {"u": f"{bits}-bit", "i": f"{bits}-bit signed", "f": f"{bits}-bit float"}[pixels.dtype.kind]
    return f"{width} × {height}, {kind} {layout}"


def _in_options(error: ImageError, path: Path) -> CommandError:
    # The file's name stands first and is left as it is.
    name, quoted, rest = str(error).partition(repr(str(path)))
    for term, option in _OPTIONS.items():
        rest = rest.replace(term, option)
    return CommandError(name + quoted + rest)
