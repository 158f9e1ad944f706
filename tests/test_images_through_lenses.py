"""Pictures through lenses, against a brute-force reference and OpenCV."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import brentq

import jaxlens as jl
from jaxlens import diagnostics


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(0).random((23, 31))


def brute_force(image, kappa):
    """`distort_image` pixel by pixel: Eq. 10, a bracketing root finder, and SciPy's sampling."""
    height, width = image.shape
    unit = np.hypot(width, height) / 2
    slope = np.polynomial.Polynomial([1, *[v for i, k in enumerate(kappa) for v in (0, (2 * i + 3) * k)]])
    folds = [root.real for root in slope.roots() if abs(root.imag) < 1e-9 and root.real > 0]
    fold = min(folds, default=10.0)

    def observed(radius):
        return radius * (1 + sum(k * radius ** (2 * i + 2) for i, k in enumerate(kappa)))

    out = np.zeros_like(image)
    for row in range(height):
        for column in range(width):
            x, y = (column - width / 2) / unit, (row - height / 2) / unit
            radius = np.hypot(x, y)
            if radius > observed(fold):
                continue
            scale = brentq(lambda rho: observed(rho) - radius, 0, fold, xtol=1e-15) / radius if radius else 1.0  # noqa: B023
            source = [[y * scale * unit + height / 2], [x * scale * unit + width / 2]]
            out[row, column] = map_coordinates(image, source, order=1, mode="grid-constant")[0]
    return out


@pytest.mark.parametrize("kappa", [[0.0, 1.0], [3.0, 2.0], [-0.3], [-1.2], [-0.5, 0.4, -0.2], []])
def test_distort_image_is_the_brute_force_one(x64, picture, kappa):
    np.testing.assert_allclose(
        jl.distort_image(picture, jl.RadialPolynomial(kappa)), brute_force(picture, kappa), atol=1e-11
    )


def test_undistort_image_is_opencv_s(picture):
    image = np.float32(np.random.default_rng(1).random((120, 160, 3)))
    matrix = np.array([[150.0, 0, 81.0], [0, 145.0, 58.0], [0, 0, 1]])
    maps = cv2.initUndistortRectifyMap(matrix, np.array([-0.2, 0.05, 0, 0, 0]), None, matrix, (160, 120), cv2.CV_32FC1)
    theirs = cv2.remap(image, *maps, cv2.INTER_LINEAR)
    ours = jl.undistort_image(image, jl.RadialPolynomial([-0.2, 0.05]), frame=jl.Frame.from_camera_matrix(matrix))
    assert np.max(np.abs(ours - theirs)) < 1e-3  # single precision of the coordinates, 1e-5 px, on noise


def test_there_and_back(x64):
    y, x = np.mgrid[:200, :260]
    smooth = np.sin(x / 25) + np.cos(y / 30)
    lens = jl.RadialPolynomial([-0.2, 0.05])
    back = jl.undistort_image(jl.distort_image(smooth, lens, method="bicubic"), lens, method="bicubic")
    np.testing.assert_allclose(np.asarray(back)[20:-20, 20:-20], smooth[20:-20, 20:-20], atol=2e-5)


def test_pixels_without_preimage_take_the_fill_value(picture):
    lens = jl.RadialPolynomial([-1.0])
    for border in ("constant", "edge", "reflect", "wrap"):
        out = jl.distort_image(np.float32(picture), lens, fill=7.0, border=border)
        seen = np.isfinite(np.asarray(jl.distortion_map(lens, *picture.shape))).all(-1)
        assert 0 < seen.mean() < 1
        assert np.all(np.asarray(out)[~seen] == 7)
        assert np.all(np.asarray(out)[seen] < 7)
    beyond = jl.undistort_image(np.ones(picture.shape, np.float32), lens, border="edge")
    radius = np.hypot(*np.moveaxis(np.asarray(jl.Frame.half_diagonal(23, 31).normalize(_grid(23, 31))), -1, 0))
    np.testing.assert_array_equal(np.asarray(beyond) == 0, radius > float(lens.fold_radius()))


