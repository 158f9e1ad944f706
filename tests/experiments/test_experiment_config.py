import subprocess
import sys
from pathlib import Path

import pytest

from jaxlens.experiments import ConfigError, config, run

CONFIGURATIONS = sorted((Path(__file__).parents[2] / "experiments").glob("*.toml"))


# Data that lie beside the repository, where they are present.
BESIDE = {
    "boards": ("opencv/left_corners.csv", r"corners: .* there is no such CSV file"),
    "fisheyes": ("babelcalib/ov_plane/ov_plane.dsc", r"board: .* there is no such board of BabelCalib"),
}


@pytest.mark.parametrize("path", CONFIGURATIONS, ids=lambda path: path.stem)
def test_committed_configurations_are_valid_and_named_as_their_files(path: Path):
    file, message = BESIDE.get(path.stem, ("", ""))
    if not (path.parent / "../../shared/data" / file).exists() and file:
        with pytest.raises(config.ConfigError, match=message):
            config.load(path)
    else:
        assert config.load(path).experiment.name == path.stem


def change(folder: Path, old: str, new: str) -> Path:
    path = folder / "tiny.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("peak = 193.0", "peek = 193.0", ["image.peek", "unknown key", "193.0", "did you mean 'peak'", "'crop'"]),
        ('name = "tiny"', 'name = "tiny"\nlensez = 1', ["lensez", "unknown key", "'lenses'", "'memory_mb'"]),
        ("peak = 193.0", 'peak = "high"', ["image.peak", "'high'", "must be a valid number"]),
        ("peak = 193.0", "peak = -1.5", ["image.peak", "-1.5", "greater than 0"]),
        ("peak = 193.0", "peak = 193.0\ngray = 1", ["image.gray", "got 1", "must be a valid boolean"]),
        ("peak = 193.0", "crop = 3", ["image.crop", "got 3", "table", "'top'", "'width'"]),
        ("peak = 193.0", "crop = { top = 0, left = 0, height = 3 }", ["image.crop.width", "is missing"]),
        ('path = "tiny.png"', 'path = "gone.png"', ["image.path", "'gone.png'", "no such picture"]),
        ('path = "tiny.png"', 'source = "moon"', ["image.source", "'moon'", "'portrait'"]),
        ('path = "tiny.png"', 'source = "clouds"', ["image", "'height'"]),
        ('path = "tiny.png"\n', "", ["image", "either 'source' or 'path'"]),
        ("[0, 1]", "[0, nan]", ["lenses.kappa[0][1]", "nan", "finite"]),
        ("[0, 1]", "[0, inf]", ["lenses.kappa[0][1]", "inf", "finite"]),
        ("[0, 1]", "[0, true]", ["lenses.kappa[0][1]", "true", "number"]),
        ("[0, 1]", "[0]", ["lenses", "one length", "[1, 2]"]),
        ("[0, 1]", "[]", ["lenses.kappa[0]", "[]", "at least 1"]),
        ("[[0, 1], [1, 2], [1, 3], [2, 3], [3, 2], [3, 1]]", "[]", ["lenses.kappa", "[]", "at least 1"]),
        ("kappa = [[0, 1]", "axes = [{start = 0, stop = 1, count = 0}]\nx = [[0, 1]", ["lenses.axes[0].count", "0"]),
        ('kind = "sweep"', 'kind = "sweeep"', ["kind", "'sweeep'", "'sweep'", "there is none"]),
        ('kind = "sweep"', "", ["kind", "missing", "'sweep'"]),
        ('name = "tiny"', 'name = "../tiny"', ["name", "'../tiny'", "letters"]),
        ('name = "tiny"', 'name = "tiny"\nmemory_mb = 0', ["memory_mb", "got 0", "greater than 0"]),
        ('name = "tiny"', 'name = "tiny"\ndtype = "half"', ["dtype", "'half'", "'float32'"]),
        ('name = "tiny"', 'name = "tiny', ["not valid TOML", "line 3"]),
    ],
)
def test_a_mistake_is_named_by_file_key_value_and_what_is_allowed(folder: Path, old: str, new: str, said: list[str]):
    path = change(folder, old, new)
    with pytest.raises(ConfigError) as caught:
        run(path, quiet=True)
    message = str(caught.value)
    assert str(path) in message
    for part in said:
        assert part in message
    assert sorted(child.name for child in folder.iterdir()) == ["tiny.png", "tiny.toml"]


def test_every_mistake_of_a_file_is_told(folder: Path):
    path = change(folder, "peak = 193.0", "peak = -1\ngrey = true")
    with pytest.raises(ConfigError) as caught:
        config.load(path)
    assert len(str(caught.value).splitlines()) == 2


@pytest.mark.parametrize("name", ["gone.toml", "."])
def test_a_file_that_cannot_be_read_is_named(folder: Path, name: str):
    with pytest.raises(ConfigError, match=r"no such file|cannot be read"):
        config.load(folder / name)


def test_bytes_that_are_no_text_are_refused(folder: Path):
    with pytest.raises(ConfigError, match="UTF-8"):
        config.load(folder / "tiny.png")


def test_an_image_in_place_of_the_configured_one_keeps_gray_and_peak_and_drops_the_crop(folder: Path):
    path = change(folder, "peak = 193.0", "peak = 193.0\ncrop = { top = 1, left = 1, height = 12, width = 12 }")
    experiment = config.load(path, image=folder / "tiny.png").experiment
    assert experiment.image.crop is None
    assert (experiment.image.peak, experiment.image.gray) == (193.0, True)
    with pytest.raises(ConfigError, match=r"no\.png.*no such picture"):
        config.load(path, image="no.png")


def test_a_crop_outside_the_image_is_refused(folder: Path):
    path = change(folder, "peak = 193.0", "crop = { top = 15, left = 0, height = 12, width = 12 }")
    with pytest.raises(ConfigError, match=r"rows 15 to 27 .* within the image's 20 rows"):
        run(path, quiet=True)
    assert not (folder / "results").exists()


def test_an_axis_has_exact_ends():
    from jaxlens.experiments.schema import Axis

    assert Axis(start=0.1, stop=0.7, count=3).values() == [0.1, pytest.approx(0.4), 0.7]
    assert Axis(start=-1.0, stop=5.0, count=1).values() == [-1.0]


def test_the_hash_is_of_what_a_file_says_and_not_of_its_layout(folder: Path):
    digest = config.load(folder / "tiny.toml").digest()
    path = change(folder, "peak = 193.0", "gray = true # the default\n\npeak = 193")
    assert config.load(path).digest() == digest
    path = change(folder, "peak = 193", "peak = 194")
    assert config.load(path).digest() != digest


def test_nothing_heavy_is_imported_to_find_a_mistake(folder: Path):
    code = (
        "import sys, jaxlens.experiments as e\n"
        "try: e.run('gone.toml')\n"
        "except e.ConfigError: pass\n"
        "print(sorted({'jax', 'matplotlib', 'numpy', 'equinox'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
