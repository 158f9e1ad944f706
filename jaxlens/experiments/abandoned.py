"""Temporary folders whose process was killed: known by the lock that it no longer holds, and removed."""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # not POSIX
    fcntl = None


@contextlib.contextmanager
def held_folder(path: Path) -> Iterator[None]:
    """Makes a folder, and locks it while the block runs, so that `remove_abandoned` leaves it alone.

    The system lets go of the lock when the process ends, however it does. Where folders cannot be locked (Windows, some
    network file systems) nothing is locked, and nothing removed.

    Raises:
        OSError: it cannot be made.
    """
    # Under this name nobody takes it for abandoned before it is locked.
    new = path.with_name(f"{path.name}.new")
    new.mkdir()
    descriptor = _locked(new)
    try:
        new.rename(path)
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def remove_abandoned(target: Path) -> None:
    """Removes the temporary folders beside `target` that were to take its place and that no process holds.

    Args:
        target: The folder of results. Temporary ones are called `.name.` and eight hexadecimal digits; with `.old`
            behind, they are earlier results, which are in nobody's way only once there are new ones.
    """
    name = re.compile(rf"\.{re.escape(target.name)}\.[0-9a-f]{{8}}(\.old)?")
    try:
        found = [path for path in target.parent.iterdir() if name.fullmatch(path.name)]
    except OSError:
        return
    for path in found:
        if path.is_symlink() or not path.is_dir() or (path.suffix == ".old" and not target.exists()):
            continue
        descriptor = _locked(path)
        if descriptor is not None:
            shutil.rmtree(path, ignore_errors=True)
            os.close(descriptor)


def _locked(folder: Path) -> int | None:
    """Opens and locks a folder; None where that is not possible, or another process has locked it."""
    if fcntl is None:
        return None
    descriptor = None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        if descriptor is not None:
            os.close(descriptor)
        return None
    return descriptor
