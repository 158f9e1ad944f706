"""`jaxlens undistort --view`: what is shown, and the camera that is written."""

import json

import jax
import numpy as np
import pytest
from pictures import files_in, smooth

import jaxlens as jl
from jaxlens import images
from jaxlens.calibrations import Calibration, read_calibration, write_calibration

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

FRAME = jl.Frame(np.array([15.0, 12.5]), np.array([25.0, 26.0]))


def calibrated(path, lens, size=(32, 24)):
    write_calibration(path, Calibration.from_lens(lens, frame=FRAME, image_size=size))
    return path


@pytest.fixture
def radial(tmp_path):
    return calibrated(tmp_path / "camera.json", jl.RadialPolynomial(np.array([-0.2, 0.05])))


@pytest.fixture
def fisheye(tmp_path):
    return calibrated(tmp_path / "fisheye.json", jl.KannalaBrandt(np.array([0.05, -0.01])))


def expected(camera_file, **view):
    with jax.enable_x64(True):
        source = read_calibration(camera_file).camera()
        target = source.view(**view)
    with jax.enable_x64(False):
        one, other = (jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), camera) for camera in (source, target))
        return np.asarray(jl.reproject(smooth(), one, other)), source, target


def assert_alike(pixels, wanted):
    assert pixels.shape == wanted.shape
    assert np.abs(pixels.astype(int) - wanted.astype(int)).max() <= 1


@pytest.mark.parametrize(
    ("words", "view"),
    [
        (["--view", "valid"], {"keep": "valid"}),
        (["--view", "all", "--size", "40x30"], {"keep": "all", "size": (40, 30)}),
        (["--projection", "cylindrical", "--fov", "90"], {"projection": "cylindrical", "fov": 90.0}),
    ],
)
def test_what_is_shown_and_its_camera(run, picture, radial, tmp_path, words, view):
    output, camera = tmp_path / "out.png", tmp_path / "new.json"
    result = run("undistort", picture, "--lens", radial, *words, "-o", output, "--camera-output", camera)
    assert result.code == 0, result.err
    pixels, source, target = expected(radial, **view)
    assert_alike(images.read(output).pixels, pixels)
    with jax.enable_x64(True):
        written = read_calibration(camera).camera()
        assert (written.width, written.height) == (target.width, target.height)
        # A point of space falls on its place in the picture: where what the source saw of it was sent.
        points = np.array([[0.1, -0.2, 1.0], [-0.4, 0.3, 2.0]])
        sent = source.transfer(source.project(points), target)
        np.testing.assert_allclose(written.project(points), sent, rtol=0, atol=1e-9)


def test_the_camera_of_a_crop(run, picture, radial, tmp_path):
    output, camera = tmp_path / "out.png", tmp_path / "new.json"
    words = ["--lens", radial, "--view", "all", "-o", output]
    assert run("undistort", picture, *words, "--crop", "--camera-output", camera).code == 0
    cropped = images.read(output).pixels
    whole, _, target = expected(radial, keep="all")
    with jax.enable_x64(True):
        written = read_calibration(camera).camera()
    assert (written.height, written.width) == cropped.shape[:2]
    left, top = (round(shift) for shift in (target.frame.center - written.frame.center).tolist())
    assert (top, left) != (0, 0)
    assert_alike(cropped, whole[top : top + written.height, left : left + written.width])


@pytest.mark.slow
def test_a_panorama_of_a_fisheye(run, picture, fisheye, tmp_path):
    output = tmp_path / "out.png"
    words = ["--projection", "equirectangular", "--fov", "180", "--size", "64x32"]
    result = run("undistort", picture, "--lens", fisheye, *words, "-o", output)
    assert result.code == 0
    assert "does not see all" not in result.err
    view = {"projection": "equirectangular", "fov": 180.0, "size": (64, 32)}
    assert_alike(images.read(output).pixels, expected(fisheye, **view)[0])
    words[3] = "360"
    result = run("undistort", picture, "--lens", fisheye, *words, "-o", output, "--overwrite")
    assert "does not see all of the view" in result.err


@pytest.mark.slow
def test_a_view_of_a_large_picture_goes_in_strips(run, picture, radial, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxlens.images.warping._STRIP_PIXELS", 200)
    monkeypatch.setattr("jaxlens.images.warping._STRIP_ROWS", 3)
    output = tmp_path / "out.png"
    assert run("undistort", picture, "--lens", radial, "--view", "valid", "-o", output).code == 0
    assert_alike(images.read(output).pixels, expected(radial, keep="valid")[0])


def test_a_folder_has_one_camera(run, picture, radial, tmp_path):
    images.write(picture.with_name("second.png"), smooth()[::-1].copy())
    images.write(picture.with_name("third.png"), np.repeat(np.repeat(smooth(), 2, axis=0), 2, axis=1))
    camera = tmp_path / "new.json"
    words = ["--lens", radial, "--view", "valid", "-o", tmp_path / "out", "--camera-output", camera]
    result = run("undistort", picture.parent, *words)
    assert result.code == 1
    assert "'third.png' has a camera other than" in result.err.replace(str(picture.parent) + "/", "")
    assert files_in(tmp_path / "out") == ["picture.png", "second.png"]
    assert json.loads(camera.read_text())["image_size"] == [32, 24]
    # What exists is not replaced unasked, and nothing is begun.
    again = run("undistort", picture, *words)
    assert again.code == 2
    assert "--camera-output" in again.err
    assert "pass --overwrite" in again.err
    picture.write_bytes(b"no picture")
    camera.unlink()
    result = run("undistort", picture, *words[:-4], "-o", tmp_path / "one.png", "--camera-output", camera)
    assert result.code == 1
    assert not camera.exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--view", "most"], 2, "same"),
        (["--view", "all", "--fov", "90"], 2, "--view 'all' and --fov 90.0 are two ways"),
        (["--fov", "180"], 2, "--projection 'equirectangular' shows up to 360"),
        (["--fov", "nan", "--projection", "cylindrical"], 2, "above 0 and at most 360"),
        (["--size", "64"], 2, "--size is two counts"),
        (["--size", "0x5"], 2, "--size is two counts"),
        (["--camera-output", "new.txt"], 2, "must end in .json"),
        (["--camera-output", "nowhere/new.json"], 2, "there is no folder 'nowhere'"),
        (["--view", "all"], 1, "take --projection 'equirectangular'"),
    ],
)
def test_misuse(run, picture, tmp_path, words, code, message):
    lens = calibrated(tmp_path / "wide.json", jl.KannalaBrandt(np.array([0.05, -0.01])), size=(128, 96))
    result = run("undistort", picture, "--lens", lens, *words, "-o", tmp_path / "out.png")
    assert result.code == code
    assert message in " ".join(result.err.replace("│", " ").split())
    assert not (tmp_path / "out.png").exists()
