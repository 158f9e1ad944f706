"""The picture behind Table 1: what is measured, how pictures depend on their parameters, and what the fits say."""

import csv
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_kinds import module_of

from jaxlens import metrics
from jaxlens.experiments import ConfigError, paper, run
from jaxlens.experiments.paper import READINGS, Reading
from jaxlens.experiments.readings import source_map
from jaxlens.frames import Frame
from jaxlens.sampling import remap
from jaxlens.warping import source_coordinates

pytestmark = pytest.mark.usefixtures("kinds")
exact = module_of("unknown", "exact")
portraits = module_of("unknown", "portraits")
search = module_of("unknown", "search")

SIZE = 32
MIDDLE = portraits.bounds()[0]
SMALL = """
kind = "unknown"
name = "small"
size = 24
candidates = 2
starts = 1
profile = [1.0, 1.3]
fine = 24
"""


@pytest.fixture(scope="module")
def template() -> portraits.Template:
    with jax.enable_x64(True):
        return portraits.Template.of(SIZE, "float64")


@pytest.fixture(scope="module")
def shown(template: portraits.Template):
    return jax.jit(lambda parameters: portraits.render(template, parameters, SIZE, paper.PEAK))


def test_the_goal_is_the_tables_own():
    figures = dict(zip(search.LABELS, search.goal(False), strict=True))
    assert len(figures) == 12
    assert figures["RMSE 0, 1"] == pytest.approx(29.5027, abs=1e-4)
    assert figures["RMSE 2, 3"] == pytest.approx(61.742, abs=1e-3)
    assert figures["MAE 3, 1"] == 48.9409058
    assert figures["RMS"] == pytest.approx(86.4537, abs=1e-4)
    exchanged = dict(zip(search.LABELS, search.goal(True), strict=True))
    assert exchanged["RMSE 3, 1"] == figures["RMSE 3, 2"]
    assert exchanged["MAE 3, 2"] == figures["MAE 3, 1"]
    assert "MAE 2, 3" not in figures


@pytest.mark.parametrize("reading", READINGS)
def test_measures_are_those_of_the_library(x64, reading: Reading):
    """Against `remap`, the readings' own maps and `metrics`, on square pixels, about the middle."""
    picture = jnp.asarray(np.random.default_rng(0).uniform(0, 193, (24, 24)))
    found = search.measures(picture, jnp.asarray(0.0), search.source_factors(reading, "float64"))
    frame = Frame([11.5, 11.5], np.hypot(12, 12))
    for index, kappa in enumerate(search.KAPPA):
        coordinates = source_coordinates(source_map(jnp.asarray(kappa), reading), 24, 24, frame=frame)
        deformed = remap(picture, coordinates)
        np.testing.assert_allclose(found[index], metrics.rmse(picture, deformed), rtol=1e-5)
        if index in search.TRUSTED:
            np.testing.assert_allclose(
                found[6 + search.TRUSTED.index(index)], metrics.mae(picture, deformed), rtol=1e-5
            )
    np.testing.assert_allclose(found[-1], jnp.sqrt(jnp.mean(picture**2)), rtol=1e-14)


def test_different_pictures_have_the_same_figures(x64):
    """Mirrored, upside down, turned by a half: the table cannot tell."""
    picture = jnp.asarray(np.random.default_rng(1).uniform(0, 193, (24, 24)))
    factors = search.source_factors("functional inverse", "float64")
    first, *others = (
        search.measures(one, jnp.asarray(-0.2), factors)
        for one in (picture, picture[:, ::-1], picture[::-1], picture[::-1, ::-1])
    )
    for other in others:
        np.testing.assert_allclose(other, first, rtol=1e-12)


def test_a_picture_has_the_tables_peak_and_moves_with_its_parameters(x64, shown):
    picture = np.asarray(shown(jnp.asarray(MIDDLE)))
    assert picture.max() == pytest.approx(193, rel=1e-14)
    assert picture.min() >= 0
    # Shifted by an eighth of the height: four pixels.
    moved = MIDDLE.copy()
    moved[1] += 4 / SIZE
    np.testing.assert_allclose(np.asarray(shown(jnp.asarray(moved)))[:, 4:], picture[:, :-4], atol=1e-9)
    dark = MIDDLE.copy()
    dark[3] = 0.0
    assert np.asarray(shown(jnp.asarray(dark)))[0, 0] == 0
    np.testing.assert_allclose(picture[0, 0], 0.5 * 193, rtol=1e-12)


def test_derivatives_of_the_measures(x64, shown):
    factors = search.source_factors("functional inverse", "float64")
    parameters = jnp.asarray(portraits.random_parameters(1, 3)[0])
    direction = jnp.asarray(np.random.default_rng(2).normal(size=len(portraits.PARAMETERS)) * portraits.bounds()[1])

    @jax.jit
    def logarithms(parameters):
        return jnp.log(search.measures(shown(parameters), parameters[-1], factors))

    slope = jax.jvp(logarithms, (parameters,), (direction,))[1]
    numeric = (logarithms(parameters + 1e-5 * direction) - logarithms(parameters - 1e-5 * direction)) / 2e-5
    np.testing.assert_allclose(numeric, slope, rtol=2e-3, atol=2e-4)


