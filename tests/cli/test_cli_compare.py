import contextlib
import json
import re

import jax
import numpy as np
import pytest
from pictures import smooth

import jaxlens as jl
from jaxlens import images


@pytest.fixture
def pair(tmp_path):
    reference, image = smooth(), smooth()
    image[::2] += 3
    images.write(tmp_path / "reference.png", reference)
    images.write(tmp_path / "image.png", image)
    with jax.enable_x64(True):
        scores = jl.metrics.evaluate(reference, image, data_range=255.0)
        return tmp_path / "reference.png", tmp_path / "image.png", {name: float(x) for name, x in scores.items()}


def refuse_constant(name):
    raise AssertionError(f"{name} is not JSON")


def test_table(run, pair):
    reference, image, scores = pair
    result = run("compare", reference, image)
    assert result.code == 0
    assert result.err == ""
    for name, score in scores.items():
        (line,) = (line for line in result.out.splitlines() if line.split()[:1] == [name])
        assert f"{score:.6g}" in line
    assert "32 × 24, 8-bit RGB, data range 255" in result.out


def test_json(run, pair):
    reference, image, scores = pair
    result = run("compare", reference, image, "--json")
    assert result.code == 0
    assert result.err == ""
    record = json.loads(result.out, parse_constant=refuse_constant)
    assert record["metrics"] == pytest.approx(scores, rel=1e-12)
    assert list(record["metrics"]) == list(scores)
    assert (record["height"], record["width"], record["channels"], record["dtype"]) == (24, 32, 3, "uint8")
    assert record["data_range"] == 255.0
    assert record["reference"] == str(reference)


def test_json_of_numbers_that_json_does_not_have(run, pair, tmp_path):
    reference, _, _ = pair
    record = json.loads(run("compare", reference, reference, "--json").out, parse_constant=refuse_constant)
    assert record["metrics"]["psnr"] == "Infinity"
    assert float(record["metrics"]["psnr"]) == np.inf
    assert record["metrics"]["rmse"] == 0
    images.write(tmp_path / "tiny.png", smooth(height=4, width=4))
    result = run("compare", tmp_path / "tiny.png", tmp_path / "tiny.png", "--json")
    assert json.loads(result.out, parse_constant=refuse_constant)["metrics"]["ssim"] == "NaN"


def test_the_process_itself(run_process, pair):
    reference, image, scores = pair
    result = run_process("compare", reference, image, "--json")
    assert result.code == 0
    assert result.err == ""
    assert json.loads(result.out)["metrics"] == pytest.approx(scores, rel=1e-12)


@pytest.mark.parametrize(
    ("pixels", "suffix", "message"),
    [
        (smooth(height=20), ".png", "32 × 20.*crop or resize"),
        (smooth(channels=4), ".png", "RGBA.*same channels"),
        (smooth(np.uint16), ".png", "16-bit RGB.*same bits"),
        (smooth(np.float32), ".tif", "32-bit float RGB.*same bits"),
    ],
)
def test_pictures_that_are_not_alike(run, pair, tmp_path, pixels, suffix, message):
    other = tmp_path / f"other{suffix}"
    images.write(other, pixels)
    result = run("compare", pair[0], other, "--json")
    assert result.code == 2
    assert re.search(message, result.err)
    assert result.out == ""


def test_a_bar_on_a_terminal(run, pair, monkeypatch):
    done = []
    bar = contextlib.nullcontext(lambda *steps: done.append(steps))
    monkeypatch.setattr("jaxlens.cli.compare.progress_of", lambda description: bar)
    monkeypatch.setattr("jaxlens.metrics._strips._SAMPLES", 32 * 3 * 10)
    assert run("compare", *pair[:2]).code == 0
    assert done == [(10, 24), (20, 24), (24, 24)]


def test_data_range(run, tmp_path):
    for name, offset in (("a.tif", 0.0), ("b.tif", 0.25)):
        images.write(tmp_path / name, smooth(np.float32, 1) + np.float32(offset))
    a, b = tmp_path / "a.tif", tmp_path / "b.tif"
    result = run("compare", a, b)
    assert result.code == 2
    assert "--data-range" in result.err
    metrics = json.loads(run("compare", a, b, "--data-range", "2", "--json").out)["metrics"]
    assert metrics["psnr"] == pytest.approx(20 * np.log10(2 / 0.25), rel=1e-6)
    for wrong in ("0", "-1", "nan", "inf"):
        assert run("compare", a, b, "--data-range", wrong).code == 2


def test_sixteen_bits(run, tmp_path):
    images.write(tmp_path / "a.png", smooth(np.uint16, 1))
    record = json.loads(run("compare", tmp_path / "a.png", tmp_path / "a.png", "--json").out)
    assert record["data_range"] == 65535


def test_broken_input(run, pair, tmp_path):
    (tmp_path / "broken.png").write_bytes(pair[0].read_bytes()[:60])
    result = run("compare", pair[0], tmp_path / "broken.png")
    assert result.code == 1
    assert "broken.png" in result.err
    assert result.out == ""
    result = run("compare", pair[0], tmp_path / "missing.png")
    assert result.code == 2
    assert "missing.png" in result.err
    result = run("compare", tmp_path, pair[1])
    assert result.code == 2
    assert "is a folder" in result.err
    result = run("compare", pair[0], pair[1], "--max-pixels", "10")
    assert result.code == 1
    assert "--max-pixels 10" in result.err
