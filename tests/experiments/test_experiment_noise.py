"""Figure 7: whether noise is the same everywhere, and what MSE does not see."""

from pathlib import Path

import numpy as np
import pytest
from paper_kinds import module_of

from jaxlens.experiments import ConfigError, config, run

pytestmark = pytest.mark.usefixtures("kinds")
kind = module_of("noise")

TEXT = """
kind = "noise"
name = "n"
kappa = [0, 1]
block = 4
[image]
path = "tiny.png"
[other]
source = "checkerboard"
height = 30
width = 18
peak = 193.0
"""


@pytest.fixture(scope="module")
def even() -> np.ndarray:
    return 3.0 * np.random.default_rng(5).standard_normal((64, 83))


def test_expected_range_density_and_test_are_scipys(even: np.ndarray):
    stats = pytest.importorskip("scipy.stats")
    spread = kind.spread_of(even, 8)
    blocks = [even[i : i + 8, j : j + 8].ravel() for i in range(0, 64, 8) for j in range(0, 80, 8)]
    np.testing.assert_allclose(spread.local.ravel(), [np.std(one, ddof=1) for one in blocks], rtol=1e-12)
    sigma = np.sqrt(np.mean(spread.local**2))
    ends = sigma * np.sqrt(stats.chi2.ppf([0.025, 0.975], 63) / 63)
    np.testing.assert_allclose([spread.low, spread.high], ends, rtol=1e-6)
    np.testing.assert_allclose(spread.bartlett(), stats.bartlett(*blocks), rtol=1e-9)
    at = np.linspace(2, 4, 2001)
    exact = stats.chi.pdf(at, 63, scale=sigma / np.sqrt(63))
    np.testing.assert_allclose(spread.density(at), exact, atol=1e-5 * exact.max())


def test_even_noise_is_told_from_uneven(even: np.ndarray):
    spread = kind.spread_of(even, 8)
    assert spread.inside > 0.9
    assert 0.7 < spread.excess < 1.3
    assert spread.bartlett()[1] > 0.01
    uneven = kind.spread_of(even * np.linspace(0.5, 1.5, 64)[:, None], 8)
    assert uneven.excess > 3
    assert uneven.bartlett()[1] < 1e-20
    assert kind.spread_of(np.pad(even, 8), 8).bartlett() == (np.inf, 0)


@pytest.mark.usefixtures("x64")
def test_mse_does_not_see_what_ssim_sees():
    random = np.random.default_rng(2)
    y, x = np.mgrid[:40, :40]
    reference, other = 100 + 50 * np.sin(x / 4), 100 + random.uniform(-40, 40, (40, 40))
    # Errors with structure: an edge that has moved.
    errors = np.where((x > 10) & (x < 16), 30.0, 0.0) + 0.1 * y
    found = {name: kind.scores(*pair, 200.0) for name, pair in kind.arrangements(reference, errors, other, 3).items()}
    exact = np.mean(errors**2)
    for one in found.values():
        assert one["mse"] == pytest.approx(exact, rel=1e-12)
        assert one["psnr"] == pytest.approx(10 * np.log10(200.0**2 / exact), rel=1e-12)
    first = found.pop("as they are")
    for name, one in found.items():
        assert abs(one["ssim"] - first["ssim"]) > 0.02, name
        same_power = name != "on another picture"
        assert (one["snr"] == pytest.approx(first["snr"], rel=1e-12)) == same_power


def test_the_experiment_writes_its_folder_whatever_the_other_pictures_size(folder: Path):
    Path("n.toml").write_text(TEXT, encoding="utf-8")
    first, second = (run("n.toml", output=name, quiet=True) for name in ("one", "two"))
    assert [path.name for path in first.files] == [
        "arrangements.jpg",
        "blocks.csv",
        "manifest.json",
        "noise.jpg",
        "run.json",
        "spread.svg",
        "table.csv",
    ]
    for one, two in zip(first.files, second.files, strict=True):
        assert one.name == "run.json" or one.read_bytes() == two.read_bytes()
    header, *rows = [line.split(",") for line in Path("one/table.csv").read_text().splitlines()]
    mse = header.index("mse")
    for name in ("noise", "lens"):
        values = {row[mse] for row in rows if row[0] == name}
        assert len([row for row in rows if row[0] == name]) == 5
        np.testing.assert_allclose([float(value) for value in values], float(values.pop()), rtol=1e-8)
    assert {row[0] for row in rows} == {"noise", "lens"}
    blocks = [line.split(",") for line in Path("one/blocks.csv").read_text().splitlines()[1:]]
    assert [row[3] for row in blocks] == ["30", "30"]


def test_an_image_given_leaves_the_other_picture_alone(folder: Path):
    path = Path("n.toml")
    path.write_text(TEXT.replace('source = "checkerboard"\nheight = 30\nwidth = 18', 'path = "other.png"'))
    with pytest.raises(ConfigError, match=r"other\.path: got 'other\.png'; there is no such picture file"):
        config.load(path)
    Path("other.png").write_bytes(Path("tiny.png").read_bytes())
    assert set(config.load(path).input_files()) == {"image.path", "other.path"}
    Path("new").mkdir()
    Path("new/mine.png").write_bytes(Path("tiny.png").read_bytes())
    files = config.load(path, image="new/mine.png").input_files()
    assert files == {"image.path": Path("new/mine.png"), "other.path": Path("other.png")}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("block = 4", "block = 11", "block: got 11; the image, of 20 rows and 24 columns, must hold two such blocks"),
        ("block = 4", "block = 1", "block"),
        ("block = 4", "noise = 0.0", "noise"),
    ],
)
def test_misuse(folder: Path, old: str, new: str, said: str):
    Path("n.toml").write_text(TEXT.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        run("n.toml", quiet=True)
    assert not Path("results").exists()
