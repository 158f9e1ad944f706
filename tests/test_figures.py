"""Figures as files: the same bytes for the same figure, small, and as they were drawn."""

import numpy as np
import PIL.Image
import pytest
from matplotlib.figure import Figure

from jaxlens.figures.palette import VERMILLION, WIDTH
from jaxlens.figures.style import new_figure, save, style


def drawn(what: str) -> Figure:
    figure = new_figure(WIDTH, 2.0)
    axes = figure.subplots()
    if what == "shades":
        x, y = np.meshgrid(np.linspace(0, 1, 200), np.linspace(0, 1, 50))
        axes.imshow(np.stack([x, y, 1 - x], axis=-1), interpolation="bilinear")
    else:
        axes.plot([0, 1, 0.5], color="0.3" if what == "grays" else VERMILLION)
        axes.tick_params(colors="black")
    return figure


@pytest.mark.parametrize("suffix", [".svg", ".png", ".jpg"])
def test_the_same_figure_is_the_same_bytes(tmp_path, suffix):
    files = [tmp_path / f"{name}{suffix}" for name in ("one", "two")]
    for file in files:
        with style():
            save(drawn("lines"), file)
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(("what", "mode"), [("grays", "L"), ("lines", "P"), ("shades", "RGB")])
def test_a_png_has_as_few_colours_as_show_no_bands(tmp_path, what, mode):
    with style():
        save(drawn(what), tmp_path / "a.png")
    with PIL.Image.open(tmp_path / "a.png") as picture:
        assert picture.mode == mode
        assert picture.size == (WIDTH * 160, 320)
        assert picture.info["dpi"] == pytest.approx((160, 160), rel=1e-3)


def test_a_jpeg_is_what_was_drawn_its_colours_as_fine_as_its_grays(tmp_path):
    with style():
        save(drawn("shades"), tmp_path / "a.jpg")
        save(drawn("shades"), tmp_path / "a.png")
    with PIL.Image.open(tmp_path / "a.jpg") as picture, PIL.Image.open(tmp_path / "a.png") as exact:
        assert picture.layer[0][1:3] == picture.layer[1][1:3]
        assert np.abs(np.asarray(picture, float) - np.asarray(exact, float)).mean() < 1
