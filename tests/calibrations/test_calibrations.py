"""Calibration files: what is written comes back, and what is broken is named."""

import json
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxlens as jl
from jaxlens.calibrations import (
    Calibration,
    CalibrationError,
    read_calibration,
    read_corners,
    write_calibration,
)
from jaxlens.numerics import as_floating, as_points, join, split

LENSES = {
    "RadialPolynomial": lambda: jl.RadialPolynomial([0.1, -0.02, 0.003], center=[0.01, -0.02]),
    "Division": lambda: jl.Division(0.25, center=[0.0, 0.1]),
    "BrownConrady": lambda: jl.BrownConrady([-0.28, 0.025, 0.0012, -0.0001, 0.16]),
    "BrownConrady, tilted": lambda: jl.BrownConrady([-0.28, 0.025, 0.0012, -0.0001, 0.16, *[0.01] * 8, 0.05]),
}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "lens.json"


@pytest.mark.parametrize("model", LENSES)
def test_a_lens_comes_back_bit_by_bit(x64, path, model):
    lens = LENSES[model]()
    frame = jl.Frame([320.25, 239.5], [532.8, 533.1])
    written = Calibration.from_lens(lens, frame=frame, image_size=(640, 480))
    write_calibration(path, written)
    read = read_calibration(path)
    assert read == written
    for one, other in zip(jax.tree.leaves(read.lens()), jax.tree.leaves(lens), strict=True):
        assert one.tolist() == other.tolist()
    assert read.frame(480, 640).center.tolist() == [320.25, 239.5]
    assert read.frame(480, 640).scale.tolist() == [532.8, 533.1]


def test_a_fit_comes_back_with_its_covariance(x64, path):
    ideal = np.random.default_rng(0).uniform(-0.7, 0.7, (50, 2))
    observed = np.asarray(jl.RadialPolynomial([0.1, 0.02]).distort(ideal))
    observed = observed + 1e-3 * np.random.default_rng(1).normal(size=observed.shape)
    fit = jl.fitting.fit_points(jl.RadialPolynomial([0.0, 0.0]), ideal, observed)
    write_calibration(path, Calibration.from_fit(fit))
    estimate = read_calibration(path).estimate
    assert estimate.names == fit.names
    assert np.array_equal(estimate.covariance, fit.covariance)
    assert estimate.values == tuple(fit.values.tolist())
    assert (estimate.rms, estimate.degrees_of_freedom) == (float(fit.rms), 98)


def test_the_same_calibration_is_the_same_bytes(path, tmp_path):
    calibration = Calibration.from_lens(jl.Division(0.5))
    write_calibration(path, calibration)
    write_calibration(tmp_path / "other.json", calibration)
    assert path.read_bytes() == (tmp_path / "other.json").read_bytes()
    with pytest.raises(FileExistsError):
        write_calibration(path, calibration)


def test_a_frame_follows_the_size_of_the_picture(x64):
    """A corner of the picture, half a pixel outside the first one's centre, has the same normalized coordinates."""
    calibration = Calibration.from_lens(jl.Division(0.1), frame=jl.Frame([300.0, 200.0], 400.0), image_size=(640, 480))
    corner = np.array([-0.5, -0.5])
    whole, half = calibration.frame(480, 640), calibration.frame(240, 320)
    np.testing.assert_allclose(half.normalize(corner), whole.normalize(corner), rtol=1e-14)
    np.testing.assert_allclose(half.scale, whole.scale / 2, rtol=1e-15)
    with pytest.raises(CalibrationError, match=r"for pictures of 640 × 480 pixels, and this one has 640 × 640"):
        calibration.frame(640, 640)
    free = Calibration.from_lens(jl.Division(0.1))
    np.testing.assert_allclose(free.frame(480, 640).scale, [400.0, 400.0])


GOOD = {
    "format": "jaxlens calibration",
    "schema_version": 1,
    "model": "Division",
    "parameters": {"k": 0.1, "center": [0.0, 0.0]},
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, 'it does not say "format"'),
        ({"schema_version": 2}, "schema version 2"),
        (
            {"model": "Fisheye"},
            "model: there is no lens 'Fisheye'; there are .*Division, .*RadialPolynomial",
        ),
        ({"parameters": {"k": "0.1"}}, r"parameters\.k.*got '0.1'"),
        ({"lens": 1}, "lens: Extra inputs are not permitted"),
        ({"frame": {"center": [0, 0], "scale": [0, 1]}}, r"frame\.scale\.0: .*greater than 0"),
        ({"image_size": [640]}, "image_size"),
        (
            {
                "estimate": {
                    "names": ["k"],
                    "values": [0.1, 0.2],
                    "covariance": [[1.0]],
                    "rms": 0.1,
                    "degrees_of_freedom": 3,
                }
            },
            "1 names need 1 values",
        ),
    ],
)
def test_what_is_wrong_is_named(path, change, message):
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_calibration(path)
    assert repr(str(path)) in str(caught.value)


