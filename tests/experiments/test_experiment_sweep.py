import io
import json
import shutil
from pathlib import Path

import jax
import numpy as np
import PIL.Image
import pytest
from rich.console import Console

from jaxlens.experiments import ExperimentError, config, run
from jaxlens.experiments.schema import Warp
from jaxlens.experiments.sweep import SweepExperiment
from jaxlens.experiments.sweep.scoring import estimated_bytes, lanes_within, score_lenses
from jaxlens.experiments.tables import csv_text
from jaxlens.files import file_sha256

FILES = [
    "coverage.jpg",
    "deformed.jpg",
    "errors.jpg",
    "manifest.json",
    "metrics.svg",
    "run.json",
    "table.csv",
]
METRICS = ["snr", "psnr", "rmse", "mae", "mse", "range_snr", "uqi", "ssim", "minkowski", "coverage"]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_second_run_gives_the_same_bytes_and_replaces_the_first(first_run, folder: Path):
    shutil.copytree(first_run.report.folder, "results/tiny")
    before = contents(first_run.report.folder)
    second = run("tiny.toml", quiet=True)
    assert second.folder == Path("results/tiny")
    assert [path.name for path in second.files] == FILES
    after = contents(second.folder)
    for found in (before, after):
        del found["run.json"]
    assert after == before
    assert [path.name for path in Path("results").iterdir()] == ["tiny"]


def test_the_table(first_run):
    lines = (first_run.report.folder / "table.csv").read_bytes().decode().split("\n")
    assert lines[0] == ",".join(["kappa1", "kappa2", *METRICS])
    assert lines[-1] == ""
    assert [line.split(",")[:2] for line in lines[1:-1]] == [
        list(pair) for pair in ("01", "12", "13", "23", "32", "31")
    ]
    for cell in lines[1].split(","):
        assert len(cell.replace(".", "").replace("-", "").lstrip("0")) <= 9


def test_the_manifest(first_run):
    text = (first_run.report.folder / "manifest.json").read_text()
    manifest = json.loads(text)
    assert manifest == first_run.report.manifest
    assert manifest["experiment"] == "tiny"
    assert (manifest["dtype"], manifest["seed"]) == ("float64", 0)
    assert manifest["configuration_sha256"] == config.load(first_run.config).digest()
    assert manifest["inputs"][0]["file"] == "tiny.png"
    assert sorted([*manifest["files"], "manifest.json", "run.json"]) == FILES
    assert str(first_run.config.parent) not in text


def test_without_a_lens_the_picture_is_identical(folder: Path):
    text = Path("tiny.toml").read_text(encoding="utf-8").replace("[[0, 1],", "[[0, 0], [0, 1],")
    Path("tiny.toml").write_text(text, encoding="utf-8")
    printed = io.StringIO()
    report = run("tiny.toml", console=Console(file=printed, width=100), progress=Console(quiet=True))
    header, first, *_ = (line.split(",") for line in (report.folder / "table.csv").read_text().splitlines())
    row = dict(zip(header, map(float, first), strict=True))
    assert row["psnr"] == row["snr"] == np.inf
    assert row["rmse"] == row["mae"] == 0
    assert "in all 6 rows" in printed.getvalue()


def test_the_report_says_that_the_papers_picture_is_not_published(first_run):
    assert "The paper does not publish its picture" in first_run.stdout


def test_the_record_of_the_run_holds_what_differs_from_run_to_run(first_run):
    record = json.loads((first_run.report.folder / "run.json").read_text())
    assert record == first_run.report.record
    assert {"python", "jax", "jaxlib", "numpy", "jaxlens"} <= set(record["versions"])
    assert {"commit", "sources", "device", "platform", "date", "seconds"} <= set(record)
    assert not set(record) & set(first_run.report.manifest)
    assert record["manifest_sha256"] == file_sha256(first_run.report.folder / "manifest.json")


def test_the_report_shows_ours_the_papers_and_what_holds(first_run):
    for part in ("9.338", "16.314", "54.572*", "32.127*", "61.742", "170.587", "193.000 in all 6 rows", "6.97548"):
        assert part in first_run.stdout
    assert "6/6" in first_run.stderr


