"""Files written whole or not at all, and the checksum that names what is in them.

A reader never sees a half-written file, an interrupted run leaves the old file as it was, and two runs
that write the same name cannot silently replace each other's result. A process that must end without unwinding
undoes what it has begun first (`undo_unfinished`).
"""

import contextlib
import errno
import hashlib
import os
import secrets
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import RLock

# What a process that ends without unwinding must do first, and the lock that it holds from then on.
_unfinished: list[Callable[[], None]] = []
_lock = RLock()


@contextlib.contextmanager
def unless_finished(undo: Callable[[], None]) -> Iterator[None]:
    """Has something undone unless the block ends well: where it raises, and where `undo_unfinished` is called.

    Args:
        undo: What to do. It may be called twice, and before anything was done; it raises nothing.
    """
    with _lock:
        _unfinished.append(undo)
    try:
        yield
    except BaseException:
        undo()
        raise
    finally:
        with _lock:
            _unfinished.remove(undo)


@contextlib.contextmanager
def unbroken() -> Iterator[None]:
    """Keeps `undo_unfinished` waiting: for the few steps that put what is complete in its place."""
    with _lock:
        yield


def undo_unfinished() -> None:
    """Undoes what other threads have begun and not finished, so that the process can end at once.

    Nothing can be begun after this: whoever tries waits for ever. Only for a process about to end by `os._exit`.
    """
    _lock.acquire()
    for undo in reversed(_unfinished):
        undo()


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Gives a temporary file to write, which takes the name `path` when the block ends well.

    The temporary file lies in the folder of `path`, hidden (its name starts with a dot) and with the suffix
    of `path`. It exists already, empty: open it with mode `"wb"` or `"w"`. When the block raises, even
    KeyboardInterrupt, it is removed and `path` stays as it was. Only a process killed outright leaves it.

    Nothing is flushed to the disk itself (no fsync): the guarantee holds against failing programs, not
    against a failing power supply.

    Args:
        path: The file to write. Its folder must exist. A symbolic link is followed: the file it points to is
            written, the link stays.
        overwrite: Replace an existing file, keeping its permissions. A new file gets those of the umask.

    Yields:
        The path of the temporary file.

    Raises:
        FileExistsError: `path` exists and `overwrite` is false. Said before the block runs; also said after
            it, when somebody else made the file meanwhile, whose file is then left alone.
        FileNotFoundError: the folder of `path` does not exist.
        NotADirectoryError: the folder of `path` is not a folder.
        IsADirectoryError: `path` is a folder.
        OSError: the system refused: no permission, no space.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> with atomic_write(folder / "greeting.txt") as temporary:
        ...     _ = temporary.write_text("hello")
        >>> (folder / "greeting.txt").read_text()
        'hello'
    """
    target = Path(os.path.realpath(path))
    _check_target(target, overwrite)
    temporary = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
    with unless_finished(lambda: _remove(temporary)):
        _create_empty(temporary)
        if overwrite:
            _copy_permissions(target, temporary)
        yield temporary
        with unbroken():
            if overwrite:
                os.replace(temporary, target)
            else:
                _rename_new(temporary, target)


def write_text(path: str | os.PathLike[str], text: str, *, overwrite: bool = False) -> None:
    r"""Writes a text file whole or not at all, in UTF-8, with `\n` left as it is on every system.

    Args:
        path: The file to write; see `atomic_write`.
        text: What to write.
        overwrite: Replace an existing file.

    Raises:
        OSError: as `atomic_write`.
    """
    with atomic_write(path, overwrite=overwrite) as temporary:
        # newline="" keeps the bytes, and so the checksum, equal on every system.
        temporary.write_text(text, encoding="utf-8", newline="")


def file_sha256(path: str | os.PathLike[str]) -> str:
    """Computes the SHA-256 of a file's bytes, reading it in blocks.

    Args:
        path: An existing file.

    Returns:
        The digest as 64 lowercase hexadecimal digits, as `sha256sum` prints it.

    Raises:
        OSError: the file cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_target(target: Path, overwrite: bool) -> None:
    if target.is_dir():
        raise IsADirectoryError(f"{str(target)!r} is a folder; give the name of a file")
    if target.exists() and not overwrite:
        raise _exists(target)
    if not target.parent.exists():
        raise FileNotFoundError(
            f"the folder {str(target.parent)!r} does not exist; make it first to write {target.name!r} there"
        )
    if not target.parent.is_dir():
        raise NotADirectoryError(f"{str(target.parent)!r} is not a folder; choose another place")


def _exists(target: Path) -> FileExistsError:
    return FileExistsError(f"{str(target)!r} exists; pass overwrite=True to replace it, or choose another name")


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _create_empty(path: Path) -> None:
    """Makes a new empty file with the permissions of the umask, where `tempfile` would give 0600."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))


def _copy_permissions(source: Path, destination: Path) -> None:
    """Copies permissions before anything is written, so that a private file is at no moment readable by others."""
    with contextlib.suppress(FileNotFoundError):
        destination.chmod(stat.S_IMODE(source.stat().st_mode))


def _rename_new(temporary: Path, target: Path) -> None:
    """Renames where `target` must not exist; decided by the file system in one step, hence free of races."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise _exists(target) from None
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ENOENT, errno.EROFS):
            raise
        # No hard links here (FAT, some network file systems): reserve the name, then replace the reservation.
        _reserve_and_replace(temporary, target)
    else:
        temporary.unlink()


def _reserve_and_replace(temporary: Path, target: Path) -> None:
    try:
        _create_empty(target)
    except FileExistsError:
        raise _exists(target) from None
    try:
        os.replace(temporary, target)
    except BaseException:
        target.unlink(missing_ok=True)
        raise
