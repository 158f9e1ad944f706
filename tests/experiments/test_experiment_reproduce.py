"""What is run again and what is not, and what becomes of the others when one fails."""

import json
from html import unescape
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from paper_kinds import copy_kinds

from jaxlens.experiments import ConfigError, Experiment, ExperimentError, Outcome, config, reproduce, reproduction

KIND = """
from pydantic import Field
from jaxlens.experiments import Experiment, Image
class Tiny(Experiment):
    lines: int = Field(default=3, ge=2)
    image: Image | None = None
"""
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 4 3"><path d="M0 0L4 3"/></svg>'


def write(name: str, *lines: str) -> Path:
    """A configuration, and beside it a kind that needs nothing."""
    path = Path("experiments") / f"{name}.toml"
    path.parent.mkdir(exist_ok=True)
    path.with_name("tiny.py").write_text(KIND, encoding="utf-8")
    path.write_text("\n".join(['kind = "tiny"', f'name = "{name}"', *lines]) + "\n", encoding="utf-8")
    return path


def write_with_picture(name: str) -> Path:
    path = write(name)
    PIL.Image.fromarray(np.full((4, 5), 99, np.uint8)).save("experiments/in.png")
    path.write_text(f'kind = "tiny"\nname = "{name}"\nimage = {{ path = "in.png" }}\n', encoding="utf-8")
    return path


class Performer:
    """Stands in for the experiments: writes a figure and a table, and counts; or fails where it is told to."""

    def __init__(self) -> None:
        self.ran: list[str] = []
        self.failures: dict[str, BaseException] = {}

    def __call__(self, configuration, folder, progress) -> Outcome:
        name = configuration.experiment.name
        if name in self.failures:
            raise self.failures[name]
        self.ran.append(name)
        (folder / "chart.svg").write_text(SVG)
        PIL.Image.fromarray(np.zeros((3, 4), np.uint8)).save(folder / "chart.png")
        (folder / "table.csv").write_text(f"name,value\n{name},1.5\n")
        return Outcome([], {}, [])

    def since(self) -> list[str]:
        """What ran since this was last asked."""
        ran, self.ran = self.ran, []
        return ran


@pytest.fixture
def performer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Performer:
    """Two experiments, `a` and `b`, in a folder that becomes the current one."""
    monkeypatch.chdir(tmp_path)
    stand_in = Performer()
    monkeypatch.setattr(Experiment, "run", stand_in)
    write("a")
    write("b")
    return stand_in


def again(**options) -> dict[str, str]:
    return {step.name: step.state for step in reproduce(["experiments"], quiet=True, **options).steps}


def test_the_second_time_nothing_is_done(performer: Performer):
    assert again() == {"a": "done", "b": "done"}
    page = Path("results/index.html")
    before = (page.read_bytes(), page.stat().st_ino, page.stat().st_mtime_ns)
    assert performer.since() == ["a", "b"]
    assert again() == {"a": "up to date", "b": "up to date"}
    assert performer.since() == []
    assert (page.read_bytes(), page.stat().st_ino, page.stat().st_mtime_ns) == before
    assert sorted(path.name for path in Path("results").iterdir()) == ["a", "b", "index.html"]


def edit(name: str, **changes: object) -> None:
    path = Path("results/a") / name
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda: write("a", "lines = 7"), "the configuration has changed"),
        (lambda: Path("results/a/table.csv").write_text("mine"), "table.csv is missing or has changed"),
        (lambda: Path("results/a/chart.png").unlink(), "chart.png is missing or has changed"),
        (lambda: Path("results/a/manifest.json").write_text("{}"), None),
        (lambda: edit("run.json", sources={}), "the source has changed: beside.tiny, jaxlens"),
        (lambda: edit("run.json", sources=None), "the source has changed: beside.tiny, jaxlens"),
        (lambda: edit("run.json", versions={"jax": "0.1"}), "jax is"),
        (lambda: edit("run.json", versions=None), "jax is"),
        (lambda: edit("manifest.json", input_files={"image.path": "0"}), "an input has changed"),
        (lambda: edit("manifest.json", seed=1), "there is no record of the run that made them"),
        (lambda: Path("results/a/run.json").unlink(), "there is no record of the run that made them"),
        (lambda: Path("results/a/run.json").write_text("["), "there is no record of the run that made them"),
    ],
)
def test_what_makes_results_out_of_date(performer: Performer, change, reason: str | None):
    again()
    performer.since()
    change()
    if reason is None:
        # A folder that no manifest declares to be results is somebody's own.
        assert again() == {"a": "failed", "b": "up to date"}
        assert performer.since() == []
        return
    said = reproduction.out_of_date(config.load("experiments/a.toml"), Path("results/a"))
    assert said is not None
    assert said.startswith(reason)
    assert again() == {"a": "done", "b": "up to date"}
    assert performer.since() == ["a"]
    assert again() == {"a": "up to date", "b": "up to date"}


def test_captions_comments_and_the_version_of_jaxlens_change_no_result(performer: Performer):
    again()
    versions = json.loads(Path("results/a/run.json").read_text())["versions"]
    edit("run.json", versions=versions | {"jaxlens": "9", "python": "9"})
    write("a", "# a comment", 'caption = "Seen anew."', "order = 5000", "[captions]", 'chart = "A line."')
    performer.since()
    assert list(again().items()) == [("b", "up to date"), ("a", "up to date")]
    assert performer.since() == []
    page = Path("results/index.html").read_text(encoding="utf-8")
    assert "Seen anew." in page
    assert "A line." in page


