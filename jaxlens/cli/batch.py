"""Files through a lens, one after another: what fails is named, the others are done."""

import contextlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from jaxlens.calibrations import Calibration, CalibrationError
from jaxlens.cli.calibrations import load_calibration
from jaxlens.cli.errors import CommandError, UsageError, describe_unexpected, wants_traceback
from jaxlens.cli.jobs import Job, has_quality
from jaxlens.cli.messages import say
from jaxlens.cli.options import WarpArguments
from jaxlens.cli.pictures import describe, read_picture, write_picture
from jaxlens.files import unless_finished
from jaxlens.images import Picture

Direction = Literal["distort", "undistort"]


def warp_files(jobs: Sequence[Job], arguments: WarpArguments, direction: Direction) -> int:
    """Puts pictures through a lens.

    Args:
        jobs: What to read and to write, at least one, by `plan_jobs`.
        arguments: The lens, and how to sample and write.
        direction: Apply the lens, or remove it.

    Returns:
        The exit code: 0, or 1 where a picture failed.

    Raises:
        UsageError: a quality is given, and no output has one; the file of the lens is no calibration.
    """
    _check_quality(jobs, arguments.quality)
    calibration = None if arguments.lens is None else load_calibration(arguments.lens)
    told: set[str] = set()
    written: list[str] = []
    with _folder(jobs[0].folder), _progress(jobs) as steps:
        for job in steps:
            try:
                written.append(_warp_file(job, arguments, calibration, direction, told))
            except CommandError as error:
                say(str(error))
            except Exception as error:
                if wants_traceback():
                    raise
                # Such as too little memory for this picture; the next one may be smaller.
                say(f"cannot {direction} {str(job.source)!r}: {describe_unexpected(error)}")
    if len(jobs) > 1:
        say(f"wrote {len(written)} of {len(jobs)} pictures to {arguments.output!r}")
    elif written:
        say(f"wrote {written[0]}")
    return 0 if len(written) == len(jobs) else 1


def _check_quality(jobs: Sequence[Job], quality: int | None) -> None:
    if quality is not None and not any(has_quality(job.target) for job in jobs):
        raise UsageError(f"--quality {quality} is for JPEG and WebP, and none will be written; leave it out")


def _warp_file(
    job: Job, arguments: WarpArguments, calibration: Calibration | None, direction: Direction, told: set[str]
) -> str:
    _check_target(job, arguments.overwrite)
    picture = read_picture(job.source, arguments.max_pixels)
    warped = _warp_picture(picture, job.source, arguments, calibration, direction, told)
    if job.folder is not None:
        _make_folder(job.folder)
    quality = arguments.quality if has_quality(job.target) else None
    write_picture(job.target, warped, overwrite=arguments.overwrite, quality=quality)
    return f"{str(job.target)!r} ({describe(warped)})"


def _warp_picture(
    picture: Picture,
    source: Path,
    arguments: WarpArguments,
    calibration: Calibration | None,
    direction: Direction,
    told: set[str],
) -> Picture:
    # Here, for JAX takes its time to import: a picture that cannot be read says so at once.
    from jaxlens.cli.pixels import FillError, Warp, find_fold, inner_rectangle, warp_pixels

    center = arguments.center
    warp = Warp(
        direction=direction,
        kappa=tuple(arguments.kappa or ()),
        method=arguments.method,
        border=arguments.border,
        fill=None if arguments.fill is None else tuple(arguments.fill),
        antialias=arguments.antialias,
        center=None if center is None else (center[0], center[1]),
        calibration=calibration,
    )
    height, width = picture.pixels.shape[:2]
    try:
        fold = find_fold(warp, height, width)
        if fold is not None:
            where = (
                "" if fold.radius is None else f" at the radius {fold.radius:.4g} ({fold.pixels:.1f} pixels from its"
            )
            where += "" if fold.radius is None else " centre)"
            _tell_once(
                f"warning: the lens folds{where} in a picture of {width} × {height}: {fold.share:.2%} of the pixels "
                "have no preimage and take the fill value",
                told,
            )
        pixels = warp_pixels(picture.pixels, warp)
    except (CalibrationError, FillError) as error:
        raise CommandError(f"cannot {direction} {str(source)!r}: {error}") from error
    if arguments.crop:
        top, left, tall, wide = inner_rectangle(warp, height, width)
        if tall == 0:
            raise CommandError(
                f"cannot crop {str(source)!r}: no pixel of the result draws from inside the picture; "
                "leave --crop out to see it"
            )
        pixels = pixels[top : top + tall, left : left + wide]
    return replace(picture, pixels=pixels)


def _tell_once(message: str, told: set[str]) -> None:
    if message not in told:
        told.add(message)
        say(message)


def _check_target(job: Job, overwrite: bool) -> None:
    """Refuses what cannot be written before time is spent on it; the writer looks again."""
    if job.folder is not None and job.target.is_symlink():
        target, folder = job.target.resolve(), job.folder.resolve()
        if not target.is_relative_to(folder):
            raise CommandError(
                f"{str(job.target)!r} is a link that leads out of the folder, to {str(target)!r}; remove it first"
            )
    if job.target.is_dir():
        raise CommandError(f"{str(job.target)!r} is a folder; move it away, or choose another --output")
    if job.target.exists() and not overwrite:
        raise CommandError(f"{str(job.target)!r} exists; pass --overwrite to replace it")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise CommandError(f"cannot make the folder {str(folder)!r}: {error.strerror}") from error


@contextlib.contextmanager
def _folder(folder: Path | None) -> Iterator[None]:
    """Leaves no empty folder behind that was not there before."""
    if folder is None or folder.exists():
        yield
        return

    def remove() -> None:
        with contextlib.suppress(OSError):
            folder.rmdir()

    with unless_finished(remove):
        yield
    remove()


@contextlib.contextmanager
def _progress(jobs: Sequence[Job]) -> Iterator[Iterator[Job]]:
    """Gives the jobs one by one, with a bar on a terminal if there are several."""
    if len(jobs) == 1 or not sys.stderr.isatty():
        yield iter(jobs)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=len(jobs))

        def steps() -> Iterator[Job]:
            for job in jobs:
                progress.update(task, description=repr(job.source.name))
                yield job
                progress.advance(task)

        yield steps()
