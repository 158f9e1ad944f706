"""The pages and the docstrings: whatever code they show runs, and gives what they say."""

import ast
import doctest
import importlib
import pathlib
import re

import jax
import pytest

import jaxlens as jl

ROOT = pathlib.Path(__file__).parents[1]
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])

EXTENDING = "docs/extending.md"  # runs in a test of its own


@pytest.fixture(autouse=True)
def _as_users_run_it(tmp_path, monkeypatch):
    """An empty folder, JAX's own broadcasting, and its precision put back where an example changes it."""
    monkeypatch.chdir(tmp_path)
    double = jax.config.read("jax_enable_x64")
    with jax.numpy_rank_promotion("allow"):
        yield
    jax.config.update("jax_enable_x64", double)


def run_page(name):
    """Runs the Python of a page from its top, in one namespace; returns that."""
    space, text = {}, (ROOT / name).read_text(encoding="utf-8")
    for block in re.finditer(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        # As many lines before it as on the page, so that a traceback names the page's line.
        lines = "\n" * text[: block.start(1)].count("\n")
        exec(compile(lines + block[1], name, "exec"), space)
    return space


def slow_unless_first(name):
    """Each page takes half a minute or more: the first is for everybody."""
    return pytest.param(name, marks=[] if name == "README.md" else pytest.mark.slow)


@pytest.mark.parametrize("name", [slow_unless_first(name) for name in PAGES if name != EXTENDING])
def test_a_page_runs(name):
    run_page(name)


@pytest.mark.slow
def test_what_the_page_on_extending_says(capsys, monkeypatch):
    # The page adds this row, which is to go with the test.
    monkeypatch.setitem(jl.metrics.METRICS, "largest", None)
    space = run_page(EXTENDING)
    said = capsys.readouterr().out
    assert "nan" in said  # of the point that the lens does not reach
    assert "shift_x" in said  # by its name in the summary
    assert space["inverse"].valid.tolist() == [True, False]  # (0.9, 0) lies beyond the fold, which is seen at 0.86
    assert float(space["fit"].parameters["kappa"]) == pytest.approx(-0.2, abs=1e-4)
    lens = space["read_calibration"]("lens.json").lens()
    assert type(lens).__name__ == "Exponential"
    assert float(lens.a) == pytest.approx(0.3, abs=1e-4)
    focal_length, error = float(space["minimum"].unknowns.shared[0]), float(space["known"].standard_errors[0])
    assert abs(focal_length - 500) < 4 * error < 20
    assert "CONVERGED" in said
    assert float(jl.metrics.METRICS["largest"](space["reference"], space["reference"] + 2, data_range=255)) == 2
    assert float(space["largest_error"](space["reference"], 0 * space["reference"])) == 11


def documented_modules():
    """The modules with an example in some docstring."""
    paths = sorted((ROOT / "jaxlens").rglob("*.py"))
    return [path.relative_to(ROOT).as_posix() for path in paths if ">>>" in path.read_text(encoding="utf-8")]


def examples_of(path):
    """The examples of a module's docstrings, found in its source: some objects hide theirs from `doctest`'s search."""
    module = importlib.import_module(path.removesuffix("/__init__.py").removesuffix(".py").replace("/", "."))
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            text, name = ast.get_docstring(node) or "", getattr(node, "name", module.__name__)
            yield doctest.DocTestParser().get_doctest(text, vars(module).copy(), name, path, getattr(node, "lineno", 0))


@pytest.mark.parametrize("path", documented_modules())
def test_the_examples_of_a_module_give_what_they_say(path):
    runner, said = doctest.DocTestRunner(verbose=False), []
    for test in examples_of(path):
        runner.run(test, out=said.append)
    assert runner.summarize(verbose=False).attempted > 0
    assert not said, "".join(said)
