"""Files that commands read: errors in the words of the command line, warnings as messages."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxlens.cli.messages import CommandError, UsageError, in_options, say

if TYPE_CHECKING:
    import numpy as np

    from jaxlens.images import Picture
    from jaxlens.surfaces import Mesh

# Pictures of cameras and phones that are not read. Whoever finds them left out should know it.
_HEIF = "HEIF is not read; convert it first, with pillow-heif for instance, to PNG or TIFF"
_RAW = "raw pictures are not read; develop it first, with rawpy for instance, to TIFF"
_REMEDIES = {
    **dict.fromkeys((".heic", ".heif", ".hif"), _HEIF),
    ".jxl": "JPEG XL is not read; convert it first to PNG",
    **dict.fromkeys((".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".raf", ".rw2"), _RAW),
}
# Those of jaxlens.meshes, which imports JAX; a test holds them together.
_MESHES = (".obj", ".ply", ".stl")


def check_path(path: Path) -> None:
    """Refuses a path where there is nothing.

    Raises:
        UsageError: there is no such file or folder, or it cannot be looked at.
    """
    try:
        path.stat()
    except FileNotFoundError:
        raise UsageError(f"there is no file {str(path)!r}; check the name, and the folder you are in") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"cannot look at {str(path)!r}: {reason}") from None


def check_file(path: Path) -> None:
    """Refuses a path where there is no file.

    Raises:
        UsageError: as `check_path`, or there is a folder.
    """
    check_path(path)
    if path.is_dir():
        raise UsageError(f"{str(path)!r} is a folder; name a file in it")


def list_files(inputs: tuple[Path, ...]) -> list[Path]:
    """Returns files as they are, and of folders the pictures in them; what is no picture that is read is named.

    Args:
        inputs: Files and folders. Of several, a file that is missing is left for whoever reads it to name.

    Returns:
        At least one path, none twice.

    Raises:
        UsageError: the only input does not exist, or a folder holds no picture.
    """
    if len(inputs) == 1:
        check_path(inputs[0])
    return list(dict.fromkeys(file for path in inputs for file in _files_of(path)))


def _files_of(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    from jaxlens.images import ImageError, list_images

    try:
        files = list_images(path)
    except ImageError as error:
        raise UsageError(str(error)) from None
    for name, remedy in sorted(_unread(path).items()):
        say(f"skipping {str(path / name)!r}: {remedy}")
    if not files:
        raise UsageError(f"there is no picture in the folder {str(path)!r}; folders in it are not searched")
    return files


def _unread(folder: Path) -> dict[str, str]:
    """The pictures in a folder that are of no format that is read, and what to do about each."""
    found = {}
    for path in folder.iterdir():
        remedy = _REMEDIES.get(path.suffix.lower())
        if remedy and not path.name.startswith("."):
            found[path.name] = remedy
    return found


def is_mesh(path: Path) -> bool:
    """Tells by its suffix whether a file is a mesh; anything else is taken for a picture."""
    return path.suffix.lower() in _MESHES


def read_picture(path: Path, max_pixels: int | None) -> "Picture":
    """Reads a picture, and says what the reader warns of.

    Args:
        path: The file.
        max_pixels: The largest size accepted; None for the library's own.

    Raises:
        CommandError: as `jaxlens.images.read`.
    """
    from jaxlens import images

    limit = images.DEFAULT_MAX_PIXELS if max_pixels is None else max_pixels
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            picture = images.read(path, max_pixels=limit)
    except images.ImageError as error:
        raise CommandError(in_options(error, path)) from error
    # Decoders warn of their own affairs as well; those of the library are UserWarnings.
    for warning in caught:
        if issubclass(warning.category, UserWarning):
            say(f"warning: {str(path)!r}: {warning.message}")
    return picture


def gray_values(picture: "Picture") -> "tuple[np.ndarray, float]":
    """Returns a picture's gray values, the mean of its channels without alpha, and that of white."""
    import numpy as np

    pixels = picture.pixels
    if pixels.dtype.kind == "f":
        white = float(np.max(pixels, where=np.isfinite(pixels), initial=1.0))
    else:
        white = float(np.iinfo(pixels.dtype).max)
    if pixels.ndim == 3:
        pixels = pixels[..., :-1] if picture.has_alpha else pixels
        pixels = pixels.mean(axis=-1, dtype=np.float64)
    return np.asarray(pixels, np.float64), white


def read_mesh(path: Path) -> "Mesh":
    """Reads a mesh.

    Raises:
        CommandError: it cannot be read, or trimesh is not installed.
    """
    from jaxlens import meshes

    try:
        return meshes.read(path)
    except (ValueError, ImportError) as error:
        raise CommandError(f"{str(path)!r}: {error}") from error
    except OSError as error:
        raise CommandError(f"cannot read {str(path)!r}: {error.strerror or error}") from error


def read_columns(path: Path, required: Sequence[str], *, optional: Sequence[str] = ()) -> dict[str, list[float]]:
    """Reads columns of numbers from a CSV file.

    Raises:
        UsageError: as `jaxlens.columns.read_columns`.
    """
    from jaxlens import columns

    try:
        return columns.read_columns(path, required, optional=optional)
    except columns.ColumnsError as error:
        raise UsageError(str(error)) from error