def _grid(height, width):
    return np.stack(np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)), -1)


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [(shape, np.uint8) for shape in ((1, 1), (1, 7), (6, 1), (2, 2), (5, 4, 1), (5, 4, 4))]
    + [((5, 4, 1), dtype) for dtype in (np.uint16, np.float32, np.bool_)],
)
def test_identity_keeps_every_picture(shape, dtype):
    image = (np.random.default_rng(2).random(shape) * 2 * (1 if dtype == np.bool_ else 100)).astype(dtype)
    for warp in (jl.distort_image, jl.undistort_image):
        out = warp(image, jl.RadialPolynomial([0.0]), border="edge")
        assert out.dtype == image.dtype
        np.testing.assert_allclose(np.asarray(out, float), image.astype(float), rtol=2e-5, atol=1e-4)


def test_batches_are_loops(picture):
    images = np.float32(np.random.default_rng(3).random((3, 20, 30, 3)))
    lenses = jax.vmap(jl.RadialPolynomial)(jnp.asarray([[0.3, 0.1], [-1.2, 0.0], [0.0, 1.0]]))
    both = jax.vmap(jl.distort_image)(images, lenses)
    over_lenses = jax.vmap(jl.distort_image, (None, 0))(images[0], lenses)
    for i in range(3):
        lens = jax.tree.map(lambda leaf: leaf[i], lenses)  # noqa: B023
        np.testing.assert_allclose(both[i], jl.distort_image(images[i], lens), atol=2e-5)
        np.testing.assert_allclose(over_lenses[i], jl.distort_image(images[0], lens), atol=2e-5)


def test_maps_are_the_images_and_zoom_fills(picture):
    lens = jl.RadialPolynomial([-0.3, 0.02])
    image = np.float32(picture)
    # Coordinates up to 31 are known to 2e-6 in single precision, and neighbours differ by up to one.
    for warped, coordinates in (
        (jl.distort_image(image, lens), jl.distortion_map(lens, 23, 31)),
        (jl.undistort_image(image, lens), jl.undistortion_map(lens, 23, 31)),
    ):
        np.testing.assert_allclose(jl.remap(image, coordinates), warped, rtol=0, atol=4e-6)
    frame = jl.Frame.half_diagonal(23, 31)
    zoom = diagnostics.zoom_to_fill(lens.inverse(), 23, 31)
    filled = jl.distort_image(np.ones((23, 31), np.float32), lens, output_frame=frame.zoomed(zoom))
    assert float(np.min(filled)) > 0.999
    short = jl.distort_image(np.ones((23, 31), np.float32), lens, output_frame=frame.zoomed(0.99 * zoom))
    assert float(np.min(short)) < 0.999


def test_gradient_of_a_picture_with_respect_to_the_lens(x64):
    y, x = np.mgrid[:40, :50]
    image = np.sin(x / 6) * np.cos(y / 5)

    def loss(coefficients):
        return jnp.mean(jl.distort_image(image, jl.RadialPolynomial(coefficients), method="bicubic") ** 2)

    at, step = jnp.asarray([0.2, 0.1]), 1e-6
    numeric = [(loss(at + step * e) - loss(at - step * e)) / (2 * step) for e in jnp.eye(2)]
    np.testing.assert_allclose(jax.grad(loss)(at), numeric, rtol=1e-5)
    np.testing.assert_allclose(jax.jacfwd(loss)(at), numeric, rtol=1e-5)


def test_chains_and_misuse(picture):
    lens = jl.RadialPolynomial([0.2])
    there_and_back = lens.then(lens.inverse())
    image = np.float32(picture)
    np.testing.assert_allclose(jl.warp(image, there_and_back, border="edge"), image, atol=1e-4)
    assert jl.warp(image, lens, shape=(5, 6)).shape == (5, 6)
    with pytest.raises(ValueError, match="takes κ1, κ2, … as a vector"):
        jl.RadialPolynomial(np.ones((2, 2)))
