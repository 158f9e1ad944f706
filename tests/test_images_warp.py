"""Whole pictures through maps: alpha, dtypes, fill values, and strips that nobody sees."""

import jax
import numpy as np
import pytest
from pictures import smooth

import jaxlens as jl
from jaxlens import images
from jaxlens.images import Picture, PictureMetadata
from jaxlens.images import warping as module

PINCUSHION = jl.OneToOne(jl.RadialPolynomial([0.3, 0.0]))
BARREL = jl.RadialPolynomial([-0.2, 0.05]).inverse()
STRONG = jl.OneToOne(jl.RadialPolynomial([0.9, 0.0]))
FAR = jl.OneToOne(jl.RadialPolynomial([3.0, 0.0]))


def through(pixels, mapping=PINCUSHION, **options):
    return images.warp(Picture(pixels), mapping, **options).pixels


def library(pixels, kappa=(0.3, 0.0), **options):
    with jax.enable_x64(False):
        return np.asarray(jl.undistort_image(pixels, jl.RadialPolynomial(np.array(kappa, np.float32)), **options))


@pytest.mark.parametrize(("dtype", "channels"), [("uint8", 1), ("uint16", 3), ("float32", 3), ("float16", 1)])
def test_kinds_of_pictures(dtype, channels):
    pixels = smooth(dtype, channels)
    warped = through(pixels)
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
    with jax.enable_x64(True):
        lens = jl.RadialPolynomial([0.3, 0.0])
        expected = np.asarray(jl.undistort_image(pixels, lens))
    # Whatever precision JAX is set to.
    warped = through(pixels, jl.OneToOne(lens))
    assert warped.dtype == pixels.dtype
    if dtype == "uint32":
        assert np.abs(warped.astype(np.int64) - expected.astype(np.int64)).max() <= 8
    else:
        np.testing.assert_allclose(warped, expected, rtol=0, atol=1e-14)


def test_transparent_colours_do_not_bleed():
    pixels = np.zeros((24, 32, 4), np.uint8)
    pixels[..., :3] = (250, 10, 10)
    pixels[..., 3] = 0
    pixels[6:18, 8:24] = (20, 200, 90, 255)
    for mapping in (PINCUSHION, BARREL):
        warped = through(pixels, mapping)
        seen = warped[..., 3] > 0
        assert (warped[..., 3] % 255 > 0).sum() > 0
        assert (warped[seen][:, :3] == (20, 200, 90)).all()
        assert (warped[~seen] == 0).all()


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_opaque_pictures_are_warped_as_if_without_alpha(dtype):
    pixels = smooth(dtype, 4)
    warped, plain = through(pixels), library(pixels[..., :3].copy())
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
    warped = through(pixels)
    difference = warped[..., 1].astype(int) - library(pixels[..., 1].copy()).astype(int)
    assert np.abs(difference).max() <= 1


def test_nearest_copies_pixels_with_alpha():
    pixels = smooth("float32", 4)
    pixels[..., 3] = np.linspace(0, 1, 24 * 32, dtype=np.float32).reshape(24, 32)
    warped = through(pixels, method="nearest")
    originals = {tuple(pixel) for pixel in pixels.reshape(-1, 4)} | {(0, 0, 0, 0)}
    assert {tuple(pixel) for pixel in warped.reshape(-1, 4)} <= originals


def test_bicubic_overshoot_stays_in_range():
    pixels = np.zeros((24, 32, 2), np.uint8)
    pixels[:, ::3] = (255, 255)
    warped = through(pixels, method="bicubic")
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
    warped = through(smooth("uint8", channels), FAR, fill=fill)
    np.testing.assert_array_equal(warped[0, 0], expected)


@pytest.mark.parametrize(
    ("channels", "fill", "message"),
    [
        (1, (1, 2), "fill takes 1 numbers, got 2"),
        (3, (1, 2), "fill takes 1 or 3 numbers, got 2"),
        (4, (1, 2), "fill takes 1 or 3 or 4 numbers, got 2"),
        (3, (300,), "fill=300 is not in there"),
        (3, (-1,), "fill=-1 is not in there"),
    ],
)
def test_a_fill_that_does_not_fit(channels, fill, message):
    with pytest.raises(ValueError, match=message):
        through(smooth("uint8", channels), FAR, fill=tuple(map(float, fill)))


@pytest.mark.parametrize(("mapping", "antialias", "channels"), [(PINCUSHION, False, 4), (STRONG, True, 1)])
def test_strips_make_the_same_picture(monkeypatch, mapping, antialias, channels):
    pixels = smooth("float32", channels)
    whole = through(pixels, mapping, antialias=antialias)
    monkeypatch.setattr(module, "_STRIP_PIXELS", 32 * 7)
    monkeypatch.setattr(module, "_STRIP_ROWS", 3)
    np.testing.assert_allclose(through(pixels, mapping, antialias=antialias), whole, rtol=0, atol=2e-6)


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
    assert through(pixels, jl.OneToOne(jl.RadialPolynomial([0.0]))).tolist() == pixels.tolist()


def test_antialiasing_reaches_the_library():
    pixels = smooth("uint8", 1)
    pixels[::2] = 0
    warped = through(pixels, STRONG, antialias=True)
    np.testing.assert_array_equal(warped, library(pixels, (0.9, 0.0), antialias=True))


def test_metadata_and_path_are_kept(tmp_path):
    images.write(tmp_path / "a.png", Picture(smooth(), PictureMetadata(dpi=(300.0, 300.0))))
    picture = images.read(tmp_path / "a.png")
    warped = images.warp(picture, PINCUSHION)
    assert (warped.metadata, warped.path) == (picture.metadata, tmp_path / "a.png")
    assert warped.metadata.dpi == pytest.approx((300, 300), abs=0.02)


def test_size_and_frames(monkeypatch):
    """The result may have a size and a frame of its own, in strips too."""
    monkeypatch.setattr(module, "_STRIP_PIXELS", 40 * 5)
    monkeypatch.setattr(module, "_STRIP_ROWS", 5)
    frame, output_frame = jl.Frame([15.5, 11.5], 20.0), jl.Frame([19.5, 14.5], 25.0)
    options = {"frame": frame, "output_frame": output_frame, "shape": (30, 40)}
    warped = through(smooth(), BARREL, **options)
    assert warped.shape == (30, 40, 3)
    _assert_equal_up_to_rounding(warped, np.asarray(jl.warp(smooth(), BARREL, **options)))
