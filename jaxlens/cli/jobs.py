"""Which picture is written where: settled, and checked, before the first one is read."""

import os
from dataclasses import dataclass
from pathlib import Path

from jaxlens.cli.errors import UsageError
from jaxlens.cli.messages import say
from jaxlens.cli.options import check_path

# Pictures of cameras and phones that are not read. Whoever finds them left out should know it.
_HEIF = "HEIF is not read; convert it first, with pillow-heif for instance, to PNG or TIFF"
_RAW = "raw pictures are not read; develop it first, with rawpy for instance, to TIFF"
_REMEDIES = {
    **dict.fromkeys((".heic", ".heif", ".hif"), _HEIF),
    ".jxl": "JPEG XL is not read; convert it first to PNG",
    **dict.fromkeys((".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".raf", ".rw2"), _RAW),
}


@dataclass(frozen=True)
class Job:
    """One picture to read and one to write.

    Attributes:
        source: The file to read.
        target: The file to write.
        folder: The folder that the target must not leave, where the user named only a folder; else None.
    """

    source: Path
    target: Path
    folder: Path | None


def plan_jobs(inputs: tuple[Path, ...], output: str) -> list[Job]:
    """Settles the outputs of inputs.

    One file goes to `output` itself, unless that is a folder or ends in a slash. Several, or what a folder holds, go
    into the folder `output`, under their own names; with a suffix that is not written, as GIF's, under `.png`.

    Args:
        inputs: Files and folders.
        output: A file or a folder, as the user wrote it.

    Returns:
        At least one job; no two have one target, and no file occurs twice.

    Raises:
        UsageError: the only input does not exist, a folder holds no picture, the output is not of the kind that is
            needed, or two inputs would have the same output.
    """
    sources = list_files(inputs)
    path = Path(output)
    names_folder = path.is_dir() or output.endswith(("/", os.sep))
    if len(inputs) == 1 and not inputs[0].is_dir() and not names_folder:
        check_picture_file(path)
        return [Job(sources[0], path, None)]
    _check_folder(path, named_so=names_folder)
    return _without_clashes([Job(source, path / _name_for(source), path) for source in sources])


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


def has_quality(path: Path) -> bool:
    """Tells by its suffix whether a picture is written with a quality."""
    return path.suffix.lower() in (".jpg", ".jpeg", ".webp")


def check_picture_file(output: Path) -> None:
    """Refuses what no picture can be written to.

    Raises:
        UsageError: no picture is written with its suffix, or its folder does not exist.
    """
    if not _is_writable_name(output):
        from jaxlens.images import WRITABLE_SUFFIXES

        raise UsageError(
            f"--output {str(output)!r} has the suffix {output.suffix!r}, which no picture is written with; "
            f"use one of {', '.join(WRITABLE_SUFFIXES)}, or an existing folder"
        )
    if not output.parent.is_dir():
        raise _no_parent(output)


def _check_folder(output: Path, *, named_so: bool) -> None:
    if output.is_dir():
        return
    if output.exists() or output.is_symlink():
        raise UsageError(f"--output {str(output)!r} is to be a folder, and is a file; choose another name")
    if not output.parent.is_dir():
        raise _no_parent(output)
    if _is_writable_name(output) and not named_so:
        raise UsageError(
            f"several pictures need a folder, and --output {str(output)!r} is named like a file; "
            "leave the suffix out, or end the name in a slash"
        )


def _no_parent(output: Path) -> UsageError:
    return UsageError(f"--output {str(output)!r}: there is no folder {str(output.parent)!r}; make it first")


def _is_writable_name(path: Path) -> bool:
    from jaxlens.images import WRITABLE_SUFFIXES

    return path.suffix.lower() in WRITABLE_SUFFIXES


def _name_for(source: Path) -> str:
    # A name alone, without a folder: the output cannot leave the folder it is put in.
    return source.name if _is_writable_name(source) else f"{source.stem}.png"


def _without_clashes(jobs: list[Job]) -> list[Job]:
    taken: dict[str, Job] = {}
    for job in jobs:
        # Without regard to case, as some file systems see names.
        key = job.target.name.casefold()
        other = taken.setdefault(key, job)
        if other is job:
            continue
        if not (job.source.exists() and other.source.exists() and os.path.samefile(other.source, job.source)):
            raise UsageError(
                f"{str(other.source)!r} and {str(job.source)!r} would both be written to {str(job.target)!r}; "
                "run them apart, each into a folder of its own"
            )
    return list(taken.values())
