"""Experiments that fit: lenses recovered, and a camera calibrated with several."""

import csv
import json

import jax
import numpy as np
import pytest
from paper_kinds import module_of

import jaxlens as jl
from jaxlens import experiments

pytestmark = pytest.mark.usefixtures("kinds")
kind = module_of("inversion")

INVERSION = """
kind = "inversion"
name = "small"
kappa = [[0.4]]
picture_noise = [0.0, 0.01]
picture_seeds = 2
point_noise = [0.0, 0.2]
point_seeds = 50
points = 40
[image]
source = "clouds"
height = 48
width = 56
peak = 200.0
"""
BOARDS = """
kind = "boards"
name = "camera"
corners = "corners.csv"
image_size = [640, 480]
held_out = 2
[[models]]
name = "k1 k2"
terms = 4
fixed = ["p1", "p2"]
reference_rms = 0.28
"""


def _rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_lenses_come_back(tmp_path):
    config = tmp_path / "inversion.toml"
    config.write_text(INVERSION)
    report = experiments.run(config, output=tmp_path / "out", quiet=True)
    assert [path.name for path in report.files] == [
        "errors.svg",
        "manifest.json",
        "run.json",
        "table.csv",
    ]
    rows = _rows(tmp_path / "out" / "table.csv")
    assert [(row["from"], float(row["noise"]), int(row["fits"]), int(row["failed"])) for row in rows] == [
        ("points", 0.0, 50, 0),
        ("points", 0.2, 50, 0),
        ("pictures", 0.0, 1, 0),
        ("pictures", 0.01, 2, 0),
    ]
    assert float(rows[0]["rms_error1"]) < 1e-12
    assert float(rows[2]["rms_error1"]) < 1e-9
    # Fifty fits: their spread is known to a tenth.
    assert float(rows[1]["rms_error1"]) / float(rows[1]["predicted1"]) == pytest.approx(1, abs=0.3)


@pytest.fixture
def corners(tmp_path):
    random = np.random.default_rng(0)
    board = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), -1).reshape(-1, 2)
    with jax.enable_x64(True):
        turns = random.uniform(-0.5, 0.5, (8, 3))
        places = np.column_stack([random.uniform(-3.5, -1.5, (8, 2)), random.uniform(6, 9, 8)])
        ideal = jl.fitting.Poses(turns, places).project(np.broadcast_to(board, (8, 30, 2)))
        seen = jl.Frame([320.0, 240.0], 500.0).denormalize(jl.BrownConrady([-0.2, 0.05, 0.0, 0.0]).distort(ideal))
    seen = np.asarray(seen) + 0.2 * random.normal(size=seen.shape)
    rows = [(view, i, *board[i], *seen[view, i]) for view in range(8) for i in range(30)]
    np.savetxt(tmp_path / "corners.csv", rows, delimiter=",", header="view,corner,board_x,board_y,x,y", comments="")
    return tmp_path / "corners.csv"


@pytest.mark.slow
def test_a_camera_is_judged_on_views_held_out(tmp_path, corners):
    config = tmp_path / "boards.toml"
    config.write_text(BOARDS)
    experiments.run(config, output=tmp_path / "out", quiet=True)
    (row,) = _rows(tmp_path / "out" / "models.csv")
    assert (row["not_identified"], row["folds"]) == ("none", "no")
    assert 0.2 < float(row["rms"]) < float(row["held_out_rms"]) < 0.5
    table = {row["parameter"]: row for row in _rows(tmp_path / "out" / "table.csv")}
    for name, truth in {"fx": 500, "fy": 500, "cx": 320, "cy": 240, "k1": -0.2, "k2": 0.05}.items():
        assert abs(float(table[name]["estimate"]) - truth) < 4 * float(table[name]["standard_error"])
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["inputs"][0]["file"] == "corners.csv"


def test_what_is_wrong_is_named(tmp_path, corners):
    config = tmp_path / "boards.toml"
    config.write_text(BOARDS.replace("corners.csv", "none.csv"))
    with pytest.raises(experiments.ConfigError, match=r"corners: got 'none\.csv'; there is no such CSV file"):
        experiments.run(config, output=tmp_path / "out", quiet=True)
    config.write_text(BOARDS)
    with pytest.raises(experiments.ConfigError, match="takes no picture"):
        experiments.run(config, image=corners, output=tmp_path / "out", quiet=True)
    corners.write_text("view,corner\n1,2\n")
    with pytest.raises(experiments.ExperimentError, match="line 1: no column board_x"):
        experiments.run(config, output=tmp_path / "out", quiet=True)
    config.write_text(INVERSION.replace("[[0.4]]", "[[0.4], [0.1, 0.2]]"))
    with pytest.raises(experiments.ConfigError, match="vectors of one length"):
        experiments.run(config, output=tmp_path / "out", quiet=True)
    assert not (tmp_path / "out").exists()


def test_the_interval_of_a_standard_error():
    """Its ends are those of χ² with as many freedoms as fits: 0.8312 and 12.8325 of five, in tables."""
    np.testing.assert_allclose(kind.chance(5), (np.sqrt(5 / 12.8325), np.sqrt(5 / 0.8312)), rtol=1e-4)
