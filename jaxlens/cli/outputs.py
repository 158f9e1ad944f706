"""Files that commands write: what is in the way is told before any work is done, and each is written whole."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxlens.cli.messages import CommandError, UsageError, in_options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxlens.calibrations import Calibration
    from jaxlens.images import Picture
    from jaxlens.surfaces import Mesh


def check_new_file(path: Path, *, overwrite: bool, suffixes: Sequence[str] = (), option: str = "--output") -> None:
    """Refuses a file that cannot be written.

    Args:
        path: The file.
        overwrite: Whether it may exist.
        suffixes: One of which it must have; none for any.
        option: What names it.

    Raises:
        UsageError: it is a folder, has another suffix, or exists; or its folder does not.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise UsageError(f"{option} {str(path)!r} must end in {' or '.join(suffixes)}")
    if path.is_dir():
        raise UsageError(f"{option} {str(path)!r} is a folder; name a file in it")
    _check_parent(path, option)
    if path.exists() and not overwrite:
        raise UsageError(f"{option} {str(path)!r} exists; pass --overwrite to replace it")


def check_new_folder(folder: Path, names: Sequence[str], *, overwrite: bool, option: str = "--output") -> None:
    """Refuses a folder into which files cannot be written.

    Raises:
        UsageError: it is a file, cannot be made, or has a file of one of these names that may not be replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{option} {str(folder)!r} is a file; name a folder")
    _check_parent(folder, option)
    taken = [name for name in names if (folder / name).exists()]
    if taken and not overwrite:
        raise UsageError(f"{str(folder / taken[0])!r} exists; pass --overwrite to replace it")


def check_picture_name(path: Path) -> None:
    """Refuses a name that no picture can be written to.

    Raises:
        UsageError: no picture is written with its suffix, or its folder does not exist.
    """
    if not is_writable_name(path):
        from jaxlens.images import WRITABLE_SUFFIXES

        raise UsageError(
            f"--output {str(path)!r} has the suffix {path.suffix!r}, which no picture is written with; "
            f"use one of {', '.join(WRITABLE_SUFFIXES)}, or an existing folder"
        )
    _check_parent(path, "--output")


def check_folder_name(path: Path, *, named_so: bool) -> None:
    """Refuses what is to be a folder for pictures, and cannot be one.

    Args:
        path: The folder, which may not exist yet.
        named_so: Whether it ends in a slash, so that nobody meant a file.

    Raises:
        UsageError: it is a file, or is named like one; or its own folder does not exist.
    """
    if path.is_dir():
        return
    if path.exists() or path.is_symlink():
        raise UsageError(f"--output {str(path)!r} is to be a folder, and is a file; choose another name")
    _check_parent(path, "--output")
    if is_writable_name(path) and not named_so:
        raise UsageError(
            f"several pictures need a folder, and --output {str(path)!r} is named like a file; "
            "leave the suffix out, or end the name in a slash"
        )


def is_writable_name(path: Path) -> bool:
    """Tells by its suffix whether a picture can be written to a file."""
    from jaxlens.images import WRITABLE_SUFFIXES

    return path.suffix.lower() in WRITABLE_SUFFIXES


def has_quality(path: Path) -> bool:
    """Tells by its suffix whether a picture is written with a quality."""
    return path.suffix.lower() in (".jpg", ".jpeg", ".webp")


def make_folder(folder: Path) -> None:
    """Makes a folder if need be.

    Raises:
        CommandError: it cannot be made.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise CommandError(f"cannot make the folder {str(folder)!r}: {error.strerror}") from error


def write_picture(path: Path, picture: "Picture", *, overwrite: bool, quality: int | None = None) -> None:
    """Writes a picture.

    Args:
        path: The file.
        picture: Pixels and metadata.
        overwrite: Replace an existing file.
        quality: Of JPEG and WebP.

    Raises:
        CommandError: as `jaxlens.images.write`.
    """
    from jaxlens import images

    try:
        images.write(path, picture, overwrite=overwrite, quality=quality)
    except images.ImageError as error:
        raise CommandError(in_options(error, path)) from error


def write_mesh(path: Path, mesh: "Mesh", *, overwrite: bool) -> None:
    """Writes a mesh.

    Raises:
        CommandError: it cannot be written.
    """
    from jaxlens import meshes

    with _writing(path):
        meshes.write(path, mesh, overwrite=overwrite)


def write_calibration(path: Path, calibration: "Calibration", *, overwrite: bool) -> None:
    """Writes a calibration.

    Raises:
        CommandError: it cannot be written.
    """
    from jaxlens import calibrations

    with _writing(path):
        calibrations.write_calibration(path, calibration, overwrite=overwrite)


def write_figure(path: Path, figure: "Figure", *, overwrite: bool) -> None:
    """Writes a figure, as what its name ends in.

    Raises:
        CommandError: it cannot be written.
    """
    from jaxlens.figures.style import save, style
    from jaxlens.files import atomic_write

    with _writing(path), atomic_write(path, overwrite=overwrite) as temporary, style():
        save(figure, temporary)


def write_text(path: Path, text: str, *, overwrite: bool) -> None:
    """Writes a text.

    Raises:
        CommandError: it cannot be written.
    """
    from jaxlens import files

    with _writing(path):
        files.write_text(path, text, overwrite=overwrite)


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except FileExistsError:
        raise CommandError(f"{str(path)!r} exists; pass --overwrite to replace it") from None
    except OSError as error:
        raise CommandError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    except (ValueError, ImportError) as error:
        raise CommandError(f"cannot write {str(path)!r}: {error}") from error


def _check_parent(path: Path, option: str) -> None:
    if not path.parent.is_dir():
        raise UsageError(f"{option} {str(path)!r}: there is no folder {str(path.parent)!r}; make it first")
