"""The acceptance of Table 1 on the portrait, from the committed configurations."""

import csv
import io
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from jaxlens.experiments import config, paper, run
from jaxlens.experiments.paper import READINGS
from jaxlens.experiments.sources import load_source
from jaxlens.experiments.sweep.scoring import deform_all

ROOT = Path(__file__).parents[2]
CONFIGURATION = ROOT / "experiments" / "table1.toml"
COMMITTED = ROOT / "results" / "table1" / "table.csv"


def read(text: str) -> dict[tuple[float, float], dict[str, float]]:
    rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(io.StringIO(text))]
    return {(row["kappa1"], row["kappa2"]): row for row in rows}


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[float, float], dict[str, float]]:
    folder = tmp_path_factory.mktemp("results") / "table1"
    run(CONFIGURATION, output=folder, console=Console(quiet=True), progress=Console(quiet=True))
    return read((folder / "table.csv").read_text())


def test_psnr_is_within_a_decibel_of_the_papers(table: dict):
    for kappa in ((1.0, 2.0), (1.0, 3.0), (2.0, 3.0), (3.0, 2.0)):
        row = paper.row_of(kappa)
        assert row is not None
        assert table[kappa]["psnr"] == pytest.approx(row.psnr, abs=1.0)


def test_rmse_and_psnr_are_tied_by_the_peak(table: dict):
    assert len(table) == 6
    for row in table.values():
        assert paper.implied_peak(row["psnr"], row["rmse"]) == pytest.approx(193.0, rel=1e-8)


def test_psnr_falls_with_growing_coefficients(table: dict):
    psnr = [table[kappa]["psnr"] for kappa in paper.FALLING]
    assert psnr == sorted(psnr, reverse=True)


def test_psnr_less_snr_is_constant(table: dict):
    offsets = np.array([row["psnr"] - row["snr"] for row in table.values()])
    np.testing.assert_allclose(offsets, offsets[0], rtol=1e-7)


def test_the_committed_table_comes_out(table: dict):
    if not COMMITTED.exists():
        pytest.skip("results/table1 is not in this copy")
    committed = read(COMMITTED.read_text())
    assert committed.keys() == table.keys()
    for kappa, row in committed.items():
        assert table[kappa] == pytest.approx(row, rel=1e-8)


def distances(label: str) -> dict[str, float]:
    configuration = config.load(ROOT / "experiments" / "readings.toml")
    (image,) = (image for image in configuration.experiment.images if image.label == label)
    kappa = np.array([row.kappa for row in paper.TABLE_1])
    found = {}
    with jax.enable_x64(True):
        source = load_source(configuration, image)
        for reading in READINGS:
            pictures = deform_all(source.pixels, kappa, configuration.experiment.warp, reading)
            errors = [np.mean((picture - source.pixels) ** 2) for picture in pictures]
            psnr = [20 * np.log10(source.peak / np.sqrt(error)) for error in errors]
            found[reading] = paper.distance(psnr, [row.psnr for row in paper.TABLE_1])
    return found


@pytest.mark.parametrize("label", ["portrait, middle square", "face"])
def test_on_the_portrait_the_functional_inverse_is_nearest_to_the_paper(label: str):
    found = distances(label)
    assert found["functional inverse"] < min(found["reciprocal"], found["direct"]) - 0.4
    assert found["functional inverse"] < 1.6


def test_on_a_head_on_black_the_direct_reading_is_nearest():
    found = distances("head on black, drawn")
    assert found["direct"] < 1 < 3 < found["functional inverse"] < found["reciprocal"]
