"""cameras.txt and cameras.bin, against pycolmap."""

import numpy as np
import pycolmap
import pytest

import jaxlens as jl
from jaxlens.calibrations import Calibration, CalibrationError, read, write
from jaxlens.calibrations._colmap import _MODELS

FORMATS = {"colmap": "cameras.txt", "colmap-binary": "cameras.bin"}
# Coefficients that every model makes a lens of.
REST = {"FOV": [0.9], "EUCM": [0.6, 1.1], "SIMPLE_DIVISION": [-0.2], "DIVISION": [-0.2]}
KNOWN = [model for model in _MODELS if model.family in jl.lenses.registered()]


def numbers(model):
    if model.name == "EQUIRECTANGULAR":
        return [640.0, 480.0]
    focal = [500.0, 510.0][: model.focal_lengths]
    rest = REST.get(model.name, [0.01 * (-1) ** n / (n + 1) for n in range(model.terms)])
    return [*focal, 321.25, 240.75, *rest]


def theirs(folder, models):
    """Writes a reconstruction with a camera of each model."""
    reconstruction = pycolmap.Reconstruction()
    for index, model in enumerate(models):
        camera = pycolmap.Camera(model=model.name, width=640, height=480, params=numbers(model), camera_id=index + 3)
        reconstruction.add_camera(camera)
    reconstruction.write_text(str(folder))
    reconstruction.write_binary(str(folder))
    return reconstruction


@pytest.mark.parametrize("format", FORMATS)
def test_every_model_comes_and_goes(tmp_path, format):
    reconstruction = theirs(tmp_path, KNOWN)
    path = tmp_path / FORMATS[format]
    found = read(path)
    by_name = {one.name: one for one in found}
    for index, model in enumerate(KNOWN):
        one = by_name[str(index + 3)]
        assert (one.model, one.image_size, one.format) == (model.family, (640, 480), format)
        if model.name != "EQUIRECTANGULAR":
            assert one.center == (320.75, 240.25)
            assert one.scale == (500.0, 510.0 if model.focal_lengths == 2 else 500.0)
    write(path, found, format=format, overwrite=True)
    again = pycolmap.Reconstruction()
    again.read(str(tmp_path)) if format == "colmap-binary" else again.read_text(str(tmp_path))
    assert len(again.cameras) == len(KNOWN)
    for number, camera in reconstruction.cameras.items():
        assert again.cameras[number].model == camera.model
        assert again.cameras[number].params.tolist() == camera.params.tolist()
    assert read(path) == found


QUICK = {"OPENCV", "SIMPLE_DIVISION", "EQUIRECTANGULAR"}


@pytest.mark.parametrize(
    "model", [pytest.param(one, id=one.name, marks=[] if one.name in QUICK else pytest.mark.slow) for one in KNOWN]
)
def test_projections_agree(tmp_path, x64, model):
    camera = theirs(tmp_path, [model]).cameras[3]
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1.5], (20, 3))
    expected = camera.img_from_cam(points) - 0.5
    ours = read(tmp_path / "cameras.txt")[0].camera().project(points)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-9)


def test_centres_are_half_a_pixel_apart(tmp_path):
    path = tmp_path / "cameras.txt"
    path.write_text("1 SIMPLE_PINHOLE 800 600 500 400 300\n")
    assert read(path)[0].center == (399.5, 299.5)


def test_the_simplest_model_is_written(tmp_path):
    path = tmp_path / "cameras.txt"
    frame, size = ((399.5, 299.5), (500.0, 500.0)), (800, 600)
    origin = ("center", (0.0, 0.0))
    cameras = [
        Calibration("Perspective", (), *frame, size),
        Calibration("RadialPolynomial", (("coefficients", (0.1,)), origin), *frame, size, name="left"),
        Calibration("RadialPolynomial", (("coefficients", (0.1,)), origin), (9.5, 9.5), (5.0, 6.0), size),
        Calibration("Division", (("k", (0.25,)), origin), *frame, size),
        Calibration("KannalaBrandt", (("coefficients", (0.1, 0.2, 0.0)),), *frame, size),
    ]
    write(path, cameras, format="colmap")
    assert path.read_text().splitlines()[3:] == [
        "1 SIMPLE_PINHOLE 800 600 500.0 400.0 300.0",
        "2 SIMPLE_RADIAL 800 600 500.0 400.0 300.0 0.1",
        "3 OPENCV 800 600 5.0 6.0 10.0 10.0 0.1 0.0 0.0 0.0",
        "4 SIMPLE_DIVISION 800 600 500.0 400.0 300.0 -0.25",
        "5 RADIAL_FISHEYE 800 600 500.0 400.0 300.0 0.1 0.2",
    ]
    moved = Calibration("Division", (("center", (0.1, 0.0)), ("k", 0.25)), *frame, size)
    with pytest.raises(CalibrationError, match=r"COLMAP holds Perspective, .*not this Division"):
        write(path, moved, format="colmap", overwrite=True)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 THIN 800 600 500 400 300", "line 2: there is no model 'THIN'; there are SIMPLE_PINHOLE"),
        ("1 PINHOLE 800 600 500 400 300", "line 2, PINHOLE.parameters: must be 4 numbers, got 3"),
        ("1 PINHOLE 800 600 500 x 400 300", "line 2: 'x' is no number"),
        ("1 PINHOLE 800 600 500 nan 400 300", r"parameters\[1\]: must be a finite number of usual size, got nan"),
        ("1 PINHOLE 0 600 500 500 400 300", "width: must be larger than 0"),
        ("1 EUCM 800 600 500 500 400 300 1.5 1", "alpha: must be between 0 and 1, got 1.5"),
        ("1 PINHOLE 80 60 5 5 4 3\n1 PINHOLE 80 60 5 5 4 3", "two of its cameras have one number"),
        ("", "there is no camera in it"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, line, message):
    path = tmp_path / "cameras.txt"
    path.write_text("# Camera list with one line of data per camera:\n" + line)
    with pytest.raises(CalibrationError, match=message):
        read(path)


def test_binary_files_that_end_early(tmp_path):
    theirs(tmp_path, KNOWN[:2])
    path = tmp_path / "cameras.bin"
    data = path.read_bytes()
    for cut, message in ((-8, "camera 2 of 2, byte 56: the file ends within it"), (60, "the file ends before it")):
        path.write_bytes(data[:cut])
        with pytest.raises(CalibrationError, match=message):
            read(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(CalibrationError, match="1 bytes follow the 2 cameras"):
        read(path)
