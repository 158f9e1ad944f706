"""Images: warped from a lens, and from a ready map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers, truth
from benchmarks.checks import check, largest_difference
from benchmarks.peers import own_work
from jaxlens.sampling import Method

GRAY = "largest error inside the picture, gray levels of 255"
POSITION = "largest error of the source position inside the picture, pixels"
# float32 keeps positions near 1000 to 1e-4 pixels, of which the picture makes up to 30 gray levels each.
LIMIT = 0.01
# An inverse ends its iterations at a tolerance, in float32 a millionth of the unit.
POSITION_LIMIT = 1e-3
# OpenCV 4, and `cv2.undistort` still in 5, round positions to 1/32 pixel.
OPENCV_LIMIT = 1.0
# PyTorch's go through [-1, 1] and back, and Kornia's through a camera matrix in float32.
TORCH_LIMIT = 0.05


def _warped(image: np.ndarray, source: np.ndarray, sample=truth.bilinear):
    """The error of a picture that should hold the samples of `image` at `source`."""
    inside = truth.interior(source)
    return largest_difference(sample(image.astype(np.float64), source[inside]), inside)


_COUNTS = pytest.mark.parametrize("count", [5, 8, 2])
_OPENCV_LENS = pytest.mark.parametrize("count", [5])


@pytest.mark.row(
    "`distort_image`, {count} coefficients", against="`cv2.initInverseRectificationMap` + `cv2.remap`", target=0.12
)
@_COUNTS
def bench_distort_image(race, count):
    image, source = material.picture(), truth.distorted_from(count)
    pixels, frame = jnp.asarray(image), material.frame()
    ours = lambda: jl.distort_image(pixels, material.lens(count), frame=frame)  # noqa: E731
    theirs = peers.opencv_distort(image, count)
    inside = truth.interior(source)
    checks = [
        check(GRAY, _warped(image, source), ours, theirs, limit=30 * POSITION_LIMIT),
        check(
            POSITION,
            largest_difference(source[inside], inside),
            lambda: jl.distortion_map(material.lens(count), material.SIZE, material.SIZE, frame=frame),
            peers.opencv_distort_map(material.SIZE, count),
            limit=POSITION_LIMIT,
        ),
    ]
    race(ours, theirs, package="OpenCV", checks=checks, moved=2 * image.nbytes)


def _undistort(race, count, package, peer, peer_limit, image=None):
    image = material.picture() if image is None else image
    pixels, frame, source = jnp.asarray(image), material.frame(), truth.undistorted_from(count)
    ours, theirs = lambda: jl.undistort_image(pixels, material.lens(count), frame=frame), peer(image, count)
    # Integers are rounded: half a level on top.
    rounding = 0.0 if image.dtype == np.float32 else 0.5
    checks = [
        check(GRAY, _warped(image, source), ours, theirs, limit=LIMIT + rounding, peer_limit=peer_limit + rounding)
    ]
    race(ours, theirs, package=package, checks=checks, moved=2 * image.nbytes)


@pytest.mark.row(
    "`undistort_image`, {count} coefficients", against="`cv2.initUndistortRectifyMap` + `cv2.remap`", target=1.3
)
@_COUNTS
def bench_undistort_image(race, count):
    _undistort(race, count, "OpenCV", peers.opencv_undistort_by_map, OPENCV_LIMIT)


@pytest.mark.row("`undistort_image`, {count} coefficients", against="`cv2.undistort`", target=0.4)
@_OPENCV_LENS
def bench_undistort_image_inexact(race, count):
    _undistort(race, count, "OpenCV", peers.opencv_undistort, OPENCV_LIMIT)


@pytest.mark.row("`undistort_image`, {count} coefficients", against="`kornia` `undistort_image`", target=0.12)
@_OPENCV_LENS
def bench_undistort_image_kornia(race, count):
    _undistort(race, count, "Kornia", peers.kornia_undistort, TORCH_LIMIT)


@pytest.mark.row("`undistort_image`, uint8", against="`cv2.initUndistortRectifyMap` + `cv2.remap`")
@_OPENCV_LENS
def bench_undistort_image_uint8(race, count):
    image = np.round(material.picture()).astype(np.uint8)
    _undistort(race, count, "OpenCV", peers.opencv_undistort_by_map, OPENCV_LIMIT, image)


@pytest.mark.row("`undistort_image`, gray", against="`cv2.initUndistortRectifyMap` + `cv2.remap`")
@_OPENCV_LENS
def bench_undistort_image_gray(race, count):
    _undistort(race, count, "OpenCV", peers.opencv_undistort_by_map, OPENCV_LIMIT, material.picture(1)[..., 0])


@pytest.mark.row("`distort_image`, antialiased", against="—")
@_OPENCV_LENS
def bench_distort_image_antialiased(race, count):
    image, source = material.picture(), truth.distorted_from(count)
    pixels, lens, frame = jnp.asarray(image), material.lens(count), material.frame()
    ours = lambda: jl.distort_image(pixels, lens, frame=frame, antialias=True)  # noqa: E731
    # Footprints of up to 1.6 pixels smooth this picture a little; there is no closed form to compare with.
    checks = [check(f"{GRAY}, against no smoothing", _warped(image, source), ours, None, limit=10.0)]
    race(ours, None, package=None, checks=checks, moved=2 * image.nbytes)


@pytest.mark.row("`distort_image`, 12 megapixels, uint8", against="our own `undistort_image` of it", target=1.5)
@_COUNTS
def bench_distort_image_large(race, count):
    image = np.tile(np.round(material.picture()).astype(np.uint8), (3, 4, 1))
    pixels, lens = jnp.asarray(image), material.lens(count)
    # The same lens, its unit half of this picture's diagonal.
    frame = jl.Frame.half_diagonal(*image.shape[:2])
    own = own_work(lambda: jl.undistort_image(pixels, lens, frame=frame))
    race(
        lambda: jl.distort_image(pixels, lens, frame=frame),
        own,
        package="jaxlens",
        checks=[],
        moved=2 * image.nbytes,
    )


@pytest.mark.row("the first call of `undistort_image`, tracing and compiling (at most 1000 ms)", against="—")
@_OPENCV_LENS
def bench_undistort_image_first(race, count):
    _first_call(race, jl.undistort_image, count)


@pytest.mark.row("the first call of `distort_image`, tracing and compiling (at most 1000 ms)", against="—")
@_OPENCV_LENS
def bench_distort_image_first(race, count):
    _first_call(race, jl.distort_image, count)


def _first_call(race, warp, count):
    image, lens, frame = jnp.asarray(material.picture()), material.lens(count), material.frame()

    def ours() -> jax.Array:
        jax.clear_caches()
        return warp(image, lens, frame=frame)

    race(ours, None, package=None, checks=[], moved=2 * image.nbytes)


def _remap(race, package, peer, peer_limit, *, image=None, method: Method = "bilinear", sample=truth.bilinear):
    image = material.picture() if image is None else image
    # The map itself is given: both sample at the same float32 positions.
    coordinates = truth.undistorted_from(5).astype(np.float32)
    pixels, points = jnp.asarray(image), jnp.asarray(coordinates)
    ours, theirs = lambda: jl.remap(pixels, points, method=method), peer(image, coordinates)
    error = _warped(image, coordinates.astype(np.float64), sample)
    checks = [check(GRAY, error, ours, theirs, limit=LIMIT, peer_limit=peer_limit)]
    race(ours, theirs, package=package, checks=checks, moved=2 * image.nbytes + coordinates.nbytes)


@pytest.mark.row("`remap`, ready map, bilinear", against="`cv2.remap`", target=1.3)
def bench_remap(race):
    _remap(race, "OpenCV", peers.opencv_remap, OPENCV_LIMIT)


@pytest.mark.row("`remap`, ready map, bilinear", against="`torch.nn.functional.grid_sample`", target=0.5)
def bench_remap_torch(race):
    _remap(race, "PyTorch", peers.torch_grid_sample, TORCH_LIMIT)


@pytest.mark.row("`remap`, ready map, bilinear, gray", against="`cv2.remap`")
def bench_remap_gray(race):
    _remap(race, "OpenCV", peers.opencv_remap, OPENCV_LIMIT, image=material.picture(1)[..., 0])


@pytest.mark.row("`remap`, ready map, bicubic (a = −0.75)", against="`cv2.remap`, `INTER_CUBIC`")
def bench_remap_bicubic(race):
    def peer(image, coordinates):
        return peers.opencv_remap(image, coordinates, "INTER_CUBIC")

    _remap(race, "OpenCV", peer, OPENCV_LIMIT, method="bicubic_opencv", sample=truth.bicubic)
