from pathlib import Path

import numpy as np
import PIL.Image
import pytest

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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with a small picture and a sweep over it."""
    y, x = np.mgrid[:20, :24]
    pixels = (110 + 60 * np.sin(x / 3) * np.cos(y / 4) + 2 * x).astype(np.uint8)
    PIL.Image.fromarray(np.stack([pixels, pixels[::-1], pixels // 2], axis=-1)).save(tmp_path / "tiny.png")
    (tmp_path / "tiny.toml").write_text(SWEEP, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path
