import jax
import numpy as np
import pytest
from cli_helpers import smooth

import jaxlens as jl
from jaxlens.cli import pixels as module
from jaxlens.cli.pixels import Warp, find_fold, inner_rectangle, warp_pixels

BARREL = Warp(direction="distort", kappa=(-0.2, 0.05))
PINCUSHION = Warp(direction="undistort", kappa=(0.3, 0.0))


def library(pixels, kappa=(0.3, 0.0), **options):
    with jax.enable_x64(False):
        return np.asarray(jl.undistort_image(pixels, jl.RadialPolynomial(np.array(kappa, np.float32)), **options))


@pytest.mark.parametrize(("dtype", "channels"), [("uint8", 1), ("uint16", 3), ("float32", 3), ("float16", 1)])
def test_kinds_of_pictures(dtype, channels):
    pixels = smooth(dtype, channels)
    warped = warp_pixels(pixels, PINCUSHION)
    assert warped.dtype == pixels.dtype
    _assert_equal_up_to_rounding(warped, library(pixels))


def _assert_equal_up_to_rounding(warped, expected):
    """A level of integers, an ulp or so of floats: the two are compiled apart."""
    if warped.dtype.kind == "u":
        assert np.abs(warped.astype(np.int64) - expected.astype(np.int64)).max() <= 1
    else:
        np.testing.assert_allclose(warped, expected, rtol=0, atol=4 * np.finfo(warped.dtype).eps)


@pytest.mark.parametrize("dtype", ["float64", "uint32"])
def test_wide_pictures_are_computed_in_double_precision(dtype):
    pixels = smooth(dtype, 1)
    warped = warp_pixels(pixels, PINCUSHION)
    assert warped.dtype == pixels.dtype
    with jax.enable_x64(True):
        expected = np.asarray(jl.undistort_image(pixels, jl.RadialPolynomial(np.array([0.3, 0.0]))))
    if dtype == "uint32":
        assert np.abs(warped.astype(np.int64) - expected.astype(np.int64)).max() <= 8
    else:
        np.testing.assert_allclose(warped, expected, rtol=0, atol=1e-14)


def test_transparent_colours_do_not_bleed():
    pixels = np.zeros((24, 32, 4), np.uint8)
    pixels[..., :3] = (250, 10, 10)
    pixels[..., 3] = 0
    pixels[6:18, 8:24] = (20, 200, 90, 255)
    for warp in (PINCUSHION, BARREL):
        warped = warp_pixels(pixels, warp)
        seen = warped[..., 3] > 0
        assert (warped[..., 3] % 255 > 0).sum() > 0
        assert (warped[seen][:, :3] == (20, 200, 90)).all()
        assert (warped[~seen] == 0).all()


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_opaque_pictures_are_warped_as_if_without_alpha(dtype):
    pixels = smooth(dtype, 4)
    warped, plain = warp_pixels(pixels, PINCUSHION), library(pixels[..., :3].copy())
    full = pixels[..., 3].max()
    inside = warped[..., 3] == full
    assert 0.3 < inside.mean() < 1
    tolerance = 1e-6 if dtype == "float32" else 1  # a tie may be rounded the other way
    np.testing.assert_allclose(warped[inside][:, :3].astype(float), plain[inside].astype(float), rtol=0, atol=tolerance)
    # Outside there is nothing, not black.
    assert (warped[0, 0] == 0).all()


def test_alpha_itself_is_interpolated_as_a_plane():
    pixels = smooth("uint16", 2)
    pixels[..., 1] = smooth("uint16", 1)
    warped = warp_pixels(pixels, PINCUSHION)
    difference = warped[..., 1].astype(int) - library(pixels[..., 1].copy()).astype(int)
    assert np.abs(difference).max() <= 1


def test_nearest_copies_pixels_with_alpha():
    pixels = smooth("float32", 4)
    pixels[..., 3] = np.linspace(0, 1, 24 * 32, dtype=np.float32).reshape(24, 32)
    warped = warp_pixels(pixels, Warp(direction="undistort", kappa=(0.3, 0.0), method="nearest"))
    originals = {tuple(pixel) for pixel in pixels.reshape(-1, 4)} | {(0, 0, 0, 0)}
    assert {tuple(pixel) for pixel in warped.reshape(-1, 4)} <= originals


def test_bicubic_overshoot_stays_in_range():
    pixels = np.zeros((24, 32, 2), np.uint8)
    pixels[:, ::3] = (255, 255)
    warped = warp_pixels(pixels, Warp(direction="undistort", kappa=(0.3, 0.0), method="bicubic"))
    assert warped.dtype == np.uint8
    assert set(np.unique(warped[..., 0][warped[..., 1] > 0])) == {255}


