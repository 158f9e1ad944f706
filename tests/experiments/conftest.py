import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from paper_kinds import copy_kinds
from rich.console import Console

from jaxlens.experiments import Report, run

SWEEP = """
kind = "sweep"
name = "tiny"
compare = "table1"

[image]
path = "tiny.png"
peak = 193.0

[lenses]
kappa = [[0, 1], [1, 2], [1, 3], [2, 3], [3, 2], [3, 1]]
"""


def make_sweep(folder: Path) -> Path:
    """Writes a small picture and a sweep over it; returns the sweep's file."""
    y, x = np.mgrid[:20, :24]
    pixels = (110 + 60 * np.sin(x / 3) * np.cos(y / 4) + 2 * x).astype(np.uint8)
    PIL.Image.fromarray(np.stack([pixels, pixels[::-1], pixels // 2], axis=-1)).save(folder / "tiny.png")
    (folder / "tiny.toml").write_text(SWEEP, encoding="utf-8")
    return folder / "tiny.toml"


@pytest.fixture
def kinds(tmp_path: Path) -> None:
    """Puts the kinds of `experiments` into the folder of a test."""
    copy_kinds(tmp_path)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with a small picture and a sweep over it."""
    make_sweep(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@dataclass(frozen=True)
class Run:
    """A finished run, and what it printed."""

    config: Path
    report: Report
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The small sweep, run once. Tests leave its folder as it is."""
    folder = tmp_path_factory.mktemp("first")
    path = make_sweep(folder)
    stdout, stderr = io.StringIO(), io.StringIO()
    consoles = {"console": Console(file=stdout, width=100), "progress": Console(file=stderr, width=100)}
    report = run(path, output=folder / "results" / "tiny", **consoles)
    return Run(path, report, stdout.getvalue(), stderr.getvalue())
