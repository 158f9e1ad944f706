import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from pictures import smooth

from jaxlens import images
from jaxlens.cli import main

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


@pytest.fixture
def picture(tmp_path):
    """An 8-bit RGB picture, alone in a folder."""
    path = tmp_path / "in" / "picture.png"
    path.parent.mkdir()
    images.write(path, smooth())
    return path
