"""transforms.json of nerfstudio and instant-ngp."""

import json
import math

import pytest

from jaxlens.calibrations import Calibration, CalibrationError, read, write

SHARED = {
    "camera_model": "OPENCV",
    "fl_x": 500.0,
    "fl_y": 510,
    "cx": 400,
    "cy": 300.0,
    "w": 800,
    "h": 600,
    "k1": 0.1,
    "k2": 0.2,
    "p1": 0.3,
    "p2": 0.4,
}
FRAME = {"file_path": "images/1.png", "transform_matrix": [[1, 0, 0, 0]] * 4}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "transforms.json"


def test_one_camera(path):
    path.write_text(json.dumps(SHARED | {"frames": [FRAME]}))
    coefficients = (0.1, 0.2, 0.3, 0.4, 0.0)
    frame = (399.5, 299.5), (500.0, 510.0), (800, 600)
    assert read(path) == [Calibration("BrownConrady", (("coefficients", coefficients),), *frame)]
    path.write_text(json.dumps(SHARED | {"camera_model": "OPENCV_FISHEYE", "p1": 0, "p2": 0, "frames": []}))
    assert read(path)[0].model == "KannalaBrandt"
    path.write_text(json.dumps({"camera_angle_x": math.pi / 2, "w": 800, "h": 600, "frames": [FRAME]}))
    [found] = read(path)
    assert (found.model, found.center) == ("Perspective", (399.5, 299.5))
    assert found.scale == pytest.approx((400.0, 400.0), rel=1e-15)


def test_frames_with_cameras_of_their_own(path):
    frames = [
        FRAME | {"fl_x": 500, "file_path": "a"},
        FRAME | {"fl_x": 600, "file_path": "b"},
        FRAME | {"fl_x": 500, "file_path": "c"},
    ]
    path.write_text(json.dumps(SHARED | {"frames": frames}))
    cameras = read(path)
    assert [(one.name, one.scale) for one in cameras] == [("a", (500.0, 510.0)), ("b", (600.0, 510.0))]
    write(path, cameras, format="nerfstudio", overwrite=True)
    assert read(path) == cameras
    path.write_text(json.dumps(SHARED | {"frames": [*frames, FRAME]}))
    assert [one.name for one in read(path)] == ["", "a", "b"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_model": "THIN"}, "camera_model: must be one of OPENCV, .*got 'THIN'"),
        ({"k4": 0.1}, "k4: means different things to its readers"),
        ({"camera_model": "OPENCV_FISHEYE"}, "p1: a fisheye of OpenCV is not tangential"),
        ({"fl_x": 0}, "fl_x: must be larger than 0"),
        ({"fl_x": None, "camera_angle_x": 4.0}, "camera_angle_x: must be less than π"),
        ({"w": None}, "w is missing; there are"),
        ({"frames": [FRAME | {"cx": "x"}]}, r"frames\[0\].cx: must be a number, got 'x'"),
    ],
)
def test_what_is_wrong_is_named(path, change, message):
    path.write_text(json.dumps(SHARED | {"frames": []} | change))
    with pytest.raises(CalibrationError, match=message):
        read(path)