@jl.lenses.register("test.cubic")
class Cubic(jl.Lens):
    """A lens of somebody's own."""

    a: Float[Array, ""]
    shift: Float[Array, "2"]

    def __init__(self, a, *, shift=(0.0, 0.0)):
        self.a, self.shift = as_floating(a), as_floating(shift)

    @classmethod
    def identity(cls, *, terms=None):
        return cls(0.0)

    def distort(self, points):
        x, y = split(as_points(points))
        squared = x * x + y * y
        factor = 1 + self.a * squared
        return join(x * factor + self.shift[0] * squared, y * factor + self.shift[1] * squared)


def test_a_lens_of_one_s_own_comes_back(x64, path):
    lens = Cubic(-0.1, shift=[0.01, 0.02])
    ideal = np.random.default_rng(0).uniform(-0.7, 0.7, (50, 2))
    fit = jl.fitting.fit_points(Cubic.identity(), ideal, lens.distort(ideal))
    write_calibration(path, Calibration.from_fit(fit))
    assert json.loads(path.read_text())["model"] == "test.cubic"
    read = read_calibration(path).lens()
    assert isinstance(read, Cubic)
    np.testing.assert_allclose(read.a, -0.1, atol=1e-12)
    np.testing.assert_allclose(read.shift, [0.01, 0.02], atol=1e-12)


class _Nameless(jl.Division):
    """A subclass has no name by inheritance: it may be another model."""


@jl.lenses.register("test.closed")
class _Closed(jl.Division):
    def __init__(self):
        super().__init__(0.0)


@jl.lenses.register("test.static")
class _Static(jl.Division):
    order: int = eqx.field(static=True, default=1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: _Nameless(0.1), "_Nameless has no name in files: decorate the class"),
        (lambda: _Closed(), "_Closed cannot be read back: its constructor must take its fields by name"),
        (lambda: _Static(0.1), r"_Static\.order is static"),
        (lambda: jl.Division(0.1).then(jl.Division(0.1)), "holds a lens, not a Chain"),
    ],
)
def test_lenses_that_no_file_holds(make, message):
    with pytest.raises(CalibrationError, match=message):
        Calibration.from_lens(make())


def test_a_file_imports_nothing(path, monkeypatch):
    """A model that looks like a module's path is a name like any other, and unknown."""
    (path.parent / "malicious.py").write_text("raise SystemExit('imported')")
    monkeypatch.syspath_prepend(path.parent)
    for model in ("malicious:Lens", "malicious.Lens", "os:system"):
        path.write_text(json.dumps(GOOD | {"model": model}))
        with pytest.raises(CalibrationError, match="there is no lens"):
            read_calibration(path)
    assert "malicious" not in sys.modules


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not JSON at line 1"),
        (b"\xff\xfe", "not UTF-8"),
        (b"[" * 100_000, "nested too deeply|not JSON"),
        (b'{"format": NaN}', "NaN is no number"),
        (b" " * (5 * 2**20), "larger than"),
    ],
)
def test_files_that_are_none(path, data, message):
    path.write_bytes(data)
    with pytest.raises(CalibrationError, match=message):
        read_calibration(path)
    with pytest.raises(CalibrationError, match="cannot read"):
        read_calibration(path.parent / "nothing.json")


def test_parameters_that_make_no_lens(path):
    path.write_text(json.dumps(GOOD | {"model": "BrownConrady", "parameters": {"coefficients": [1.0]}}))
    with pytest.raises(CalibrationError, match="no BrownConrady has such parameters"):
        read_calibration(path).lens()


def test_corners(tmp_path):
    path = tmp_path / "corners.csv"
    path.write_text("view,corner,board_x,board_y,x,y\n2,0,0,0,10,20\n2,1,1,0,11,20\n5,1,1,0,30,40\n")
    names, views = read_corners(path)
    assert names == ["2", "5"]
    assert [(board.tolist(), seen.tolist()) for board, seen in views] == [
        ([[0.0, 0.0], [1.0, 0.0]], [[10.0, 20.0], [11.0, 20.0]]),
        ([[1.0, 0.0]], [[30.0, 40.0]]),
    ]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("2,0,0,0,10,20\n3,0,0,1,10,20\n", r"line 3: corner 0 is at \(0.0, 1.0\) of the board, and in line 2"),
        ("2,0,0,0,10,20\n2,0,0,0,10,20\n", "line 3: corner 0 of view 2 is in line 2 already"),
        ("2,0,0,0,ten,20\n", "line 2: x is 'ten', which is no number"),
        ("2,0,0,0,nan,20\n", "line 2: x is 'nan'; leave out"),
        ("2,0,0,0,10\n", "line 2: 5 cells"),
        ("", "no rows below"),
    ],
)
def test_corners_that_are_wrong(tmp_path, rows, message):
    path = tmp_path / "corners.csv"
    path.write_text("view,corner,board_x,board_y,x,y\n" + rows)
    with pytest.raises(CalibrationError, match=message):
        read_corners(path)
    path.write_text("view,corner,board_x,board_y,x\n2,0,0,0,10\n")
    with pytest.raises(CalibrationError, match="no column y; it has view"):
        read_corners(path)
