"""Pictures as landscapes: what is drawn, where, and what is refused."""

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from jaxlens.figures.style import new_figure, save, style
from jaxlens.figures.surfaces import draw_surface, surface_figure

RAMP = np.broadcast_to(np.linspace(0, 200, 40), (30, 40))


def _paths(image=RAMP, **options):
    axes = new_figure(3.0, 3.0).subplots()
    draw_surface(axes, image, 200.0, **{"smoothing": 0.0, **options})
    (collection,) = (child for child in axes.collections if isinstance(child, PolyCollection))
    return [path.vertices for path in collection.get_paths()], collection


@pytest.mark.parametrize("drawing", ["mesh", "filled", "isolines"])
def test_each_way_of_drawing(tmp_path, drawing):
    with style():
        figure = surface_figure(RAMP, 200.0, drawings=(drawing,))
        save(figure, tmp_path / "one.jpg")
        save(surface_figure(RAMP, 200.0, drawings=(drawing,)), tmp_path / "two.jpg")
    assert (tmp_path / "one.jpg").read_bytes() == (tmp_path / "two.jpg").read_bytes()


def test_the_figure_says_what_is_shown():
    figure = surface_figure(RAMP, 200.0, smoothing=2.5, drawings=("mesh", "filled", "isolines"))
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["net, coloured by height", "surface in the picture's grays, lit", "lines of equal gray value"]
    assert figure.get_suptitle() == "gray values as heights, smoothed by a Gaussian with σ = 2.5 px"


def test_seen_from_above_without_perspective_is_the_picture():
    """Straight down, parallel: a grid of rectangles, half a diagonal as the unit, the whole picture."""
    vertices = np.concatenate(_paths(perspective=0.0, elevation=90.0, azimuth=0.0)[0])
    half = np.hypot(40, 30) / 2
    np.testing.assert_allclose(vertices.min(axis=0), [-19.5 / half, -14.5 / half], atol=1e-12)
    np.testing.assert_allclose(vertices.max(axis=0), [19.5 / half, 14.5 / half], atol=1e-12)


def test_perspective_enlarges_what_is_near():
    """From above, white stands half a half-diagonal nearer: 1 / (1 − 0.2 · 0.5) times as large."""
    vertices = np.concatenate(_paths(perspective=0.2, relief=0.5, elevation=90.0, azimuth=0.0)[0])
    half = np.hypot(40, 30) / 2
    np.testing.assert_allclose(vertices[:, 0].max(), 19.5 / half / 0.9, rtol=1e-12)
    np.testing.assert_allclose(vertices[:, 0].min(), -19.5 / half, rtol=1e-12)


def test_smoothing_is_a_gaussian_in_pixels():
    """A spike of 2D volume one leaves the height 1 / (2π σ²)."""
    spike = np.zeros((61, 61))
    spike[30, 30] = 200.0
    peaks = []
    for smoothing in (3.0, 6.0):
        vertices = np.concatenate(_paths(spike, smoothing=smoothing, perspective=0.0, elevation=1e-9, relief=1.0)[0])
        peaks.append(vertices[:, 1].max())
    np.testing.assert_allclose(peaks, [1 / (2 * np.pi * 9), 1 / (2 * np.pi * 36)], rtol=5e-3)


def test_the_nearest_is_painted_last():
    """Seen from the lower edge, its cells come after those of the upper edge."""
    paths, _ = _paths(perspective=0.0, azimuth=0.0, elevation=30.0, relief=0.0)
    assert paths[0][:, 1].mean() > paths[-1][:, 1].mean()


def test_a_flat_picture_has_no_isolines():
    paths, _ = _paths(np.zeros((20, 20)), drawing="isolines")
    assert len(paths) == 19 * 19 + 4 * 19


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"drawing": "lego"}, "mesh, filled, isolines, got 'lego'"),
        ({"perspective": 0.8}, "perspective < 0.7"),
        ({"smoothing": -1.0}, "negative"),
    ],
)
def test_misuse(monkeypatch, options, message):
    import jaxtyping

    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=message):
        _paths(**options)
