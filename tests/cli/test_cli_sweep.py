from pathlib import Path

import pytest

from jaxlens import experiments


@pytest.fixture
def calls(monkeypatch):
    recorded = []
    monkeypatch.setattr(experiments, "run", lambda *args, **options: recorded.append((args, options)))
    return recorded


def test_arguments_reach_the_experiment(run, calls, picture, tmp_path):
    config = tmp_path / "experiment.toml"
    config.write_text("")
    assert run("sweep", config).code == 0
    assert run("sweep", config, "--image", picture, "--output", tmp_path / "out").code == 0
    (first, plain), (second, both) = calls
    assert first == second == (config,)
    assert (plain["image"], plain["output"]) == (None, None)
    assert (both["image"], both["output"]) == (picture, Path(tmp_path / "out"))


@pytest.mark.parametrize(
    ("error", "code"), [(experiments.ConfigError("kappa is a word"), 2), (experiments.ExperimentError("no space"), 1)]
)
def test_failures(run, monkeypatch, tmp_path, error, code):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(experiments, "run", fail)
    config = tmp_path / "experiment.toml"
    config.write_text("")
    result = run("sweep", config)
    assert result.code == code
    assert str(error) in result.err
    assert result.out == ""


def test_missing_files(run, calls, tmp_path):
    config = tmp_path / "experiment.toml"
    assert run("sweep", config).code == 2
    config.write_text("")
    result = run("sweep", config, "--image", tmp_path / "no.png")
    assert result.code == 2
    assert "no.png" in result.err
    assert calls == []


@pytest.mark.parametrize("text", ["not toml at all [", "name = 3", ""])
def test_configurations_that_are_wrong(run, tmp_path, text, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("wrong.toml").write_text(text)
    result = run("sweep", "wrong.toml")
    assert result.code == 2
    assert "wrong.toml" in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.toml"]