def test_the_fine_picture_is_the_same_face(x64):
    """Drawn by `face` and `shade` at full resolution, and averaged down."""
    parameters = portraits.random_parameters(1, 5)[0]
    parameters[-1] = 0.0
    fine = portraits.render_fine(parameters, 512, paper.PEAK)
    assert fine.shape == (512, 512)
    assert fine.max() == 193
    assert np.array_equal(fine, np.round(fine))
    found = jax.jit(portraits.render, static_argnums=(2, 3))(
        portraits.Template.of(128, "float64"), jnp.asarray(parameters), 128, paper.PEAK
    )
    assert np.mean(np.abs(fine.reshape(128, 4, 128, 4).mean(axis=(1, 3)) - found)) < 2


def test_a_picture_near_to_meeting_a_table_meets_it_with_a_small_change(x64, shown):
    """The goal is another picture's figures, so that it can be met."""
    factors = search.source_factors("reciprocal", "float64")
    start, other = MIDDLE.copy(), MIDDLE.copy()
    other[4] += 0.1
    one, two = (np.asarray(shown(jnp.asarray(each))) for each in (start, other))
    figures = np.asarray(search.measures(jnp.asarray(two), jnp.asarray(0.0), factors))
    found = exact.nearest_exact(one, 0.0, factors, figures)
    assert found.met
    assert 0 < found.change < np.sqrt(np.mean((two - one) ** 2))
    assert found.after.max() == pytest.approx(193, rel=1e-9)
    assert found.after.min() >= 0
    np.testing.assert_allclose(search.measures(jnp.asarray(found.after), jnp.asarray(0.0), factors), figures, rtol=1e-9)


def made(parameters: np.ndarray, rms: float, loss: float, jacobian: np.ndarray | None = None) -> search.Found:
    count = len(portraits.PARAMETERS)
    jacobian = np.zeros((12, count)) if jacobian is None else jacobian
    return search.Found(search.Hypothesis("direct", False), parameters, np.full(12, rms), np.ones(12), jacobian, loss)


def test_distinct_pictures_are_good_and_far_apart():
    spread = portraits.bounds()[1]
    near, far, bad = MIDDLE + 0.1 * spread, MIDDLE + 2 * spread, MIDDLE + 9 * spread
    found = [made(near, 0.31, 2.0), made(bad, 0.6, 9.0), made(far, 0.4, 3.0), made(MIDDLE, 0.3, 1.0)]
    chosen = search.distinct(found, 2)
    assert [one.loss for one in chosen] == [1.0, 3.0]
    assert len(search.distinct(found, 9)) == 3


def test_what_the_table_tells_where_it_tells_of_one_parameter_only():
    """One figure that depends on one parameter: 1/(1 + s²) of its variance is left, and nothing of the others'."""
    spread = portraits.bounds()[1]
    jacobian = np.zeros((12, len(portraits.PARAMETERS)))
    jacobian[0, 2] = 0.6 / spread[2]  # two units of noise for each of expectation
    known = made(MIDDLE, 0.3, 1.0, jacobian).knowledge(0.3)
    expected = np.ones(len(portraits.PARAMETERS))
    expected[2] = 1 / np.sqrt(5)
    np.testing.assert_allclose(known.narrowed, expected, rtol=1e-12)
    np.testing.assert_allclose(known.standard_errors, expected * spread, rtol=1e-12)
    assert known.strengths[0] == pytest.approx(2)
    assert np.sum(known.strengths > 1) == 1


@pytest.mark.slow
def test_the_experiment_writes_its_folder_and_the_same_bytes_again(tmp_path: Path):
    config = tmp_path / "small.toml"
    config.write_text(SMALL)
    first, second = (run(config, output=tmp_path / name, quiet=True) for name in ("one", "two"))
    names = {path.name for path in first.files}
    assert {"table.csv", "parameters.csv", "profiles.csv", "pictures.jpg", "residuals.svg", "knowledge.svg"} <= names
    for one, other in zip(first.files, second.files, strict=True):
        assert one.name == "run.json" or one.read_bytes() == other.read_bytes()
    with (first.folder / "table.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 6 * 12
    for row in table:
        ratio = 20 * np.log10(float(row["ours"]) / float(row["paper"]))
        assert float(row["difference_db"]) == pytest.approx(ratio, abs=1e-6)
    facts = json.loads((first.folder / "manifest.json").read_text())["results"]
    assert set(facts["rms_db"]) == {one for reading in READINGS for one in (reading, f"{reading}, last rows exchanged")}


def test_what_is_wrong_is_named(tmp_path: Path):
    (tmp_path / "small.toml").write_text(SMALL.replace("starts = 1", "starts = 9"))
    with pytest.raises(ConfigError, match=r"'starts' must not exceed 'candidates' \(2\), got 9"):
        run(tmp_path / "small.toml", quiet=True)
