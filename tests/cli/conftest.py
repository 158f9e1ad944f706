import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from jaxlens.cli import main
from jaxlens.images import write_image

ROOT = Path(__file__).parents[2]


@dataclass
class Result:
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys):
    """The command line in this process."""

    def call(*arguments):
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return Result(code, out, err)

    return call


@pytest.fixture
def run_process():
    """The command line as people call it."""

    def call(*arguments, cwd=ROOT):
        command = [sys.executable, "-m", "jaxlens", *map(str, arguments)]
        environment = {"PYTHONPATH": str(ROOT), "PATH": "", "COLUMNS": "100", "PYTHONUTF8": "1"}
        done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=120)
        assert "Traceback" not in done.stderr
        return Result(done.returncode, done.stdout, done.stderr)

    return call


def smooth(dtype=np.uint8, channels=3, height=24, width=32):
    """A picture without noise, and bright: nothing in it is the fill value."""
    y, x = np.mgrid[:height, :width]
    planes = np.stack([0.4 + 0.5 * np.sin(0.2 * x + 0.3 * y + plane) ** 2 for plane in range(channels)], axis=-1)
    full = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    pixels = (planes * full).astype(dtype)
    if channels in (2, 4):
        pixels[..., -1] = full
    return pixels[..., 0] if channels == 1 else pixels


@pytest.fixture
def picture(tmp_path):
    """An 8-bit RGB picture, alone in a folder."""
    path = tmp_path / "in" / "picture.png"
    path.parent.mkdir()
    write_image(path, smooth())
    return path


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*") if path.is_file())
