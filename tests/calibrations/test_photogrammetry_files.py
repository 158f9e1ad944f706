"""mrcal's .cameramodel and Metashape's XML."""

import pytest

from jaxlens.calibrations import Calibration, CalibrationError, read, write

MRCAL = """# generated on 2024-05-01 with mrcal-calibrate-cameras
{
    'lensmodel':  'LENSMODEL_OPENCV8',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 1761.181055, 1761.250444, 1965.706996, 1087.518797, -0.01266, 0.03590, -0.0002547, 0.0005275,
                    0.01, 0.02, 0.03, 0.04,],
    'valid_intrinsics_region': [ [1.0, 2.0], [3.0, 4.0] ],
    'extrinsics': [ 0., 0., 0., 1e-3, 0., 0.,],
    'imagersize': [ 4000, 2200,],
    # everything that made it
    'optimization_inputs': b'P#E7#{,]: ',
}
"""
METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>frame</projection>
  <width>800</width>
  <height>600</height>
  <f>500</f>
  <cx>3.5</cx>
  <cy>-2</cy>
  <b1>10</b1>
  <p1>-0.002</p1>
  <p2>0.001</p2>
  <date>2022-01-01T00:00:00Z</date>
</calibration>
"""
SENSORS = """<document version="1.5.0"><chunk><sensors next_id="1">
<sensor id="0" label="FC6310" type="frame"><resolution width="800" height="600"/>
<calibration type="frame" class="initial"><resolution width="800" height="600"/><f>400</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="800" height="600"/><f>500</f><k1>-0.1</k1></calibration>
</sensor>
<sensor id="1" label="wide" type="fisheye">
<calibration type="fisheye" class="adjusted"><resolution width="80" height="60"/><f>50</f><k2>0.1</k2></calibration>
</sensor></sensors></chunk></document>
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "camera"


def test_mrcal(path):
    path.write_text(MRCAL)
    coefficients = (-0.01266, 0.03590, -0.0002547, 0.0005275, 0.01, 0.02, 0.03, 0.04)
    frame = (1965.706996, 1087.518797), (1761.181055, 1761.250444), (4000, 2200)
    assert read(path) == [Calibration("BrownConrady", (("coefficients", coefficients),), *frame)]
    assert read(path)[0].format == "mrcal"
    for family, model in (
        ("Stereographic", "STEREOGRAPHIC"),
        ("Equirectangular", "LONLAT"),
        ("Perspective", "PINHOLE"),
    ):
        one = Calibration(family, (), *frame)
        write(path, one, format="mrcal", overwrite=True)
        assert f"'LENSMODEL_{model}'" in path.read_text()
        assert read(path) == [one]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("OPENCV8", "SPLINED_STEREOGRAPHIC_order=3", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3 is no lens of jaxlens"),
        ("OPENCV8", "CAHVOR", "lensmodel: LENSMODEL_CAHVOR is no lens of jaxlens; read are LENSMODEL_OPENCV4"),
        ("OPENCV8", "LATLON", "LENSMODEL_LATLON is no lens"),
        ("OPENCV8", "OPENCV5", "intrinsics: must be 9 numbers, got 12"),
        ("4000", "4000.5", "imagersize: must be a whole number"),
    ],
)
def test_what_is_wrong_with_mrcal_s_is_named(path, old, new, message):
    path.write_text(MRCAL.replace(old, new))
    with pytest.raises(CalibrationError, match=message):
        read(path)


def test_metashape(path):
    """Its p1, p2 are OpenCV's p2, p1; its centre is the middle of the picture."""
    path.write_text(METASHAPE)
    coefficients = (0.0, 0.0, 0.001, -0.002, 0.0)
    frame = (400 + 3.5 - 0.5, 300 - 2 - 0.5), (510.0, 500.0), (800, 600)
    assert read(path) == [Calibration("BrownConrady", (("coefficients", coefficients),), *frame)]
    path.write_text(
        METASHAPE.replace("frame", "fisheye").replace("<p1>-0.002</p1>", "<k4>0.1</k4>").replace("p2>", "k1>")
    )
    assert read(path)[0].model == "KannalaBrandt"
    assert dict(read(path)[0].parameters)["coefficients"] == (0.001, 0.0, 0.0, 0.1)
    one = Calibration("RadialPolynomial", (("center", (0.0, 0.0)), ("coefficients", (0.1, 0.2, 0.3, 0.4))), *frame)
    write(path, one, format="metashape", overwrite=True)
    assert read(path) == [one]


def test_metashape_s_sensors(path):
    path.write_text(SENSORS)
    one, other = read(path)
    assert (one.name, one.model, one.scale, one.center) == ("FC6310", "BrownConrady", (500.0, 500.0), (399.5, 299.5))
    assert (other.name, other.model, other.image_size) == ("wide", "KannalaBrandt", (80, 60))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("frame", "cylindrical", "calibration.projection: must be frame or fisheye, got 'cylindrical'"),
        ("frame", "fisheye", "no fisheye of jaxlens is tangential"),
        ("p1>", "b2>", "calibration.b2: no lens of jaxlens has it, got -0.002"),
        ("<b1>10</b1>", "<k4>1</k4>", "no lens of jaxlens has k4 beside p1 and p2"),
        ("<f>500</f>", "", "calibration.f is missing"),
        ("<f>500</f>", "<f>x</f>", "calibration.f: must be a number, got 'x'"),
    ],
)
def test_what_is_wrong_with_metashape_s_is_named(path, old, new, message):
    path.write_text(METASHAPE.replace(old, new))
    with pytest.raises(CalibrationError, match=message):
        read(path)
