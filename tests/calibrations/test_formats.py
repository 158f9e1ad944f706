"""Files of other software: what holds of every format."""

import math
import random
import re

import numpy as np
import pytest

import jaxlens as jl
from jaxlens.calibrations import Calibration, CalibrationError, formats, read, read_calibration, write

BROWN = Calibration(
    "BrownConrady",
    (("coefficients", (-0.28, 0.025, 0.0012, -1e-4)),),
    (320.25, 239.5),
    (532.8, 533.1),
    (640, 480),
)


@pytest.mark.parametrize("format", formats())
def test_what_is_written_comes_back(tmp_path, format):
    path = tmp_path / "camera"
    write(path, BROWN, format=format)
    [found] = read(path)
    assert (found.model, found.image_size, found.format) == (BROWN.model, BROWN.image_size, format)
    np.testing.assert_allclose(found.center, BROWN.center, rtol=1e-15)
    np.testing.assert_allclose(found.scale, BROWN.scale, rtol=1e-15)
    coefficients = dict(found.parameters)["coefficients"]
    np.testing.assert_array_equal(coefficients, [*BROWN.parameters[0][1], *[0.0] * (len(coefficients) - 4)])
    before = path.read_bytes()
    write(path, read(path), format=format, overwrite=True)
    assert path.read_bytes() == before


WORDS = [*b"nan .nan inf 1e999 -1 0 1e300 [] {} null true".split(), b'"x"', b"", b"9" * 400]


def mutations(data, count=60):
    """Cut, flipped, spliced, and with other words in place of numbers; the same ones each time."""
    draw = random.Random(0)
    numbers = [found.span() for found in re.finditer(rb"-?\d+\.?\d*(?:e-?\d+)?", data)]
    for index in range(count):
        if index % 4 == 0:
            yield data[: draw.randrange(len(data))]
        elif index % 4 == 1:
            flipped = bytearray(data)
            for _ in range(draw.choice([1, 3, 10])):
                flipped[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
            yield bytes(flipped)
        elif index % 4 == 2 and numbers:
            first, last = draw.choice(numbers)
            yield data[:first] + draw.choice(WORDS) + data[last:]
        else:
            first, last = sorted(draw.sample(range(len(data)), 2))
            yield data[:first] + data[last:] if index % 8 == 3 else data[:last] + data[first:]


def read_or_say(path):
    try:
        return read(path), ""
    except CalibrationError as error:
        return [], str(error)


@pytest.mark.parametrize("format", formats())
def test_a_broken_file_is_an_error_or_a_finite_camera(tmp_path, format):
    path = tmp_path / "camera"
    write(path, BROWN, format=format)
    for data in mutations(path.read_bytes()):
        path.write_bytes(data)
        found, said = read_or_say(path)
        assert found or (repr(str(path)) in said and len(said) < 700)
        for one in found:
            numbers = [*one.center, *one.scale, *(one.image_size or ())]
            for _, value in one.parameters:
                numbers += value if isinstance(value, tuple) else [value]
            assert all(map(math.isfinite, numbers))
            assert min(one.scale) > 0


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("a: &x [1]\nb: {c: *x}\n", "no calibration of a known format .*jaxlens, .*it has the keys a, b"),
        ("K: !!python/object/apply:os.system [ls]\n", "not YAML at line 1.*could not determine a constructor"),
        ("K: [1\nD: [0", "not YAML at line 2"),
        ("K: 1\nK: 2\n", "not YAML at line 2.*K stands twice"),
        ('{"K": 1, "K": 2}', "the key 'K' stands twice"),
        ("a: " + "[" * 5000, "nested too deeply|not YAML"),
        ("<a>" * 5000 + "</a>" * 5000, "nested too deeply"),
        ('<!DOCTYPE a [<!ENTITY x "y">]><a>&x;</a>', "an entity in XML is refused"),
        ("<a><b></a>", "not XML at line 1, column 9"),
        ("{'a': " + "(" * 500, "not a Python literal"),
        ("{'a': __import__('os')}", "not a Python literal"),
        ("words\n", "it is 'words'"),
    ],
)
def test_files_that_are_none(tmp_path, data, message):
    path = tmp_path / "camera"
    path.write_text(data)
    with pytest.raises(CalibrationError, match=message):
        read(path)


def test_yaml_doubles_nothing(tmp_path):
    """A billion laughs: aliases share, and keys are not merged."""
    lines = ["a0: &a0 [1, 1]"] + [f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 40)]
    path = tmp_path / "camera"
    path.write_text("\n".join([*lines, "K: *a39", "D: [0, 0, 0, 0]", ""]))
    with pytest.raises(CalibrationError, match=r"K: must be 9 numbers|K\[0\]: must be a number"):
        read(path)


def test_misuse(tmp_path):
    path = tmp_path / "camera"
    with pytest.raises(CalibrationError, match=r"there is no format 'yaml'; there are jaxlens, "):
        write(path, BROWN, format="yaml")
    with pytest.raises(CalibrationError, match="no cameras to write"):
        write(path, [])
    with pytest.raises(CalibrationError, match="a file of jaxlens holds one camera, got 2"):
        write(path, [BROWN, BROWN])
    with pytest.raises(CalibrationError, match="has no frame in pixels"):
        write(path, Calibration("Perspective", ()), format="opencv-yaml")
    with pytest.raises(CalibrationError, match="not finite"):
        write(path, Calibration("Perspective", (), (math.nan, 0.0), (1.0, 1.0)), format="opencv-yaml")
    assert not path.exists()
    write(path, [BROWN, BROWN], format="opencv-xml")
    with pytest.raises(CalibrationError, match=r"holds 2 cameras \(1, 2\), and one is needed"):
        read_calibration(path)


def test_a_camera_is_written_as_well(tmp_path, x64):
    camera = jl.Camera(jl.Perspective(), jl.Frame([319.5, 239.5], 512.0), 640, 480)
    write(tmp_path / "camera", camera, format="opencv-yaml")
    [found] = read(tmp_path / "camera")
    assert found.camera().frame.center.tolist() == [319.5, 239.5]
    assert (found.camera().width, found.camera().height) == (640, 480)
