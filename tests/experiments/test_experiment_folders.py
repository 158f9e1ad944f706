import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from jaxlens.experiments import ExperimentError, abandoned
from jaxlens.experiments.folders import MANIFEST, MARKER, result_folder


def write(target: Path, name: str = "tiny", text: str = "new", extra: tuple[str, ...] = ()) -> None:
    with result_folder(target, name) as temporary:
        for file in ("table.csv", *extra):
            (temporary / file).write_text(text)
        files = {"table.csv": "", **dict.fromkeys(extra, "")}
        manifest = {"tool": MARKER, "experiment": name, "files": files}
        (temporary / MANIFEST).write_text(json.dumps(manifest))


def test_a_folder_appears_with_its_parents_and_replaces_its_earlier_self(tmp_path: Path):
    target = tmp_path / "results" / "tiny"
    write(target, text="old", extra=("old.png",))
    write(target)
    assert sorted(path.name for path in target.iterdir()) == [MANIFEST, "table.csv"]
    assert (target / "table.csv").read_text() == "new"
    assert [path.name for path in target.parent.iterdir()] == ["tiny"]


def test_an_empty_folder_is_taken(tmp_path: Path):
    (tmp_path / "tiny").mkdir()
    write(tmp_path / "tiny")
    assert (tmp_path / "tiny" / "table.csv").exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit])
def test_an_interrupted_run_leaves_the_old_results_and_nothing_else(tmp_path: Path, error: type[BaseException]):
    target = tmp_path / "tiny"
    write(target, text="old")
    with pytest.raises(error), result_folder(target, "tiny") as temporary:  # noqa: PT012
        (temporary / "table.csv").write_text("half")
        raise error
    assert (target / "table.csv").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["tiny"]


def test_a_failed_first_run_leaves_no_parents(tmp_path: Path):
    with pytest.raises(ValueError, match="no"), result_folder(tmp_path / "a" / "b" / "tiny", "tiny"):
        raise ValueError("no")
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, signal, sys
from pathlib import Path
from jaxlens.experiments.folders import result_folder
with result_folder(Path(sys.argv[1]), "tiny") as temporary:
    (temporary / "table.csv").write_text("half")
    print(temporary.name, flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path: Path):
    target = tmp_path / "tiny"
    write(target, text="old")
    pipe = subprocess.PIPE
    other = subprocess.Popen([sys.executable, "-c", KILLED, str(target)], stdin=pipe, stdout=pipe, text=True)
    with other:
        assert other.stdout is not None
        left = tmp_path / other.stdout.readline().strip()
        mine = [".tiny.notes", ".tiny.0123456", ".tinier.01234567"]
        for name in mine:
            (tmp_path / name).mkdir()
        (tmp_path / f"{left.name}.old").mkdir()
        # Somebody is still at work there.
        write(target, text="new")
        assert (left / "table.csv").read_text() == "half"
        other.kill()
    assert left.is_dir()
    write(target, text="newer")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["tiny", *mine])
    assert (target / "table.csv").read_text() == "newer"


def test_nothing_is_taken_for_abandoned_where_folders_cannot_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(abandoned, "fcntl", None)
    (tmp_path / ".tiny.01234567").mkdir()
    write(tmp_path / "tiny")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".tiny.01234567", "tiny"]


def refused(target: Path, *said: str) -> None:
    before = {path: path.read_bytes() for path in target.rglob("*") if path.is_file()} if target.is_dir() else None
    with pytest.raises(ExperimentError) as caught:
        write(target)
    for part in (repr(str(target)), *said):
        assert part in str(caught.value)
    if before is not None:
        assert {path: path.read_bytes() for path in target.rglob("*") if path.is_file()} == before


def test_other_folders_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    target = tmp_path / "tiny"
    target.write_text("a file")
    refused(target, "not a folder")
    target.unlink()
    target.mkdir()
    (target / "thesis.tex").write_text("years of work")
    refused(target, "no experiment wrote", "'thesis.tex'")
    (target / MANIFEST).write_text('{"tool": "another"}')
    refused(target, "no experiment wrote")
    (target / MANIFEST).write_text("{")
    refused(target, "no experiment wrote")


def test_own_folders_with_something_added_are_refused(tmp_path: Path):
    target = tmp_path / "tiny"
    write(target)
    (target / "notes.txt").write_text("mine")
    refused(target, "does not list", "'notes.txt'")
    (target / "notes.txt").unlink()
    (target / "table.csv").unlink()
    (target / "table.csv").mkdir()
    refused(target, "does not list", "'table.csv'")


def test_results_of_another_experiment_are_refused(tmp_path: Path):
    write(tmp_path / "tiny", name="other")
    refused(tmp_path / "tiny", "'other'", "not 'tiny'")


def test_the_current_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    refused(tmp_path, "current folder")


def test_what_appears_during_the_run_is_not_overwritten(tmp_path: Path):
    target = tmp_path / "tiny"
    with pytest.raises(ExperimentError, match=r"thesis\.tex"), result_folder(target, "tiny"):  # noqa: PT012
        target.mkdir()
        (target / "thesis.tex").write_text("years of work")
    assert [path.name for path in tmp_path.iterdir()] == ["tiny"]
    assert (target / "thesis.tex").exists()


def test_a_link_is_followed(tmp_path: Path):
    (tmp_path / "far").mkdir()
    (tmp_path / "tiny").symlink_to(tmp_path / "far")
    write(tmp_path / "tiny")
    assert (tmp_path / "tiny").is_symlink()
    assert (tmp_path / "far" / "table.csv").exists()
