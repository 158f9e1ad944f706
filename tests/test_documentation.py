"""Pages whose code runs from their top."""

import pathlib
import re

import pytest

PAGES = pathlib.Path(__file__).parents[1] / "docs"


@pytest.mark.parametrize("name", ["extending.md"])
def test_a_page_runs(name, capsys):
    space = {}
    for block in re.findall(r"```python\n(.*?)```", (PAGES / name).read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(compile(block, name, "exec"), space)
    said = capsys.readouterr().out
    assert "nan" in said  # of the point that the lens does not reach
    assert "shift_x" in said  # by its name in the summary
    assert space["inverse"].valid.tolist() == [True, False]  # (0.9, 0) lies beyond the fold, which is seen at 0.86
    assert float(space["fit"].parameters["kappa"]) == pytest.approx(-0.2, abs=1e-4)