def test_a_clone_has_the_results_and_the_page_but_no_record_of_the_runs(performer: Performer):
    again()
    kept = [path for path in Path("results").rglob("*") if path.is_file() and path.name != "run.json"]
    before = {path: path.read_bytes() for path in kept}
    for record in Path("results").rglob("run.json"):
        record.unlink()
    assert again(only=["b"]) == {"a": "left out", "b": "done"}
    assert {path: path.read_bytes() for path in kept} == before
    assert again() == {"a": "done", "b": "up to date"}
    assert {path: path.read_bytes() for path in kept} == before


def test_a_missing_input_is_said_and_earlier_results_are_shown(performer: Performer):
    write_with_picture("a")
    assert again() == {"a": "done", "b": "done"}
    Path("experiments/in.png").rename("away.png")
    assert again() == {"a": "skipped", "b": "up to date"}
    page = unescape(Path("results/index.html").read_text(encoding="utf-8"))
    assert "image.path: got 'in.png'; there is no such picture file" in page
    assert "What is shown are earlier results." in page
    assert "a/chart.svg" in page
    PIL.Image.fromarray(np.full((4, 5), 98, np.uint8)).save("experiments/in.png")
    assert again() == {"a": "done", "b": "up to date"}
    Path("away.png").replace("experiments/in.png")
    assert again(only=["b"]) == {"a": "left out", "b": "up to date"}
    assert "an input has changed" in Path("results/index.html").read_text(encoding="utf-8")


def test_a_missing_input_without_results(performer: Performer):
    write_with_picture("a")
    Path("experiments/in.png").unlink()
    assert again() == {"a": "skipped", "b": "done"}
    page = Path("results/index.html").read_text(encoding="utf-8")
    assert "no results" in page
    assert "earlier" not in page
    assert performer.since() == ["b"]


@pytest.mark.parametrize(
    ("error", "said"),
    [(ExperimentError("the crop is <b>off</b>"), "the crop is &lt;b&gt;off"), (KeyError("k"), "KeyError")],
)
def test_a_failure_does_not_stop_the_others(performer: Performer, error: Exception, said: str):
    again()
    performer.since()
    performer.failures["a"] = error
    (a, b) = reproduce(["experiments"], force=True, quiet=True).steps
    assert (a.state, b.state) == ("failed", "done")
    assert a.error is error
    assert performer.since() == ["b"]
    page = Path("results/index.html").read_text(encoding="utf-8")
    assert said in page
    assert "What is shown are earlier results." in page
    assert (Path("results/a/table.csv")).read_text() == "name,value\na,1.5\n"


def test_what_is_done_stays_when_the_work_is_interrupted(performer: Performer):
    performer.failures["b"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        again()
    assert [path.name for path in Path("results").iterdir()] == ["a"]
    performer.failures.clear()
    assert again() == {"a": "up to date", "b": "done"}


def test_some_by_name_and_all_by_force(performer: Performer):
    assert again(only=["b"]) == {"a": "left out", "b": "done"}
    assert "there are no results yet" in Path("results/index.html").read_text(encoding="utf-8")
    assert again(only=["b"], force=True) == {"a": "left out", "b": "done"}
    assert again(force=True) == {"a": "done", "b": "done"}
    assert performer.since() == ["b", "b", "a", "b"]
    with pytest.raises(ConfigError, match="no experiment 'c'; there are a, b"):
        again(only=["c"])


def test_files_and_folders_are_taken_once(performer: Performer):
    found = reproduce(["experiments/b.toml", "experiments"], output="out", quiet=True)
    assert [step.name for step in found.steps] == ["a", "b"]
    assert found.page == Path("out/index.html")


def test_every_mistake_is_told_before_anything_is_begun(performer: Performer):
    write("A")
    write("b", "lines = 1")
    write("c", "size = 'large'")
    with pytest.raises(ConfigError) as caught:
        again()
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert any("name: got 'a'; experiments/A.toml has it already" in line for line in lines)
    Path("empty").mkdir()
    with pytest.raises(ConfigError, match="no experiment's TOML file in the folder 'empty'"):
        reproduce(["empty"], quiet=True)
    assert performer.since() == []
    assert not Path("results").exists()


def test_what_is_not_ours_is_left_alone(performer: Performer):
    Path("results").mkdir()
    Path("results/notes.txt").write_text("mine")
    Path("results/index.html").write_text("<!DOCTYPE html>\n<p>my page")
    with pytest.raises(ExperimentError, match="no page that jaxlens wrote"):
        again()
    assert performer.since() == []
    Path("results/index.html").unlink()
    again()
    Path("results/a/notes.txt").write_text("mine")
    assert again() == {"a": "up to date", "b": "up to date"}
    assert again(force=True) == {"a": "failed", "b": "done"}
    assert Path("results/notes.txt").read_text() == Path("results/a/notes.txt").read_text() == "mine"
    with pytest.raises(ExperimentError, match="is not a folder"):
        again(output="results/notes.txt")


def test_what_is_said(performer: Performer, capsys: pytest.CaptureFixture[str]):
    performer.failures["b"] = ExperimentError("no [luck]")
    reproduce(["experiments"])
    out, err = capsys.readouterr()
    said = err.splitlines()
    assert said[0] == "a: running experiments/tiny.py (there are no results yet)"
    assert said[1].startswith("a: done in ")
    assert said[3] == "b: failed: no [luck]"
    assert "no [luck]" in out
    assert "results/index.html: 0.0 MB" in out.splitlines()


def test_an_experiment_is_carried_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    path = write("g", "lines = 3", "size = 61", "k = [0.3]")
    path.write_text(path.read_text().replace("tiny", "grids"))
    copy_kinds(path.parent)
    assert again() == {"g": "done"}
    assert again() == {"g": "up to date"}
    page = Path("results/index.html").read_text(encoding="utf-8")
    assert page.count("<figure ") == 2
    assert "pincushion" in page
