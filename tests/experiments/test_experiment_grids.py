"""Which sign is barrel: Figures 3 and 4 of the paper, and Figure 6's counts."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from paper_kinds import module_of

from jaxlens.experiments import run

pytestmark = pytest.mark.usefixtures("kinds")
kind = module_of("grids")


@pytest.mark.parametrize(
    ("setting", "k", "name"),
    [
        ("lens", 0.3, "pincushion"),
        ("lens", -0.3, "barrel"),
        ("section 2.4", -0.3, "pincushion"),
        ("section 2.4", 0.3, "barrel"),
        ("division", -0.3, "pincushion"),
        ("division", 0.3, "barrel"),
        ("lens", 0.0, "straight"),
        ("lens", -9.0, "not shown"),
    ],
)
def test_curves_and_pictures_agree_on_barrel_and_pincushion(setting: kind.Setting, k: float, name: str):
    size = 61
    curve, raster = kind.bend_of_curve(setting, k, size), kind.bend_of_picture(setting, k, size)
    assert curve.name == raster.name == name
    if name != "not shown":
        assert raster.pixels == pytest.approx(curve.pixels, abs=0.05)


def test_lines_of_the_curves_are_dark_in_the_picture():
    size, lines = 61, 5
    shown = np.asarray(kind.picture("lens", 0.3, kind.straight_picture(lines, size)))
    middle = kind.curves("lens", 0.3, lines)[lines // 2]
    columns, rows = (middle.T + kind.HALF) * size / (2 * kind.HALF)
    inside = (rows > 2) & (rows < size - 2)
    assert shown[np.round(rows[inside]).astype(int), np.round(columns[inside]).astype(int)].max() < 0.3
    assert shown.mean() > 0.6


def test_the_grids_experiment_writes_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("g.toml").write_text('kind = "grids"\nname = "g"\nlines = 3\nsize = 61\nk = [0.3]\n', encoding="utf-8")
    report = run("g.toml", quiet=True)
    names = [path.name for path in report.files]
    assert names == ["grids.svg", "manifest.json", "rasters.png", "run.json", "table.csv"]
    rows = (report.folder / "table.csv").read_text().splitlines()
    assert [row.split(",")[:3] for row in rows[1:]] == [
        ["lens", "0.3", "pincushion"],
        ["section 2.4", "0.3", "barrel"],
        ["division", "0.3", "barrel"],
    ]


def test_the_panels_experiment_counts_every_pixel_once(folder: Path):
    Path("p.toml").write_text(
        'kind = "panels"\nname = "p"\nkappa = [[0, 1], [-0.2, 0]]\n[image]\npath = "tiny.png"\n', encoding="utf-8"
    )
    report = run("p.toml", quiet=True)
    assert [path.name for path in report.files] == ["manifest.json", "panels.jpg", "run.json", "table.csv"]
    header, *rows = [line.split(",") for line in (report.folder / "table.csv").read_text().splitlines()]
    for row in rows:
        found = dict(zip(header, map(float, row), strict=True))
        assert found["source_pixels"] == 480
        assert found["not_shown"] + found["shown_once"] + found["multiple_positions"] == 480
    assert jnp.asarray(float(rows[0][header.index("multiple_positions")])) > 0


def test_the_readings_experiment_reports_each_reading_of_each_image(folder: Path):
    Path("r.toml").write_text(
        'kind = "readings"\nname = "r"\n[[images]]\npath = "tiny.png"\npeak = 193.0\n', encoding="utf-8"
    )
    report = run("r.toml", quiet=True)
    names = {path.name for path in report.files}
    assert {"table.csv", "scores.csv", "distances.svg", "psnr.svg", "pictures.jpg"} <= names
    rows = (report.folder / "table.csv").read_text().splitlines()
    assert [row.split(",")[:2] for row in rows[1:]] == [
        ["tiny.png", reading] for reading in ("functional inverse", "reciprocal", "direct")
    ]