@pytest.mark.parametrize(
    ("channels", "fill", "expected"),
    [
        (1, None, 0),
        (1, (9,), 9),
        (2, None, (0, 0)),
        (2, (9,), (9, 255)),
        (2, (9, 8), (9, 8)),
        (3, (9,), (9, 9, 9)),
        (3, (9, 8, 7), (9, 8, 7)),
        (4, None, (0, 0, 0, 0)),
        (4, (9,), (9, 9, 9, 255)),
        (4, (9, 8, 7), (9, 8, 7, 255)),
        (4, (9, 8, 7, 6), (9, 8, 7, 6)),
    ],
)
def test_fill(channels, fill, expected):
    fill = None if fill is None else tuple(map(float, fill))
    warped = warp_pixels(smooth("uint8", channels), Warp(direction="undistort", kappa=(3.0, 0.0), fill=fill))
    np.testing.assert_array_equal(warped[0, 0], expected)


@pytest.mark.parametrize(
    ("channels", "fill", "message"),
    [
        (1, (1, 2), "--fill takes 1 numbers, got 2"),
        (3, (1, 2), "--fill takes 1 or 3 numbers, got 2"),
        (4, (1, 2), "--fill takes 1 or 3 or 4 numbers, got 2"),
        (3, (300,), "--fill 300 is not in there"),
        (3, (-1,), "--fill -1 is not in there"),
    ],
)
def test_a_fill_that_does_not_fit(channels, fill, message):
    with pytest.raises(ValueError, match=message):
        warp_pixels(
            smooth("uint8", channels), Warp(direction="undistort", kappa=(3.0, 0.0), fill=tuple(map(float, fill)))
        )


@pytest.mark.parametrize(
    ("warp", "channels"), [(PINCUSHION, 4), (Warp(direction="undistort", kappa=(0.9, 0.0), antialias=True), 1)]
)
def test_strips_make_the_same_picture(monkeypatch, warp, channels):
    pixels = smooth("float32", channels)
    whole = warp_pixels(pixels, warp)
    monkeypatch.setattr(module, "_STRIP_PIXELS", 32 * 7)
    monkeypatch.setattr(module, "_STRIP_ROWS", 3)
    np.testing.assert_allclose(warp_pixels(pixels, warp), whole, rtol=0, atol=2e-6)


@pytest.mark.parametrize("height", [1, 2, 3, 7, 8, 20, 21])
@pytest.mark.parametrize("rows", [3, 7])
def test_strips_cover_every_row_once(height, rows):
    rows = min(rows, height)
    seen = []
    for first, kept in module._strips(height, rows):
        assert 0 <= first <= height - rows
        assert 0 <= kept.start < kept.stop <= rows
        # The edge of a strip is kept only where it is the edge of the picture.
        assert kept.start > 0 or first == 0
        assert kept.stop < rows or first + rows == height
        seen += range(first + kept.start, first + kept.stop)
    assert seen == list(range(height))


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_the_smallest_pictures(shape):
    pixels = np.full((*shape, 3), 7, np.uint8)
    assert warp_pixels(pixels, Warp(direction="undistort", kappa=(0.0,))).tolist() == pixels.tolist()


def test_antialiasing_reaches_the_library():
    pixels = smooth("uint8", 1)
    pixels[::2] = 0
    warped = warp_pixels(pixels, Warp(direction="undistort", kappa=(0.9, 0.0), antialias=True))
    np.testing.assert_array_equal(warped, library(pixels, (0.9, 0.0), antialias=True))


def test_inner_rectangle_of_the_identity():
    assert inner_rectangle(Warp(direction="undistort", kappa=(0.0, 0.0)), 24, 32) == (0, 0, 24, 32)


@pytest.mark.parametrize(
    ("direction", "kappa", "radius"),
    [
        ("distort", (-0.1, 0.0), None),
        ("distort", (0.5, 0.0), None),
        # It folds beyond the picture's corner, at 1.05, but what it shows ends at two thirds of that.
        ("distort", (-0.3, 0.0), np.sqrt(1 / 0.9)),
        ("undistort", (-0.3, 0.0), None),
        ("undistort", (-0.5, 0.0), np.sqrt(1 / 1.5)),
    ],
)
def test_folds(direction, kappa, radius):
    fold = find_fold(Warp(direction=direction, kappa=kappa), 24, 32)
    if radius is None:
        assert fold is None
    else:
        assert fold.radius == pytest.approx(radius, rel=1e-6)
        assert fold.pixels == pytest.approx(20 * radius, rel=1e-6)
        assert 0 < fold.share < 1
