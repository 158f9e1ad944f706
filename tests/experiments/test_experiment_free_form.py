"""Figure 2: what a free-form deformation does inside, at its border, and where it folds."""

from pathlib import Path

import numpy as np
import pytest
from paper_kinds import module_of

from jaxlens.experiments import ConfigError, Crop, Warp, run

pytestmark = pytest.mark.usefixtures("kinds")
kind = module_of("free_form")

PICTURE = np.random.default_rng(0).uniform(0, 200, (31, 35))
REGION = Crop(top=5, left=7, height=21, width=21)
TEXT = """
kind = "free_form"
name = "f"
region = { top = 2, left = 3, height = 15, width = 16 }
degrees = [4, 4]
moves = [{ column = 2, row = 2, dx = 4 }, { column = 0, row = 2, dx = -4, weight = 2.0 }]
[image]
path = "tiny.png"
"""


def _deform(column: int, row: int, dx: float, *, degree: int = 2):
    still = kind.lattice_of(REGION, (degree, degree), "float64")
    return kind.deform(PICTURE, kind.moved(still, [kind.ControlPointMove(column=column, row=row, dx=dx)]), Warp())


@pytest.mark.usefixtures("x64")
def test_the_middle_control_point_in_closed_form():
    """Degree 2: the displacement is 4 dx s (1 − s) t (1 − t), at most a quarter; its slope at the border dx / width."""
    found = _deform(1, 1, 4.2)
    measures = found.measures
    assert measures["largest_displacement_px"] == pytest.approx(4.2 / 4, rel=1e-12)
    assert measures["jump_at_border_px"] == 0
    assert measures["slope_jump_at_border"] == pytest.approx(4.2 / 21, rel=1e-12)
    assert (measures["folded_px"], measures["gap_px"], measures["covered_px"]) == (0, 0, 0)
    assert measures["round_trip_px"] < 1e-12
    # s of the pixels' centres: the determinant is 1 + dx / width · 4 (1 − 2 s) t (1 − t).
    s = (np.arange(21) + 0.5) / 21
    expected = 1 + 4.2 / 21 * 4 * (1 - 2 * s)[None, :] * (s * (1 - s))[:, None]
    np.testing.assert_allclose(found.determinant[5:26, 7:28], expected, rtol=1e-12)
    assert np.isnan(found.determinant).sum() == 31 * 35 - 21 * 21
    np.testing.assert_array_equal(found.picture[:5], PICTURE[:5])


@pytest.mark.usefixtures("x64")
def test_a_border_pulled_out_covers_and_drawn_in_tears():
    """The border's middle goes half as far as its control point."""
    out, drawn_in = _deform(0, 1, -6.0), _deform(0, 1, 6.0)
    for found in (out, drawn_in):
        assert found.measures["jump_at_border_px"] == pytest.approx(3.0, rel=1e-12)
    assert out.measures["gap_px"] == drawn_in.measures["covered_px"] == 0
    assert out.measures["covered_px"] == out.covered.sum() > 20
    assert drawn_in.measures["gap_px"] == drawn_in.gap.sum() > 20
    # Not beyond the 21 rows and the 3 columns that the border moved over.
    for mask, columns in ((out.covered, slice(4, 7)), (drawn_in.gap, slice(7, 10))):
        assert mask[5:26, columns].sum() == mask.sum()
    assert (drawn_in.picture[drawn_in.gap] == 0).all()


@pytest.mark.usefixtures("x64")
def test_a_control_point_pulled_too_far_folds():
    found = _deform(1, 1, 60.0)
    assert found.measures["smallest_determinant"] < 0
    assert found.measures["folded_px"] == np.sum(found.determinant <= 0) > 0


@pytest.mark.slow
def test_the_experiment_freezes_rows(folder: Path):
    Path("f.toml").write_text(TEXT, encoding="utf-8")
    first, second = (run("f.toml", output=name, quiet=True) for name in ("one", "two"))
    names = ["continuity.jpg", "lattice.csv", "lattice.jpg", "manifest.json", "run.json", "table.csv"]
    assert [path.name for path in first.files] == names
    for one, two in zip(first.files, second.files, strict=True):
        assert one.name == "run.json" or one.read_bytes() == two.read_bytes()
    header, *rows = [line.split(",") for line in Path("one/table.csv").read_text().splitlines()]
    table = {row[0]: dict(zip(header[1:], map(float, row[1:]), strict=True)) for row in rows}
    assert list(table) == ["border free", "1 row frozen (C⁰)", "2 rows frozen (C¹)"]
    free, continuous, smooth = table.values()
    assert free["jump_at_border_px"] > 1
    assert continuous["jump_at_border_px"] == smooth["jump_at_border_px"] == smooth["slope_jump_at_border"] == 0
    header, *rows = [line.split(",") for line in Path("one/lattice.csv").read_text().splitlines()]
    assert len(rows) == 3 * 25
    for row in rows:
        point = dict(zip(header, row, strict=True))
        if point["frozen"] == "yes":
            assert (point["x"], point["y"], point["weight"]) == (point["initial_x"], point["initial_y"], "1")
    assert sum(row[-1] == "yes" for row in rows) == 0 + 16 + 24


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("width = 16", "width = 30", r"columns 3 to 33; must lie within the image's 20 rows and 24 columns"),
        ("degrees = [4, 4]", "degrees = [4, 3]", r"'continuity' of order 1 .* at least 4, got \[4, 3\]"),
        ("column = 2, row = 2", "column = 5, row = 2", "columns 0 to 4 and rows 0 to 4, got column 5"),
        ("column = 0, row = 2", "column = 2, row = 2", "each control point once"),
        ("weight = 2.0", "weight = 0", "weight"),
    ],
)
def test_misuse(folder: Path, old: str, new: str, said: str):
    assert old in TEXT
    Path("f.toml").write_text(TEXT.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        run("f.toml", quiet=True)
    assert not Path("results").exists()
