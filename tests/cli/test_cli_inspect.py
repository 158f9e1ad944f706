"""`jaxlens inspect`: a camera in numbers and drawn, and how two cameras differ."""

import math
import re

import numpy as np
import pytest

import jaxlens as jl
from jaxlens.calibrations import Calibration, Estimate, write_calibration
from jaxlens.lenses import Equidistant, RadialPolynomial

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

SIZE = (64, 48)
SCALE = 40.0
# r (1 − 0.3 r²) grows up to r = 1/√0.9, to two thirds of it.
KAPPA = -0.3
FOLD = 1 / math.sqrt(0.9)


def _write(path, lens, *, size=SIZE, center=(31.5, 23.5), scale=SCALE, estimate=None):
    plain = Calibration.from_lens(lens, frame=jl.Frame(center, scale), image_size=size)
    write_calibration(path, Calibration(plain.model, plain.parameters, plain.center, plain.scale, size, estimate))
    return path


@pytest.fixture(scope="module")
def camera(tmp_path_factory):
    """A barrel lens that folds before the picture's corners, with what a fit knows of it."""
    covariance = ((4e-6, 0.0), (0.0, 0.25))
    estimate = Estimate(("kappa1", "fx"), (KAPPA, SCALE), covariance, 0.1, 90)
    return _write(tmp_path_factory.mktemp("inspect") / "camera.json", RadialPolynomial([KAPPA]), estimate=estimate)


def test_one_camera(run, camera, tmp_path):
    figure = tmp_path / "figure.png"
    result = run("inspect", camera, "--output", figure)
    assert result.code == 0, result.err
    facts = dict(re.split(r"  +", line, maxsplit=1) for line in result.out.splitlines() if not line.startswith(" "))
    assert facts["model"] == "RadialPolynomial"
    assert "kappa1 = -0.3 ± 0.002" in result.out
    assert facts["focal length"] == "fx = 40 ± 0.5, fy = 40 pixels"
    assert facts["picture"] == "64 × 48 pixels"
    angle = math.degrees(math.atan(FOLD))
    assert f"to {angle:.2f}°" in facts["lens sees"]
    edge = 2 / 3 * FOLD * SCALE
    assert f"{angle:.2f}° from the axis, {edge:.1f} pixels from the principal point" in facts["fold"]
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    blind = np.hypot(x - 31.5, y - 23.5) > edge
    assert facts["inverse"] == f"{blind.mean():.3%} of the pixels have no ray"
    # The vertical: r (1 − 0.3 r²) = 24/40, by its roots.
    ideal = min(root.real for root in np.roots([KAPPA, 0, 1, -24 / SCALE]) if root.real > 0)
    vertical, horizontal = 2 * math.degrees(math.atan(ideal)), 2 * angle
    assert f"vertical {vertical:.2f}°" in facts["field of view"]
    found = re.match(r"horizontal ([\d.]+)° as far as seen", facts["field of view"])
    assert found is not None
    # Next to the fold a step of a sixteenth of a pixel is some degrees.
    assert 0.9 * horizontal < float(found[1]) <= horizontal
    moved = np.where(blind, 0, [[_moved(radius) for radius in row] for row in np.hypot(x - 31.5, y - 23.5)])
    largest = re.match(r"at most ([\d.]+) pixels", facts["displacement"])
    assert largest is not None
    assert float(largest[1]) == pytest.approx(moved.max(), rel=1e-3)
    assert figure.stat().st_size > 10_000


def _moved(radius):
    """How far the lens moves what it shows at a radius, in pixels."""
    roots = [root.real for root in np.roots([KAPPA, 0, 1, -radius / SCALE]) if abs(root.imag) < 1e-9 and root.real > 0]
    return SCALE * min(roots, default=0) - radius


def test_two_cameras(run, tmp_path):
    one = _write(tmp_path / "one.json", Equidistant())
    # Resized to the first, it is the first.
    same = _write(tmp_path / "same.json", Equidistant(), size=(128, 96), center=(63.5, 47.5), scale=2 * SCALE)
    shifted = _write(tmp_path / "shifted.json", Equidistant(), center=(32.5, 23.5))
    result = run("inspect", one, shifted, "--no-rotation")
    assert result.code == 0, result.err
    assert re.search(
        r"difference +RMS 1 pixels, at most 1 pixels, at \(.*\)\n +as they are, neither turned", result.out
    )
    figure = tmp_path / "figure.svg"
    result = run("inspect", one, shifted, "--output", figure)
    found = re.search(
        r"RMS ([\d.e-]+) pixels, at most ([\d.e-]+) .*\n +after turning the second by ([\d.]+)°", result.out
    )
    assert found is not None, result.out
    rms, largest, turn = map(float, found.groups())
    assert 0 < rms < largest < 0.5
    assert turn == pytest.approx(math.degrees(1 / SCALE), rel=0.1)
    assert b"<svg" in figure.read_bytes()
    result = run("inspect", one, same)
    found = re.search(r"RMS ([\d.e-]+) pixels", result.out)
    assert found is not None, result.out
    assert float(found[1]) < 1e-9


@pytest.mark.slow
def test_a_lens_in_half_diagonals_has_no_angles(run, tmp_path):
    bare = tmp_path / "bare.json"
    write_calibration(bare, Calibration.from_lens(RadialPolynomial([KAPPA])))
    result = run("inspect", bare)
    assert (result.code, "pass --image-size WIDTHxHEIGHT" in result.err) == (2, True)
    result = run("inspect", bare, "--image-size", "64x48")
    assert (result.code, "has no frame: Eq. 10's is taken" in result.err) == (0, True)
    assert "half diagonal  fx = 40, fy = 40 pixels" in result.out
    assert "°" not in result.out
    fisheye = tmp_path / "fisheye.json"
    write_calibration(fisheye, Calibration.from_lens(Equidistant()))
    result = run("inspect", fisheye, "--image-size", "64x48")
    assert (result.code, "has no frame, and Equidistant is written in a camera's" in result.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["missing.json"], "there is no file 'missing.json'"),
        (["broken.json"], "'broken.json' is no calibration"),
        (["camera.json", "broken.json"], "'broken.json' is no calibration"),
        (["camera.json", "wide.json"], "'wide.json': the calibration is for pictures of 64 × 36 pixels"),
        (["camera.json", "--image-size", "64x36"], "'camera.json': the calibration is for pictures of 64 × 48 pixels"),
        (["camera.json", "--image-size", "64"], "--image-size is two counts"),
        (["camera.json", "--no-rotation"], "--no-rotation is for two cameras"),
        (["camera.json", "--output", "taken.png"], "'taken.png' exists; pass --overwrite to replace it"),
        (["camera.json", "--output", "figure.jpg"], "must end in .png or .svg or .pdf"),
    ],
)
def test_wrong_arguments(run, camera, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "camera.json").write_bytes(camera.read_bytes())
    (tmp_path / "broken.json").write_text('{"format": ')
    (tmp_path / "taken.png").write_bytes(b"mine")
    _write(tmp_path / "wide.json", RadialPolynomial([KAPPA]), size=(64, 36))
    result = run("inspect", *words)
    assert (result.code, message in result.err, result.out) == (2, True, ""), result.err
    assert (tmp_path / "taken.png").read_bytes() == b"mine"
    assert not (tmp_path / "figure.jpg").exists()
