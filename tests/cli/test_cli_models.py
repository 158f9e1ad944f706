"""`--model`: the lenses there are, and one of the user's own."""

import json
import sys

import jax
import numpy as np
import pytest

import jaxlens as jl
from jaxlens import images
from jaxlens.calibrations import read_calibration
from jaxlens.cli import calibrate, estimation
from jaxlens.lenses import _registry, find_lens

MODULE = '''
import jax.numpy as jnp
import jaxlens as jl
from jaxlens import images
from jaxlens.numerics import as_floating


class Nameless(jl.RadialLens):
    """x_d = x_u exp(-a r^2)."""

    a: object

    def __init__(self, a, *, center=None):
        self.a = as_floating(a)
        self.center = jl.lenses.as_center(center, self.a.dtype)

    @classmethod
    def identity(cls, *, terms=None):
        return cls(0.0)

    def factor(self, squared_radius):
        return jnp.exp(-self.a * squared_radius)

    def fold_radius(self):
        return jnp.where(self.a > 0, jnp.sqrt(0.5 / jnp.where(self.a > 0, self.a, 1)), jnp.inf)


@jl.lenses.register("own.exponential")
class Exponential(Nameless):
    """With a name in files."""


class Startless(jl.Lens):
    def distort(self, points):
        return points


number = 3
'''


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The current folder, with a lens of the user's in it, and correspondences of that."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "ownlens.py").write_text(MODULE)
    (tmp_path / "broken_lens.py").write_text("import nothing_of_this_name")
    (tmp_path / "leaving_lens.py").write_text("raise SystemExit(0)")
    ideal = np.random.default_rng(0).uniform(-0.7, 0.7, (80, 2))
    observed = ideal * np.exp(-0.2 * np.sum(ideal**2, axis=1, keepdims=True))
    np.savetxt(
        "points.csv",
        np.hstack([ideal, observed]),
        delimiter=",",
        header="ideal_x,ideal_y,observed_x,observed_y",
        comments="",
    )
    yield tmp_path
    for name in ("ownlens", "broken_lens", "leaving_lens"):
        sys.modules.pop(name, None)


def test_a_lens_of_one_s_own(run, here):
    words = ("fit", "points", "points.csv", "--model", "ownlens:Exponential")
    result = run(*words, "--output", "lens.json", "--start", "0.1")
    assert (result.code, result.err.count("\n")) == (0, 1), result.err
    assert json.loads((here / "lens.json").read_text())["model"] == "own.exponential"
    lens = read_calibration(here / "lens.json").lens()
    assert type(lens).__module__ == "ownlens"
    assert dict(read_calibration(here / "lens.json").parameters)["a"] == pytest.approx(0.2, abs=1e-9)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fisheye"], "no lens 'fisheye'; there are "),
        (["ownlens.Exponential"], "one of your own is package.module:Class"),
        (["own lens:Exponential"], "is no package.module:Class"),
        (["ownlens:"], "is no package.module:Class"),
        (["missing_lens:Exponential"], "there is no module 'missing_lens' in the current folder"),
        (["ownlens.part:Exponential"], "ownlens.part"),
        (
            ["broken_lens:Exponential"],
            "cannot be imported: ModuleNotFoundError: No module named 'nothing_of_this_name'",
        ),
        (["leaving_lens:Exponential"], "cannot be imported: SystemExit: 0"),
        (["ownlens:Exponentail"], "has no Exponentail; its lenses are Nameless, Exponential, Startless"),
        (["ownlens:number"], "ownlens:number is no subclass of jaxlens.Lens, but int number"),
        (["ownlens:Startless"], "Startless does not say where a fit starts"),
        (
            ["ownlens:Exponential", "--terms", "2"],
            "--terms of the ownlens:Exponential lens can be left out only; got 2",
        ),
        (
            ["ownlens:Exponential", "--start", "1", "2"],
            "--start has 2 coefficients, and the ownlens:Exponential lens 1",
        ),
        (["ownlens:Nameless", "--output", "lens.json"], "--output: Nameless has no name in files"),
    ],
)
def test_what_is_no_lens(run, here, words, message):
    result = run("fit", "points", "points.csv", "--model", *words)
    assert (result.code, message in result.err) == (2, True), result.err
    assert "Traceback" not in result.err
    assert not (here / "lens.json").exists()


