"""Distances from the nose tip: the experiment on a small face and on a mesh, and what it measures on a sphere's cap."""

import csv
import json
from pathlib import Path

import jax
import numpy as np
import pytest
from paper_kinds import module_of

from jaxlens.experiments import ConfigError, ExperimentError, run

pytestmark = pytest.mark.usefixtures("kinds")
kind = module_of("geodesics")

SMALL = """
kind = "geodesics"
name = "small"
paths = 4
sizes = [16, 32]
[surface]
source = "face"
height = 48
width = 40
"""
FILES = [
    "convergence.svg",
    "errors.csv",
    "manifest.json",
    "maps.jpg",
    "paths.jpg",
    "ratios.png",
    "run.json",
    "table.csv",
]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_the_experiment_writes_its_folder_and_the_same_bytes_again(tmp_path: Path):
    config = tmp_path / "small.toml"
    config.write_text(SMALL)
    first, second = (run(config, output=tmp_path / name, quiet=True) for name in ("one", "two"))
    assert [path.name for path in first.files] == FILES
    for one, other in zip(first.files, second.files, strict=True):
        assert one.name == "run.json" or one.read_bytes() == other.read_bytes()
    table = rows(first.folder / "table.csv")
    assert len(table) == 4
    for row in table:
        assert float(row["planar"]) < float(row["geodesic"]) <= 1.01 * float(row["radial"])
    errors = rows(first.folder / "errors.csv")
    assert [(row["distance"], row["size"]) for row in errors][:2] == [
        ("radial, from the apex", size) for size in ("16", "32")
    ]
    manifest = json.loads((first.folder / "manifest.json").read_text())
    assert manifest["results"]["geodesic_over_planar_mean"] > 1
    assert manifest["results"]["radial_over_geodesic_mean"] >= 1


def test_on_a_sphere_the_radial_distance_is_of_second_order_and_the_geodesic_one_of_first(x64):
    radial, geodesic, elsewhere = kind.cap_convergence([32, 64], 1.5, "float64")
    assert radial.orders[1] == pytest.approx(2, abs=0.1)
    assert 0.9 < geodesic.orders[1] < 1.5
    assert 0.9 < elsewhere.orders[1] < 1.5
    assert radial.mean[1] < 5e-5 < geodesic.mean[1] < elsewhere.mean[1] < 1e-3
    assert all(np.isnan(one.orders[0]) for one in (radial, geodesic, elsewhere))


TENT = """v -10 -10 0
v 10 -10 0
v 10 10 0
v -10 10 0
v 0 0 5
f 1 2 5
f 2 3 5
f 3 4 5
f 4 1 5
"""


def test_a_mesh_stands_in_for_the_face(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A pyramid whose tip is its nose: along its axes radial and geodesic distance are the slanted edge's."""
    pytest.importorskip("trimesh")
    (tmp_path / "tent.obj").write_text(TENT)
    with jax.enable_x64(True):
        found = kind.surface_distances(kind.Surface(path="tent.obj", height=41, width=41), tmp_path)
        ways = kind.ways_to(found, 4, 0.8)
    np.testing.assert_allclose(found.source, [20, 20], atol=0.6)
    for way in ways:
        assert way.radial == pytest.approx(np.hypot(1, 0.5) * way.planar, rel=0.03)
        assert way.geodesic == pytest.approx(way.radial, rel=0.03)
        np.testing.assert_array_equal(way.points[0], way.start)
        np.testing.assert_allclose(way.points[-1], found.source, atol=0.6)


def test_what_is_wrong_is_named(tmp_path: Path):
    config = tmp_path / "small.toml"
    for old, new, said in (
        ('source = "face"', 'path = "gone.obj"', r"surface\.path: got 'gone\.obj'; there is no such mesh file"),
        ('source = "face"', "", "either 'source' or 'path'"),
        ("[16, 32]", "[32, 16]", "'sizes' must grow"),
        ("paths = 4", "reach = 1.5", r"reach: got 1\.5"),
    ):
        config.write_text(SMALL.replace(old, new))
        with pytest.raises(ConfigError, match=said):
            run(config, quiet=True)
    config.write_text(SMALL)
    with pytest.raises(ConfigError, match="takes no picture"):
        run(config, image=config, quiet=True)
    (tmp_path / "bad.obj").write_text("v 0 0 0\n")
    config.write_text(SMALL.replace('source = "face"', 'path = "bad.obj"'))
    with pytest.raises(ExperimentError, match=r"bad\.obj"):
        run(config, output=tmp_path / "out", quiet=True)
    assert not (tmp_path / "out").exists()
