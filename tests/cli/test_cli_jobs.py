import os
from pathlib import Path

import pytest

from jaxlens.cli.jobs import plan_jobs
from jaxlens.cli.messages import UsageError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pictures = ("a.png", "b.JPG", "photos/a.png", "photos/c.gif", "photos/.hidden.png", "photos/deep/d.png")
    for name in (*pictures, "notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"?")
    return tmp_path


def plan(inputs, output):
    return [(str(job.source), str(job.target)) for job in plan_jobs(tuple(map(Path, inputs)), output)]


@pytest.mark.parametrize(
    ("inputs", "output", "expected"),
    [
        (["a.png"], "out.tif", [("a.png", "out.tif")]),
        (["a.png"], "photos", [("a.png", "photos/a.png")]),
        (["a.png"], "new/", [("a.png", "new/a.png")]),
        (["a.png", "b.JPG"], "new", [("a.png", "new/a.png"), ("b.JPG", "new/b.JPG")]),
        (["photos"], "new", [("photos/a.png", "new/a.png"), ("photos/c.gif", "new/c.png")]),
        (["photos/c.gif", "photos"], "new", [("photos/c.gif", "new/c.png"), ("photos/a.png", "new/a.png")]),
        (["notes.txt"], "new/", [("notes.txt", "new/notes.png")]),
        (["photos/../a.png", "a.png"], "new", [("photos/../a.png", "new/a.png")]),
        # Of several, a missing one fails when its turn comes, and the others are done.
        (["a.png", "no.png"], "new", [("a.png", "new/a.png"), ("no.png", "new/no.png")]),
        (["a.png", "b.JPG"], "new.png/", [("a.png", "new.png/a.png"), ("b.JPG", "new.png/b.JPG")]),
    ],
)
def test_outputs(folder, inputs, output, expected):
    assert plan(inputs, output) == [(source, target.replace("/", os.sep)) for source, target in expected]


@pytest.mark.parametrize(
    ("inputs", "output", "message"),
    [
        (["no.png"], "out.png", "there is no file 'no.png'"),
        (["a.png/b.png"], "new/", "'a.png/b.png'"),
        (["a.png"], "out.gif", "'.gif'"),
        (["a.png"], "out", "suffix ''"),
        (["a.png"], "no/out.png", "there is no folder 'no'"),
        (["a.png", "b.JPG"], "no/new", "there is no folder 'no'"),
        (["a.png", "b.JPG"], "new.png", "named like a file"),
        (["photos"], "new.png", "named like a file"),
        (["a.png", "b.JPG"], "notes.txt", "'notes.txt' is to be a folder"),
        (["a.png"], "notes.txt/", "'notes.txt/?' is to be a folder"),
        (["photos/deep/d.png", "photos/deep"], "a.png", "'a.png' is to be a folder"),
        (["a.png", "photos"], "new", "'a.png' and 'photos/a.png' would both be written to 'new/a.png'"),
    ],
)
def test_refusals(folder, inputs, output, message):
    with pytest.raises(UsageError, match=message):
        plan(inputs, output)
    assert not (folder / "new").exists()


def test_an_empty_folder(folder):
    (folder / "empty").mkdir()
    with pytest.raises(UsageError, match="there is no picture in the folder 'empty'"):
        plan(["empty"], "new")


def test_pictures_that_are_not_read_are_named(folder, capsys):
    """HEIF and raw files are what phones and cameras write: they are not left out unsaid."""
    for name in ("photos/a.HEIC", "photos/c.dng", "photos/notes.txt"):
        (folder / name).write_bytes(b"?")
    expected = {name for name, _ in plan(["photos"], "new")}
    said = capsys.readouterr().err
    assert not any(name.endswith((".HEIC", ".dng")) for name in expected)
    for name, remedy in (("a.HEIC", "pillow-heif"), ("c.dng", "rawpy")):
        assert any(name in line and remedy in line for line in said.splitlines())
    assert "notes.txt" not in said


def test_names_that_differ_in_case_only(folder):
    (folder / "photos" / "A.PNG").write_bytes(b"?")
    with pytest.raises(UsageError, match="would both be written"):
        plan(["photos"], "new")


def test_a_target_is_a_name_in_its_folder(folder):
    (folder / "..png").write_bytes(b"?")
    for source, target in plan(["..png", "photos/deep/../a.png", str(folder / "b.JPG")], "new"):
        assert os.path.dirname(os.path.normpath(target)) == "new", source
