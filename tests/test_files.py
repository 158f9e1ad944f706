import errno
import hashlib
import os
import stat
import threading
from pathlib import Path

import pytest

from jaxlens.files import atomic_write, file_sha256, write_text


def listing(folder):
    return sorted(os.listdir(folder))


@pytest.fixture
def umask():
    previous = os.umask(0o027)
    yield 0o027
    os.umask(previous)


@pytest.fixture
def no_hard_links(monkeypatch):
    def refuse(source, destination):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)


def test_file_appears_only_when_the_block_ends(tmp_path):
    path = tmp_path / "result.csv"
    with atomic_write(path) as temporary:
        temporary.write_bytes(b"1,2\n")
        assert not path.exists()
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".csv"
        assert temporary.name.startswith(".")
    assert path.read_bytes() == b"1,2\n"
    assert listing(tmp_path) == ["result.csv"]


def write_half(path, failure):
    with atomic_write(path, overwrite=True) as temporary:
        temporary.write_text("half")
        raise failure


@pytest.mark.parametrize("failure", [ValueError, OSError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("existing", [False, True])
def test_failure_leaves_everything_as_it_was(tmp_path, failure, existing):
    path = tmp_path / "result.csv"
    if existing:
        path.write_text("old")
    before = listing(tmp_path)
    with pytest.raises(failure):
        write_half(path, failure)
    assert listing(tmp_path) == before
    assert not existing or path.read_text() == "old"


def test_existing_file_is_kept_without_overwrite(tmp_path):
    path = tmp_path / "result.csv"
    path.write_text("old")
    writing = atomic_write(path)
    with pytest.raises(FileExistsError, match=r"result\.csv' exists; pass overwrite=True"):
        writing.__enter__()
    assert path.read_text() == "old"
    assert listing(tmp_path) == ["result.csv"]


def test_existing_file_is_replaced_with_overwrite(tmp_path):
    write_text(tmp_path / "a.txt", "old")
    write_text(tmp_path / "a.txt", "new", overwrite=True)
    assert (tmp_path / "a.txt").read_text() == "new"
    assert listing(tmp_path) == ["a.txt"]


def write_while_another_does(path):
    with atomic_write(path) as temporary:
        temporary.write_text("ours")
        path.write_text("theirs")


def test_file_made_meanwhile_is_kept(tmp_path):
    path = tmp_path / "result.csv"
    with pytest.raises(FileExistsError, match=r"result\.csv"):
        write_while_another_does(path)
    assert path.read_text() == "theirs"
    assert listing(tmp_path) == ["result.csv"]


@pytest.mark.usefixtures("no_hard_links")
def test_file_made_meanwhile_is_kept_without_hard_links(tmp_path):
    test_file_made_meanwhile_is_kept(tmp_path)


@pytest.mark.usefixtures("no_hard_links")
def test_writes_without_hard_links(tmp_path):
    write_text(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").read_text() == "new"
    assert listing(tmp_path) == ["a.txt"]


@pytest.mark.usefixtures("no_hard_links")
def test_failed_rename_removes_the_reservation(tmp_path, monkeypatch):
    def refuse(source, destination):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="Input/output"):
        write_text(tmp_path / "a.txt", "new")
    assert listing(tmp_path) == []


def test_full_disk_at_the_rename_is_an_error(tmp_path, monkeypatch):
    def refuse(source, destination):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(OSError, match="No space left"):
        write_text(tmp_path / "a.txt", "new")
    assert listing(tmp_path) == []


def test_one_of_many_writers_wins(tmp_path):
    path = tmp_path / "result.txt"
    barrier = threading.Barrier(8)
    won = []

    def write(name):
        try:
            with atomic_write(path) as temporary:
                temporary.write_text(name)
                barrier.wait()
        except FileExistsError:
            return
        won.append(name)

    threads = [threading.Thread(target=write, args=(f"writer {i}",)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert won == [path.read_text()]
    assert listing(tmp_path) == ["result.txt"]


def test_new_file_has_the_permissions_of_the_umask(tmp_path, umask):
    write_text(tmp_path / "a.txt", "new")
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o666 & ~umask


def test_overwritten_file_keeps_its_permissions(tmp_path, umask):
    path = tmp_path / "a.txt"
    path.write_text("private")
    path.chmod(0o600)
    with atomic_write(path, overwrite=True) as temporary:
        assert stat.S_IMODE(temporary.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_symbolic_link_stays_and_its_file_is_written(tmp_path):
    (tmp_path / "real").mkdir()
    target = tmp_path / "real" / "a.txt"
    link = tmp_path / "link.txt"
    link.symlink_to(target)
    write_text(link, "first")
    write_text(link, "second", overwrite=True)
    assert link.is_symlink()
    assert target.read_text() == "second"
    assert listing(tmp_path / "real") == ["a.txt"]


@pytest.mark.parametrize(
    ("place", "failure", "message"),
    [
        ("nowhere/a.txt", FileNotFoundError, "nowhere' does not exist; make it first"),
        ("file/a.txt", NotADirectoryError, "file' is not a folder"),
        ("folder", IsADirectoryError, "folder' is a folder"),
    ],
)
def test_bad_places_are_named(tmp_path, place, failure, message):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(failure, match=message):
        write_text(tmp_path / place, "x", overwrite=True)
    assert listing(tmp_path) == ["file", "folder"]


def test_text_is_utf8_with_its_own_line_ends(tmp_path):
    write_text(tmp_path / "a.txt", "κ₁\n\r\nend")
    assert (tmp_path / "a.txt").read_bytes() == "κ₁\n\r\nend".encode()


def test_longest_names_are_writable(tmp_path):
    path = tmp_path / ("n" * 251 + ".txt")
    write_text(path, "x")
    assert listing(tmp_path) == [path.name]


def test_relative_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_text("a.txt", "x")
    assert Path("a.txt").read_text() == "x"


@pytest.mark.parametrize("size", [0, 1, 1_000_003])
def test_sha256(tmp_path, size):
    data = bytes(range(256)) * (size // 256 + 1)
    (tmp_path / "data").write_bytes(data[:size])
    assert file_sha256(tmp_path / "data") == hashlib.sha256(data[:size]).hexdigest()


def test_sha256_of_nothing_written(tmp_path):
    with pytest.raises(FileNotFoundError):
        file_sha256(tmp_path / "none")
