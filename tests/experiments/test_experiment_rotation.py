"""The focal length of a rotating camera: too short with pincushion, too long with barrel, right once undistorted."""

import csv
import json
from pathlib import Path

import jax
import numpy as np
import pytest
from paper_kinds import copy_kinds, module_of
from scipy.spatial.transform import Rotation

import jaxlens as jl
from jaxlens.experiments import ConfigError, run
from jaxlens.self_calibration import RotatingCamera, focal_length_bias

rotations_of = module_of("rotation").rotations_of

SMALL = """
kind = "rotation"
name = "small"
k = [-0.05, -0.02, 0.02, 0.05]
points = 50
seeds = 4
[[rotations]]
name = "pans"
turns = [[12, 0, 0], [-12, 0, 0]]
[[rotations]]
name = "mixed"
turns = [[10, 5, 20], [-4, 9, -30]]
"""


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("rotation")
    copy_kinds(folder)
    (folder / "small.toml").write_text(SMALL)
    first, second = (run(folder / "small.toml", output=folder / name, quiet=True) for name in ("one", "two"))
    assert [path.name for path in first.files] == ["bias.svg", "manifest.json", "run.json", "table.csv"]
    return first.folder, second.folder


def test_a_second_run_gives_the_same_bytes(folders: tuple[Path, Path]):
    for name in ("bias.svg", "table.csv"):
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_signs_growth_and_what_undistortion_leaves(folders: tuple[Path, Path]):
    with (folders[0] / "table.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["rotations"] for row in table] == ["pans"] * 4 + ["mixed"] * 4
    for row in table:
        k, bias = float(row["k"]), float(row["bias"])
        assert np.sign(bias) == -np.sign(k)
        assert abs(float(row["bias_lens_known"])) < 1e-12
        assert abs(float(row["rms_bias_lens_fitted"])) < 0.1 * abs(bias)
    facts = json.loads((folders[0] / "manifest.json").read_text())["results"]
    assert facts["short_for_every_pincushion"]
    assert facts["long_for_every_barrel"]
    assert facts["grows_with_the_lens"]
    with jax.enable_x64(True):
        camera = RotatingCamera(jl.RadialPolynomial([0.05]), 1.5)
        expected = focal_length_bias(camera, rotations=rotations_of([[12, 0, 0], [-12, 0, 0]], "float64"))
    assert float(table[3]["bias"]) == pytest.approx(float(expected), rel=1e-7)


def test_turns_are_pan_tilt_and_roll_in_degrees(x64):
    """A pan is about y (down), a tilt about x (right), a roll about z (forward)."""
    found = rotations_of([[10, 0, 0], [0, 20, 0], [0, 0, 30], [3, 4, 5]], "float64")
    vectors = np.radians([[0, 10, 0], [20, 0, 0], [0, 0, 30], [4, 3, 5]])
    np.testing.assert_allclose(found, Rotation.from_rotvec(vectors).as_matrix(), atol=1e-15)


@pytest.mark.usefixtures("kinds")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.02, 0.05]", "0.05, 0.02]", "'k' must grow"),
        ('"mixed"', '"pans"', "different names"),
        ("[-12, 0, 0]", "[-12, 0]", "at least 3"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, said: str):
    (tmp_path / "small.toml").write_text(SMALL.replace(old, new))
    with pytest.raises(ConfigError, match=said):
        run(tmp_path / "small.toml", quiet=True)