def test_a_lens_without_a_name_is_fitted_all_the_same(run, here):
    result = run("fit", "points", "points.csv", "--model", "ownlens:Nameless")
    assert result.code == 0, result.err
    assert "0.2" in result.out


def test_a_file_does_not_bring_its_lens_along(run, here):
    (here / "lens.json").write_text(
        '{"format": "jaxlens calibration", "schema_version": 1, "model": "ownlens:Exponential", "parameters": {}}'
    )
    result = run("undistort", "points.csv", "--lens", "lens.json", "--output", "a.png")
    assert (result.code, "there is no lens 'ownlens:Exponential'" in result.err) == (2, True), result.err
    assert "ownlens" not in sys.modules


@pytest.fixture
def own(here, picture):
    """A calibration of the user's own lens, whose module nothing has imported, and a picture."""
    (here / "lens.json").write_text(json.dumps(CALIBRATION))
    return picture


CALIBRATION = {
    "format": "jaxlens calibration",
    "schema_version": 1,
    "model": "own.exponential",
    "parameters": {"a": 0.2, "center": [0.0, 0.0]},
}


def test_a_lens_of_one_s_own_for_pictures(run, own, here):
    result = run("undistort", own, "--lens", "lens.json", "--model", "ownlens:Exponential", "--output", "a.png")
    assert result.code == 0, result.err
    lens = read_calibration(here / "lens.json").lens()
    assert type(lens).__module__ == "ownlens"
    with jax.enable_x64(True):
        expected = images.warp(images.read(own), jl.OneToOne(read_calibration(here / "lens.json").lens())).pixels
    np.testing.assert_array_equal(images.read(here / "a.png").pixels, expected)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "there is no lens 'own.exponential'"),
        ([], "For one of your own pass --model package.module:Class, too: that module is imported, and thus run"),
        (["--model", "ownlens:Nameless"], "--model: Nameless has no name in files"),
        (["--model", "missing_lens:Exponential"], "there is no module 'missing_lens' in the current folder"),
    ],
)
def test_a_lens_that_is_not_known(run, own, here, monkeypatch, words, message):
    # Other tests of this process may have registered it.
    monkeypatch.setattr(_registry, "_CLASSES", {**_registry._CLASSES})
    _registry._CLASSES.pop("own.exponential", None)
    result = run("undistort", own, "--lens", "lens.json", *words, "--output", "a.png")
    assert (result.code, message in result.err) == (2, True), result.err
    assert not (here / "a.png").exists()
    assert words or "ownlens" not in sys.modules


def test_a_model_of_another_lens(run, own, here):
    (here / "lens.json").write_text(json.dumps(CALIBRATION | {"model": "Division", "parameters": {"kappa": [0.1]}}))
    result = run("undistort", own, "--lens", "lens.json", "--model", "radial", "--output", "a.png")
    message = "--model radial is the lens 'RadialPolynomial', and 'lens.json' holds a 'Division'"
    assert (result.code, message in result.err) == (2, True), result.err


def test_a_model_without_a_file(run, own):
    result = run("distort", own, "--kappa", "0.1", "--model", "ownlens:Exponential", "--output", "a.png")
    assert (result.code, "--model says what the lens in --lens FILE.json is" in result.err) == (2, True)
    assert "ownlens" not in sys.modules


@pytest.mark.parametrize("arguments", [estimation.FitArguments, calibrate.Arguments])
def test_the_default_is_a_lens_there_is(arguments):
    assert issubclass(find_lens(arguments.model), jl.Lens)


@pytest.mark.parametrize("command", [("fit", "points"), ("calibrate",)])
def test_the_help_names_the_lenses_there_are(run, command):
    said = " ".join(run(*command, "--help").out.replace("│", " ").split())
    for lens in (jl.RadialPolynomial, jl.Division, jl.BrownConrady):
        short = next(name for name in ("radial", "division", "brown-conrady") if find_lens(name) is lens)
        assert short in said
    assert "a lens of your own" in said
    assert "is run" in said
