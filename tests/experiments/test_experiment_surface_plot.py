"""Figures 1 and 8 as an experiment, and the face that it draws."""

from pathlib import Path

import numpy as np
import pytest

from jaxlens.experiments import ConfigError, config, run
from jaxlens.experiments.sources import load_source

pytestmark = pytest.mark.usefixtures("kinds")


TEXT = """
kind = "surface_plot"
name = "s"
dtype = "%s"
smoothing = 1.5
[image]
source = "face"
height = 24
width = 20
peak = 193.0
"""


def _write(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_folder_and_that_smoothing_flattens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    path = _write(tmp_path, TEXT % "float64")
    first = run(path, output="one", quiet=True)
    second = run(path, output="two", quiet=True)
    assert [file.name for file in first.files] == ["manifest.json", "run.json", "surface.jpg", "table.csv"]
    for one, two in zip(first.files, second.files, strict=True):
        assert one.name == "run.json" or one.read_bytes() == two.read_bytes()
    header, raw, smooth = [line.split(",") for line in Path("one/table.csv").read_text().splitlines()]
    greatest, mean, steepest = (header.index(name) for name in ("greatest", "mean", "steepest_per_px"))
    assert float(raw[greatest]) == 193.0
    # The picture's edge is mirrored, so that no light is lost.
    assert float(smooth[mean]) == pytest.approx(float(raw[mean]), rel=1e-8)
    assert float(smooth[steepest]) < 0.5 * float(raw[steepest])


def test_smoothing_is_scipys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    ndimage = pytest.importorskip("scipy.ndimage")
    monkeypatch.chdir(tmp_path)
    path = _write(tmp_path, TEXT % "float64")
    pixels = load_source(config.load(path), config.load(path).experiment.image).pixels
    expected = ndimage.gaussian_filter(pixels, 1.5, mode="reflect", truncate=4.0)
    run(path, output="one", quiet=True)
    row = Path("one/table.csv").read_text().splitlines()[2].split(",")
    np.testing.assert_allclose([float(row[2]), float(row[4])], [expected.max(), expected.std()], rtol=1e-6)


def test_the_face_is_the_same_in_either_precision_and_lit_from_the_upper_left(tmp_path: Path):
    facts = []
    for dtype in ("float32", "float64"):
        configuration = config.load(_write(tmp_path, TEXT % dtype))
        source = load_source(configuration, configuration.experiment.image)
        assert source.pixels.shape == (24, 20)
        assert source.pixels.dtype == dtype
        assert (source.pixels.min(), source.pixels.max()) == (0, 193)
        facts.append(source.facts["pixels_sha256"])
        assert source.pixels[:, :10].sum() > 1.1 * source.pixels[:, 10:].sum()
    assert facts[0] == facts[1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("width = 20\n", "", "source = 'face' is made to measure: it needs 'height' and 'width'"),
        ("smoothing = 1.5", "smoothing = -1", "smoothing"),
        ("smoothing = 1.5", "perspective = 0.7", "perspective"),
        ("smoothing = 1.5", 'drawings = ["lego"]', "'mesh', 'filled' or 'isolines'"),
    ],
)
def test_misuse(tmp_path: Path, old: str, new: str, said: str):
    text = TEXT % "float64"
    assert old in text
    with pytest.raises(ConfigError, match=said):
        config.load(_write(tmp_path, text.replace(old, new)))
