"""ROS camera_info, as its calibrator writes it and as its messages are printed."""

import pytest
import yaml

from jaxlens.calibrations import Calibration, CalibrationError, read, write

# As camera_calibration writes it, to the letter.
CALIBRATOR = """image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [430.15433, 0.     , 311.71339,
         0.     , 430.60920, 221.06824,
         0.     , 0.     , 1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.363528, 0.108588, -1e-4, 0.000442, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [380., 0., 310., 0., 0., 380., 220., 0., 0., 0., 1., 0.]
"""
MESSAGE = """height: 480
width: 640
distortion_model: "equidistant"
D: [0.1, 0.02, 0.003, 0.0004]
K: [300.0, 0.0, 320.0, 0.0, 301.0, 240.0, 0.0, 0.0, 1.0]
binning_x: 0
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "camera.yaml"


def test_what_the_calibrator_writes(path):
    path.write_text(CALIBRATOR)
    [found] = read(path)
    coefficients = (-0.363528, 0.108588, -1e-4, 0.000442, 0.0)
    frame = (311.71339, 221.06824), (430.15433, 430.6092), (640, 480)
    assert found == Calibration("BrownConrady", (("coefficients", coefficients),), *frame, name="narrow_stereo/left")
    assert found.format == "ros"


def test_a_printed_message(path):
    for text in (MESSAGE, MESSAGE.replace("D:", "d:").replace("K:", "k:")):
        path.write_text(text)
        [found] = read(path)
        assert (found.model, found.scale, found.image_size) == ("KannalaBrandt", (300.0, 301.0), (640, 480))
    path.write_text(MESSAGE.replace('"equidistant"', '""').replace("0.1, 0.02, 0.003, 0.0004", ""))
    assert read(path)[0].model == "Perspective"


@pytest.mark.parametrize(
    ("model", "parameters", "said", "count"),
    [
        ("Perspective", {}, "plumb_bob", 5),
        ("BrownConrady", {"coefficients": (0.1, 0.2, 0.3, 0.4)}, "plumb_bob", 5),
        ("BrownConrady", {"coefficients": (0.1,) * 8}, "rational_polynomial", 8),
        ("KannalaBrandt", {"coefficients": (0.1, 0.2)}, "equidistant", 4),
    ],
)
def test_what_is_written(path, model, parameters, said, count):
    frame = (320.0, 240.0), (500.0, 501.0), (640, 480)
    write(path, Calibration(model, tuple(parameters.items()), *frame, name="left: 1"), format="ros")
    content = yaml.safe_load(path.read_text())
    assert content["distortion_model"] == said
    assert content["camera_name"] == "left: 1"
    assert len(content["distortion_coefficients"]["data"]) == content["distortion_coefficients"]["cols"] == count
    assert content["camera_matrix"]["data"] == [500.0, 0, 320, 0, 501, 240, 0, 0, 1]
    assert content["projection_matrix"]["data"] == [500.0, 0, 320, 0, 0, 501, 240, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("plumb_bob", "thin", "distortion_model: must be one of plumb_bob, .*equidistant.* got 'thin'"),
        ("0.108588, -1e-4, ", "", r"distortion_coefficients.data: must be 4 or 5 numbers, got 3"),
        ("image_width: 640", "image_width: wide", "image_width: must be a number, got 'wide'"),
        ("[430.15433", "[.nan", r"camera_matrix.data\[0\]: must be a number, got '.nan'"),
        ("[430.15433", "[1e999", r"camera_matrix.data\[0\]: must be a finite number of usual size, got inf"),
        ("image_height: 480\n", "", "image_height is missing"),
    ],
)
def test_what_is_wrong_is_named(path, old, new, message):
    assert old in CALIBRATOR
    path.write_text(CALIBRATOR.replace(old, new))
    with pytest.raises(CalibrationError, match=message):
        read(path)
