"""Files that cv2.FileStorage writes and reads."""

import json

import cv2
import numpy as np
import pytest

from jaxlens.calibrations import Calibration, CalibrationError, read, write

MATRIX = np.array([[532.8, 0, 320.25], [0, 533.1, 239.5], [0, 0, 1]])
COEFFICIENTS = np.array([[-0.28, 0.025, 0.0012, -1e-4, 0.16]])
SUFFIXES = {"yml": "opencv-yaml", "xml": "opencv-xml", "json": "opencv-json"}


def store(path, **entries):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in entries.items():
        storage.write(key, value)
    storage.release()


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "names",
    [
        ("camera_matrix", "distortion_coefficients"),
        ("K", "D"),
        ("cameraMatrix", "distCoeffs"),
        ("M", "dist_coeffs"),
        ("Camera_Matrix", "Distortion_Coefficients"),
    ],
)
def test_what_opencv_writes(tmp_path, suffix, names):
    path = tmp_path / f"camera.{suffix}"
    store(path, **{names[0]: MATRIX, "image_width": 640, names[1]: COEFFICIENTS.T, "image_height": 480, "note": "a: b"})
    assert read(path) == [
        Calibration(
            "BrownConrady",
            (("coefficients", tuple(COEFFICIENTS[0].tolist())),),
            (320.25, 239.5),
            (532.8, 533.1),
            (640, 480),
        )
    ]
    assert read(path)[0].format == SUFFIXES[suffix]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_pair_and_its_size_in_a_matrix(tmp_path, suffix):
    path = tmp_path / f"pair.{suffix}"
    store(path, M1=MATRIX, D1=COEFFICIENTS, M2=MATRIX + np.eye(3) * [1, 1, 0], D2=COEFFICIENTS[:, :4], R=np.eye(3))
    one, other = read(path)
    assert (one.name, other.name, one.image_size) == ("1", "2", None)
    assert (one.scale, other.scale) == ((532.8, 533.1), (533.8, 534.1))
    assert [len(dict(found.parameters)["coefficients"]) for found in (one, other)] == [5, 4]
    store(path, K=MATRIX, D=COEFFICIENTS, image_size=np.array([640, 480]))
    assert read(path)[0].image_size == (640, 480)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "how", [{"fisheye": 1}, {"fisheye_model": 1}, {"distortion_model": "fisheye"}, {"camera_model": "equidistant"}, {}]
)
def test_fisheyes(tmp_path, suffix, how):
    path = tmp_path / f"camera.{suffix}"
    store(path, K=MATRIX, **({"D": COEFFICIENTS[:, :4]} if how else {"fisheye_D": COEFFICIENTS[:, :4]}), **how)
    [found] = read(path)
    assert (found.model, dict(found.parameters)["coefficients"]) == ("KannalaBrandt", (-0.28, 0.025, 0.0012, -1e-4))


def test_omnidir(tmp_path):
    store(tmp_path / "camera.yml", K=MATRIX, xi=np.array([[1.2]]), D=COEFFICIENTS[:, :4])
    [found] = read(tmp_path / "camera.yml")
    assert found.model == "UnifiedCamera"
    assert dict(found.parameters) == {"xi": 1.2, "coefficients": (-0.28, 0.025, 0.0012, -1e-4)}


LENSES = {
    "Perspective": ({}, [0.0] * 4),
    "RadialPolynomial": ({"coefficients": (0.1, 0.2, 0.3), "center": (0.0, 0.0)}, [0.1, 0.2, 0, 0, 0.3]),
    "BrownConrady": ({"coefficients": tuple(0.01 * n for n in range(1, 15))}, [0.01 * n for n in range(1, 15)]),
    "Equidistant": ({}, [0.0] * 4),
    "KannalaBrandt": ({"coefficients": (0.1, 0.2)}, [0.1, 0.2, 0, 0]),
    "UnifiedCamera": ({"coefficients": (), "xi": 0.9}, [0.0] * 4),
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("model", LENSES)
def test_what_opencv_reads(tmp_path, suffix, model):
    parameters, coefficients = LENSES[model]
    path = tmp_path / f"camera.{suffix}"
    written = Calibration(model, tuple(sorted(parameters.items())), (320.25, 239.5), (532.8, 533.1), (640, 480))
    write(path, [written], format=SUFFIXES[suffix])
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), MATRIX)
    np.testing.assert_array_equal(storage.getNode("distortion_coefficients").mat(), [coefficients])
    assert storage.getNode("image_width").real() == 640
    assert storage.getNode("fisheye").real() == (model in ("KannalaBrandt", "Equidistant"))


def test_projections_agree(tmp_path, x64):
    """The file of one, the projection of both."""
    store(tmp_path / "camera.yml", K=MATRIX, D=COEFFICIENTS, image_size=np.array([640, 480]))
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1.5], (20, 3))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, COEFFICIENTS)[0][:, 0]
    np.testing.assert_allclose(read(tmp_path / "camera.yml")[0].camera().project(points), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": [[500, 1, 320], [0, 500, 240], [0, 0, 1]]}, "K: must be .*no skew"),
        ({"K": [[0, 0, 320], [0, 500, 240], [0, 0, 1]]}, "K: must be larger than 0, got 0"),
        ({"K": [500, 320]}, "K: must be 9 numbers, got 2"),
        ({"D": [0.1, 0.2, "x", 0.1]}, r"D\[2\]: must be a number, got 'x'"),
        ({"D": [0.1] * 6}, "D: must be 0 or 4 or 5 or 8 or 12 or 14 numbers, got 6"),
        ({"D": None}, "no distortion goes with it"),
        ({"D": {"rows": 1, "cols": 5, "dt": "d", "data": [0.1] * 4}}, "D: 1 × 5 numbers are told, and there are 4"),
        ({"image_width": 640.5, "image_height": 480}, "image_width: must be a whole number of pixels"),
        ({"image_width": -4, "image_height": 480}, "image_width: must be larger than 0"),
        ({"fisheye": 1, "D": [0.1] * 5}, "a fisheye has 4 coefficients, got 5"),
        ({"distortion_model": "thin"}, "distortion_model: 'thin' is no model of OpenCV"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, change, message):
    path = tmp_path / "camera.json"
    content = {"K": MATRIX.tolist(), "D": [0.1] * 4} | change
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    with pytest.raises(CalibrationError, match=message) as caught:
        read(path)
    assert repr(str(path)) in str(caught.value)


def test_lenses_that_it_has_no_room_for(tmp_path):
    lens = Calibration("DoubleSphere", (("alpha", 0.5), ("xi", 0.1)), (0.0, 0.0), (1.0, 1.0))
    with pytest.raises(CalibrationError, match=r"OpenCV holds .*BrownConrady.* not this DoubleSphere; .*convert finds"):
        write(tmp_path / "camera.yml", lens, format="opencv-yaml")