def test_an_interrupted_run_leaves_the_earlier_results(first_run, folder: Path, monkeypatch: pytest.MonkeyPatch):
    shutil.copytree(first_run.report.folder, "results/tiny")
    before = contents(Path("results/tiny"))

    def interrupted(experiment, configuration, temporary: Path, progress: Console):
        (temporary / "table.csv").write_text("kappa1,ka")
        raise KeyboardInterrupt

    monkeypatch.setattr(SweepExperiment, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run("tiny.toml", quiet=True)
    assert contents(Path("results/tiny")) == before
    assert [path.name for path in Path("results").iterdir()] == ["tiny"]


def test_a_foreign_folder_is_refused_before_any_work(folder: Path, monkeypatch: pytest.MonkeyPatch):
    Path("mine").mkdir()
    Path("mine/thesis.tex").write_text("years of work")
    monkeypatch.setattr(SweepExperiment, "run", lambda *arguments: pytest.fail("began to work"))
    with pytest.raises(ExperimentError, match=r"thesis\.tex"):
        run("tiny.toml", quiet=True, output="mine")
    assert contents(Path("mine")) == {"thesis.tex": b"years of work"}


def test_a_broken_picture_gives_a_message_and_no_folder(folder: Path):
    (folder / "tiny.png").write_bytes((folder / "tiny.png").read_bytes()[:200])
    with pytest.raises(ExperimentError, match=r"tiny\.png"):
        run("tiny.toml", quiet=True)
    assert not Path("results").exists()


@pytest.mark.parametrize(("value", "said"), [((0, 0, 0, 255), "black"), ((9, 9, 9, 99), "transparent")])
def test_pictures_that_cannot_serve_are_refused(folder: Path, value: tuple[int, ...], said: str):
    PIL.Image.new("RGBA", (16, 16), value).save("bad.png")
    with pytest.raises(ExperimentError, match=said):
        run("tiny.toml", image="bad.png", quiet=True)
    assert not Path("results").exists()


def test_axes_make_grids_of_any_order(folder: Path):
    text = Path("tiny.toml").read_text(encoding="utf-8").replace('compare = "table1"', "")
    head = text[: text.index("kappa = ")]
    axis = "{ start = -0.2, stop = 0.4, count = %d }"
    for name, axes in {"line": (13,), "plane": (4, 5)}.items():
        listed = ", ".join(axis % count for count in axes)
        Path("grid.toml").write_text(head.replace("tiny", name, 1) + f"axes = [{listed}]", encoding="utf-8")
        report = run("grid.toml", image="tiny.png", quiet=True)
        rows = (report.folder / "table.csv").read_text().splitlines()
        assert len(rows) == 1 + np.prod(axes)
        assert rows[0].startswith(",".join(f"kappa{index + 1}" for index in range(len(axes))) + ",snr,")
        assert (report.folder / "metrics.svg").exists()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_results_do_not_depend_on_how_the_grid_is_cut(dtype: str):
    pixels = np.random.default_rng(0).uniform(0, 193, (20, 24)).astype(dtype)
    kappa = np.random.default_rng(1).uniform(-0.3, 3, (7, 2))
    with jax.enable_x64(dtype == "float64"):
        tables = [
            csv_text(score_lenses(pixels, kappa, peak=193.0, warp=Warp(), chunk=chunk, memory_mb=0.1))
            for chunk in (1, 3, 7)
        ]
    assert tables[0] == tables[1] == tables[2]


def test_the_budget_bounds_the_lenses_computed_side_by_side():
    pixels = np.zeros((512, 512))
    assert lanes_within(1e-3, pixels) == 1
    assert lanes_within(2.5 * estimated_bytes(pixels) / 1e6, pixels) == 2
    assert lanes_within(1e9, pixels) == 4


def test_csv_has_nine_significant_digits_and_no_negative_zero():
    text = csv_text({"name": ["a", "b"], "value": np.array([1 / 3, -0.0]), "count": [1234567890123, 2]})
    assert text == "name,value,count\na,0.333333333,1234567890123\nb,0,2\n"
    assert csv_text({"x": [float("inf"), float("nan")]}) == "x\ninf\nnan\n"
