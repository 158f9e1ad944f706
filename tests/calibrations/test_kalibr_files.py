"""Kalibr's camchain."""

import pytest
import yaml

from jaxlens.calibrations import Calibration, CalibrationError, read, write

# As Kalibr writes it: block sequences of rows, flow sequences of numbers.
CHAIN = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.01, 1e-4, -2e-05]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: MODEL
  distortion_coeffs: [COEFFICIENTS]
  distortion_model: DISTORTION
  intrinsics: [OWN460.0, 461.0, 370.0, 240.0]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""
POSE = ((1.0, 0.0, 0.0, -0.11), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
FOUR = "0.1, 0.2, 0.3, 0.4"
KINDS = [
    ("pinhole", "", "none", "", "Perspective", {}),
    ("pinhole", "", "radtan", FOUR, "BrownConrady", {"coefficients": (0.1, 0.2, 0.3, 0.4)}),
    ("pinhole", "", "equi", FOUR, "KannalaBrandt", {"coefficients": (0.1, 0.2, 0.3, 0.4)}),
    ("pinhole", "", "fov", "0.9", "FieldOfView", {"center": (0.0, 0.0), "omega": 0.9}),
    ("omni", "1.2, ", "radtan", FOUR, "UnifiedCamera", {"coefficients": (0.1, 0.2, 0.3, 0.4), "xi": 1.2}),
    ("omni", "1.2, ", "none", "", "UnifiedCamera", {"coefficients": (), "xi": 1.2}),
    ("ds", "-0.2, 0.6, ", "none", "", "DoubleSphere", {"alpha": 0.6, "xi": -0.2}),
    ("eucm", "0.6, 1.1, ", "none", "", "ExtendedUnifiedCamera", {"alpha": 0.6, "beta": 1.1}),
]


def chain(model, own, distortion, coefficients):
    text = CHAIN.replace("MODEL", model).replace("COEFFICIENTS", coefficients)
    return text.replace("DISTORTION", distortion).replace("OWN", own)


@pytest.mark.parametrize(("model", "own", "distortion", "coefficients", "family", "parameters"), KINDS)
def test_a_chain_comes_and_goes(tmp_path, model, own, distortion, coefficients, family, parameters):
    path = tmp_path / "camchain.yaml"
    path.write_text(chain(model, own, distortion, coefficients))
    cameras = read(path)
    first = ("coefficients", (-0.2, 0.01, 1e-4, -2e-05))
    frame = (362.68, 246.049), (461.629, 460.152), (752, 480)
    second = Calibration(
        family, tuple(parameters.items()), (370.0, 240.0), (460.0, 461.0), (752, 480), None, "cam1", POSE
    )
    assert cameras == [Calibration("BrownConrady", (first,), *frame, name="cam0"), second]
    write(path, cameras, format="kalibr", overwrite=True)
    assert read(path) == cameras
    written, original = yaml.safe_load(path.read_text()), yaml.safe_load(chain(model, own, distortion, coefficients))
    assert written["cam1"].items() <= original["cam1"].items()
    assert written["cam1"].keys() == original["cam1"].keys() - {"cam_overlaps"}


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (("thin", "", "none", ""), "cam1.camera_model: must be one of pinhole, omni, ds, eucm, got 'thin'"),
        (("pinhole", "", "thin", ""), "cam1.distortion_model: must be one of radtan, equi, fov, none"),
        (("ds", "0.1, 0.5, ", "equi", FOUR), "cam1.distortion_model: equi after ds is no lens of jaxlens"),
        (("ds", "0.1, 1.5, ", "none", ""), "cam1.intrinsics: xi is within ±1 and alpha between 0 and 1, got 0.1, 1.5"),
        (("eucm", "0.1, -1.0, ", "none", ""), "cam1.beta: must be larger than 0"),
        (("omni", "", "none", ""), "cam1.intrinsics: must be 5 numbers, got 4"),
        (("pinhole", "", "fov", "4.0"), "cam1.distortion_coeffs: must be less than π, got 4"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, kind, message):
    path = tmp_path / "camchain.yaml"
    path.write_text(chain(*kind))
    with pytest.raises(CalibrationError, match=message):
        read(path)


def test_lenses_that_it_has_no_room_for(tmp_path):
    lens = Calibration("Stereographic", (), (0.0, 0.0), (1.0, 1.0), (2, 2))
    with pytest.raises(CalibrationError, match=r"Kalibr holds .*DoubleSphere, not this Stereographic"):
        write(tmp_path / "camchain.yaml", lens, format="kalibr")
