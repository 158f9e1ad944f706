"""A folder of results that appears whole or not at all, and replaces nothing but its own earlier self."""

import contextlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from jaxlens.experiments.abandoned import held_folder, remove_abandoned
from jaxlens.experiments.errors import ExperimentError
from jaxlens.files import file_sha256, unbroken, unless_finished

MANIFEST = "manifest.json"
RECORD = "run.json"
"""Beside the manifest, what differs from run to run: when and where it was, on which source and versions. Git ignores
it, so that a run which gives the same results leaves a clone as it was."""
MARKER = "jaxlens experiment"
"""The manifest's `tool`, by which a folder of results is known."""


@contextlib.contextmanager
def result_folder(target: Path, experiment: str) -> Iterator[Path]:
    """Gives a temporary folder beside `target` that takes its place when the block ends well.

    When the block raises, even KeyboardInterrupt, what was there before stays as it was and the temporary folder
    is removed. One that a killed process has left beside `target` is removed first.

    Args:
        target: Where the results go. Its parents are made.
        experiment: The experiment's name: earlier results of that name are replaced.

    Yields:
        The temporary folder.

    Raises:
        ExperimentError: something else is in the target's place, or it cannot be written.
    """
    target = Path(os.path.realpath(target))
    check_target(target, experiment)
    missing = [parent for parent in target.parents if not parent.exists()]
    remove_abandoned(target)
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    with unless_finished(lambda: _undo(temporary, target, missing)):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ExperimentError(f"cannot make the folder {str(target.parent)!r}: {error.strerror}") from error
        try:
            with held_folder(temporary):
                yield temporary
                # Looked at again: the work may have taken hours.
                check_target(target, experiment)
                with unbroken():
                    _swap(temporary, target)
                shutil.rmtree(_set_aside(temporary), ignore_errors=True)
        except OSError as error:
            place = error.filename or str(target)
            raise ExperimentError(f"cannot write the results to {place!r}: {error.strerror or error}") from error


def check_target(target: Path, experiment: str) -> None:
    """Checks that nothing but earlier results of the same experiment would be replaced.

    Raises:
        ExperimentError: says what is in the way.
    """
    if not target.exists():
        return
    where = repr(str(target))
    if not target.is_dir():
        raise ExperimentError(f"{where} is not a folder; choose another place for the results")
    if target.samefile(Path.cwd()):
        raise ExperimentError(f"{where} is the current folder; give the results a folder of their own")
    present = {path.name for path in target.iterdir()}
    if not present:
        return
    advice = "choose another place for the results, or empty that folder yourself"
    manifest = read_manifest(target)
    if manifest is None:
        raise ExperimentError(f"{where} holds files that no experiment wrote ({_some(present)}); {advice}")
    if manifest.get("experiment") != experiment:
        other = manifest.get("experiment")
        raise ExperimentError(f"{where} holds the results of experiment {other!r}, not {experiment!r}; {advice}")
    files = manifest.get("files")
    own = {MANIFEST, RECORD, *(files if isinstance(files, dict) else {})}
    foreign = {name for name in present if name not in own or not (target / name).is_file()}
    if foreign:
        raise ExperimentError(f"{where} holds what its manifest does not list ({_some(foreign)}); {advice}")


def read_manifest(folder: Path) -> dict[str, object] | None:
    """Returns what the manifest of a folder of results says, or None where no experiment left one."""
    manifest = _read_object(folder / MANIFEST)
    return manifest if manifest is not None and manifest.get("tool") == MARKER else None


def read_record(folder: Path) -> dict[str, object] | None:
    """Returns what is recorded of the run that made a folder of results; None if nothing is, or of another run."""
    record = _read_object(folder / RECORD)
    if record is None or record.get("manifest_sha256") != file_sha256(folder / MANIFEST):
        return None
    return record


def _read_object(path: Path) -> dict[str, object] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _set_aside(temporary: Path) -> Path:
    """Where the earlier results wait while the new ones take their place."""
    return temporary.with_name(f"{temporary.name}.old")


def _swap(new: Path, target: Path) -> None:
    """Puts a folder in the place of another."""
    if target.exists():
        target.rename(_set_aside(new))
    new.rename(target)


def _undo(temporary: Path, target: Path, parents: Sequence[Path]) -> None:
    """Brings the earlier results back; removes the new ones, and parents, the deepest first, as far as empty."""
    old = _set_aside(temporary)
    if old.exists() and not target.exists():
        with contextlib.suppress(OSError):
            old.rename(target)
    for folder in (temporary, old):
        shutil.rmtree(folder, ignore_errors=True)
    for parent in parents:
        with contextlib.suppress(OSError):
            parent.rmdir()


def _some(names: set[str]) -> str:
    shown = sorted(names)[:3]
    return ", ".join(repr(name) for name in shown) + (", …" if len(names) > len(shown) else "")
