"""Figure 5: projections move as the lens moves what they are of."""

from pathlib import Path

import numpy as np
import pytest
from paper_kinds import module_of

from jaxlens.experiments import ConfigError, Warp, run

pytestmark = pytest.mark.usefixtures("kinds")
kind = module_of("projections")

TEXT = """
kind = "projections"
name = "p"
window = 7
largest = 4
k = [0.1, -0.1]
[image]
path = "tiny.png"
"""


def _picture() -> np.ndarray:
    """Bands along both axes, without a period, that fade towards the margin."""
    y, x = np.mgrid[:80, :80] - 39.5
    window = np.exp(-(x**2 + y**2) / 900)
    return 100 + 90 * window * (np.sin(x / 2.5 + (x / 20) ** 2) + np.cos(y / 3 - (y / 18) ** 2))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("k", [0.0, 0.06, -0.06])
def test_displacements_are_the_lenss(k: float):
    """To a fraction of a pixel where the whole profile moves by two; with the sign of Section 2.4."""
    pixels = _picture()
    picture, seen = kind.distorted(pixels, k, Warp(method="bicubic"))
    for profile in kind.profiles(pixels, picture, seen, k, window=15, largest=6, least_score=0.9).values():
        assert np.isfinite(profile.measured).sum() > 40
        assert np.median(np.abs(profile.error)) < 0.15
        outer = profile.expected[60]
        assert outer == 0 if k == 0 else np.sign(outer) == -np.sign(k)
        if k == 0:
            np.testing.assert_allclose(profile.distorted, profile.initial, rtol=1e-12)
            assert np.nanmax(np.abs(profile.measured)) < 0.2


@pytest.mark.usefixtures("x64")
def test_barrel_leaves_pixels_without_source_and_their_rows_out():
    picture, seen = kind.distorted(np.full((40, 40), 7.0), 0.3, Warp())
    assert not seen[0, 0]
    assert not seen[0].any()
    profile = kind.profiles(np.full((40, 40), 7.0), picture, seen, 0.3, window=5, largest=3, least_score=0.9)["y"]
    assert np.isnan(profile.distorted[0])
    # Inside, black is not averaged in.
    np.testing.assert_allclose(profile.distorted[10:30], 7.0, rtol=1e-4)


def test_the_experiment_writes_its_folder(folder: Path):
    Path("p.toml").write_text(TEXT, encoding="utf-8")
    first, second = (run("p.toml", output=name, quiet=True) for name in ("one", "two"))
    assert [path.name for path in first.files] == [
        "displacement.svg",
        "manifest.json",
        "profiles_x.csv",
        "profiles_y.csv",
        "projections.jpg",
        "run.json",
        "table.csv",
    ]
    for one, two in zip(first.files, second.files, strict=True):
        assert one.name == "run.json" or one.read_bytes() == two.read_bytes()
    rows = [line.split(",")[:3] for line in Path("one/table.csv").read_text().splitlines()[1:]]
    assert rows == [
        ["0.1", "barrel", "x"],
        ["0.1", "barrel", "y"],
        ["-0.1", "pincushion", "x"],
        ["-0.1", "pincushion", "y"],
    ]
    assert len(Path("one/profiles_x.csv").read_text().splitlines()) == 1 + 24
    assert len(Path("one/profiles_y.csv").read_text().splitlines()) == 1 + 20
    assert kind.kind_of(0.0) == "none"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("window = 7", "window = 21", "window and largest: got 21 and 4; .* 20 rows and 24 columns"),
        ("largest = 4", "largest = 18", "got 7 and 18"),
        ("window = 7", "window = 8", "'window' must be odd, got 8"),
        ("[0.1, -0.1]", "[0.1, 0.1]", "each coefficient once"),
    ],
)
def test_misuse(folder: Path, old: str, new: str, said: str):
    Path("p.toml").write_text(TEXT.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        run("p.toml", quiet=True)
    assert not Path("results").exists()
