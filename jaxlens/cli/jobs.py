"""Many pictures: which is written where, settled before the first is read; then one after another, failures named."""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxlens.cli.inputs import list_files
from jaxlens.cli.messages import CommandError, UsageError, describe_unexpected, say, wants_traceback
from jaxlens.cli.outputs import check_folder_name, check_picture_name, is_writable_name
from jaxlens.cli.progress import progress_of
from jaxlens.files import unless_finished


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
        check_picture_name(path)
        return [Job(sources[0], path, None)]
    check_folder_name(path, named_so=names_folder)
    return _without_clashes([Job(source, path / _name_for(source), path) for source in sources])


def run_jobs(jobs: Sequence[Job], do: Callable[[Job], str], purpose: str, *, overwrite: bool) -> int:
    """Does jobs one after another, with a bar on a terminal if there are several; those that fail are named.

    Args:
        jobs: At least one, by `plan_jobs`.
        do: Does one, and returns what it has written, in words.
        purpose: What is done to each picture: a verb.
        overwrite: Replace files that exist.

    Returns:
        The exit code: 0, or 1 where a job failed.
    """
    written: list[str] = []
    several = len(jobs) > 1
    with _folder(jobs[0].folder), progress_of("pictures") if several else contextlib.nullcontext() as progress:
        for done, job in enumerate(jobs):
            if progress is not None:
                progress(done, len(jobs))
            try:
                _check_target(job, overwrite)
                written.append(do(job))
            except CommandError as error:
                say(str(error))
            except Exception as error:
                if wants_traceback():
                    raise
                # Such as too little memory for this picture; the next one may be smaller.
                say(f"cannot {purpose} {str(job.source)!r}: {describe_unexpected(error)}")
    if several:
        say(f"wrote {len(written)} of {len(jobs)} pictures to {str(jobs[0].folder)!r}")
    elif written:
        say(f"wrote {written[0]}")
    return 0 if len(written) == len(jobs) else 1


def _name_for(source: Path) -> str:
    # A name alone, without a folder: the output cannot leave the folder it is put in.
    return source.name if is_writable_name(source) else f"{source.stem}.png"


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
