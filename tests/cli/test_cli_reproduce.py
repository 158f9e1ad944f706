from pathlib import Path

import pytest
from test_cli_entry import imported_by

from jaxlens import experiments
from jaxlens.experiments import config
from jaxlens.experiments.reproduction import Reproduction, Step

TINY = 'kind = "tiny"\nname = "{0}"\nlines = 3\n'
KIND = """
from pydantic import Field
from jaxlens.experiments import Experiment, Outcome
class Tiny(Experiment):
    lines: int = Field(ge=2)
    def run(self, configuration, folder, progress):
        (folder / "table.csv").write_text("a\\n1\\n")
        return Outcome([], {}, [])
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("experiments").mkdir()
    Path("experiments/tiny.py").write_text(KIND)
    Path("experiments/a.toml").write_text(TINY.format("a"))
    return tmp_path


@pytest.fixture
def calls(folder, monkeypatch):
    """What reaches the library, which hands back the steps that stand in its list."""
    recorded, steps = [], []

    def stand_in(*arguments, **options):
        recorded.append((arguments, options))
        return Reproduction(tuple(steps), Path("results/index.html"))

    monkeypatch.setattr(experiments, "reproduce", stand_in)
    return recorded, steps


def test_arguments_reach_the_experiments(run, calls):
    recorded, _ = calls
    assert run("reproduce").code == 0
    assert (
        run(
            "reproduce",
            "experiments/a.toml",
            "experiments",
            "--output",
            "o",
            "--only",
            "a",
            "b",
            "--force",
            "--self-contained",
        ).code
        == 0
    )
    ((first,), plain), ((second,), all_of_them) = recorded
    assert first == (Path("experiments"),)
    assert (plain["output"], plain["only"], plain["force"]) == (Path("results"), (), False)
    assert second == (Path("experiments/a.toml"), Path("experiments"))
    assert (plain["self_contained"], all_of_them["self_contained"]) == (False, True)
    assert (all_of_them["output"], all_of_them["only"], all_of_them["force"]) == (Path("o"), ("a", "b"), True)


def test_a_failure_is_named_and_the_exit_code(run, calls, monkeypatch):
    _, steps = calls
    configuration = config.load("experiments/a.toml")
    steps += [
        Step(configuration, Path("results/a"), "done"),
        Step(configuration, Path("results/a"), "skipped", "no such file"),
    ]
    assert run("reproduce").code == 0
    steps.append(
        Step(configuration, Path("results/a"), "failed", "no luck", 1.0, experiments.ExperimentError("no luck"))
    )
    result = run("reproduce")
    assert result.code == 1
    assert "1 of 3 experiments failed: a" in result.err
    assert "JAXLENS_TRACEBACK" not in result.err
    steps.append(Step(configuration, Path("results/a"), "failed", "k", 1.0, KeyError("k")))
    assert "JAXLENS_TRACEBACK=1" in run("reproduce").err
    monkeypatch.setenv("JAXLENS_TRACEBACK", "1")
    with pytest.raises(KeyError):
        run("reproduce")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "no file 'nowhere'"),
        (["experiments", "--only", "b"], "no experiment 'b'; there are a"),
        (["experiments", "--only"], "at least one"),
        (["experiments/wrong.toml"], "lines: got 1"),
        (["."], "no experiment's TOML file in the folder"),
    ],
)
def test_misuse_is_said_and_nothing_is_begun(run, folder, arguments, said):
    Path("experiments/wrong.toml").write_text(TINY.format("w").replace("3", "1", 1))
    if arguments[0] == "experiments":
        Path("experiments/wrong.toml").unlink()
    result = run("reproduce", *arguments)
    assert result.code == 2
    assert said in " ".join(result.err.split())
    assert result.out == ""
    assert not Path("results").exists()


def test_a_foreign_page_is_refused(run, folder):
    Path("results").mkdir()
    Path("results/index.html").write_text("mine")
    result = run("reproduce")
    assert result.code == 1
    assert "no page that jaxlens wrote" in result.err


def test_the_second_time_jax_is_not_even_imported(run, folder):
    assert run("reproduce").code == 0
    page = Path("results/index.html").read_bytes()
    code, modules, out = imported_by("reproduce")
    assert code == 0
    assert "up to date" in out
    assert not modules & {"jax", "jaxlib", "matplotlib", "equinox"}
    assert Path("results/index.html").read_bytes() == page
