"""Images: warped from a lens, and from a ready map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers, truth
from benchmarks.checks import check, largest_difference
from jaxlens.sampling import Method

GRAY = "largest error inside the picture, gray levels of 255"
POSITION = "largest error of the source position inside the picture, pixels"
# float32 keeps positions near 1000 to 1e-4 pixels, of which the picture makes up to 30 gray levels each.
LIMIT = 0.01
# OpenCV 4, and `cv2.undistort` still in 5, round positions to 1/32 pixel.
OPENCV_LIMIT = 1.0
# PyTorch's go through [-1, 1] and back, and Kornia's through a camera matrix in float32.
TORCH_LIMIT = 0.05


def _warped(image: np.ndarray, source: np.ndarray, sample=truth.bilinear):
    """The error of a picture that should hold the samples of `image` at `source`."""
    inside = truth.interior(source)
    return largest_difference(sample(image.astype(np.float64), source[inside]), inside)


def _lens() -> jl.RadialPolynomial:
    return jl.RadialPolynomial(material.KAPPA)


@pytest.mark.row(
    "`distort_image`, lens to picture", against="`cv2.initInverseRectificationMap` + `cv2.remap`", target=0.04
)
def bench_distort_image(race):
    image, source = material.picture(), truth.distorted_from()
    pixels = jnp.asarray(image)
    ours = lambda: jl.distort_image(pixels, _lens())  # noqa: E731
    theirs = peers.opencv_distort(image)
    inside = truth.interior(source)
    checks = [
        check(GRAY, _warped(image, source), ours, theirs, limit=LIMIT),
        check(
            POSITION,
            largest_difference(source[inside], inside),
            lambda: jl.distortion_map(_lens(), material.SIZE, material.SIZE),
            peers.opencv_distort_map(material.SIZE),
            limit=2e-3,
        ),
    ]
    race(ours, theirs, package="OpenCV", checks=checks, moved=2 * image.nbytes)


def _undistort(race, package, peer, peer_limit, image=None):
    image = material.picture() if image is None else image
    pixels, source = jnp.asarray(image), truth.undistorted_from()
    ours, theirs = lambda: jl.undistort_image(pixels, _lens()), peer(image)
    # Integers are rounded: half a level on top.
    rounding = 0.0 if image.dtype == np.float32 else 0.5
    checks = [
        check(GRAY, _warped(image, source), ours, theirs, limit=LIMIT + rounding, peer_limit=peer_limit + rounding)
    ]
    race(ours, theirs, package=package, checks=checks, moved=2 * image.nbytes)


@pytest.mark.row("`undistort_image`, lens to picture", against="`cv2.undistort`", target=0.4)
def bench_undistort_image(race):
    _undistort(race, "OpenCV", peers.opencv_undistort, OPENCV_LIMIT)


@pytest.mark.row(
    "`undistort_image`, lens to picture", against="`cv2.initUndistortRectifyMap` + `cv2.remap`", target=1.3
)
def bench_undistort_image_by_map(race):
    _undistort(race, "OpenCV", peers.opencv_undistort_by_map, OPENCV_LIMIT)


@pytest.mark.row("`undistort_image`, lens to picture", against="`kornia` `undistort_image`", target=0.12)
def bench_undistort_image_kornia(race):
    _undistort(race, "Kornia", peers.kornia_undistort, TORCH_LIMIT)


@pytest.mark.row("`undistort_image`, uint8", against="`cv2.initUndistortRectifyMap` + `cv2.remap`")
def bench_undistort_image_uint8(race):
    image = np.round(material.picture()).astype(np.uint8)
    _undistort(race, "OpenCV", peers.opencv_undistort_by_map, OPENCV_LIMIT, image)


@pytest.mark.row("`undistort_image`, gray", against="`cv2.initUndistortRectifyMap` + `cv2.remap`")
def bench_undistort_image_gray(race):
    _undistort(race, "OpenCV", peers.opencv_undistort_by_map, OPENCV_LIMIT, material.picture(1)[..., 0])


@pytest.mark.row("`distort_image`, antialiased", against="—")
def bench_distort_image_antialiased(race):
    image, source = material.picture(), truth.distorted_from()
    pixels = jnp.asarray(image)
    ours = lambda: jl.distort_image(pixels, _lens(), antialias=True)  # noqa: E731
    # Footprints of up to 1.6 pixels smooth this picture a little; there is no closed form to compare with.
    checks = [check(f"{GRAY}, against no smoothing", _warped(image, source), ours, None, limit=10.0)]
    race(ours, None, package=None, checks=checks, moved=2 * image.nbytes)


def _remap(race, package, peer, peer_limit, *, image=None, method: Method = "bilinear", sample=truth.bilinear):
    image = material.picture() if image is None else image
    # The map itself is given: both sample at the same float32 positions.
    coordinates = truth.undistorted_from().astype(np.float32)
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


@pytest.mark.row(
    f"`vmap` of `distort_image`, {material.BATCH} lenses over {material.BATCH} images, per image",
    against="our own single image",
    target=1.5,
)
def bench_distort_image_batch(race):
    image = material.picture()
    shrinking = np.linspace(1, 0.5, material.BATCH, dtype=np.float32)[:, None]
    lenses = jax.vmap(jl.RadialPolynomial)(shrinking * np.asarray(material.KAPPA, np.float32))
    images = jnp.stack([jnp.asarray(image)] * material.BATCH)
    pixels, lens = images[0], _lens()
    batched = jax.jit(jax.vmap(jl.distort_image))
    ours = lambda: batched(images, lenses)  # noqa: E731
    single = peers.Peer(
        lambda: jax.block_until_ready(jl.distort_image(pixels, lens)), device=jax.default_backend().upper()
    )

    def error(pictures: np.ndarray) -> float:
        alone = (
            jl.distort_image(pixels, jax.tree.map(lambda leaf, i=i: leaf[i], lenses)) for i in range(material.BATCH)
        )
        return max(float(np.max(np.abs(found - one))) for found, one in zip(pictures, alone, strict=True))

    checks = [check("largest difference from one at a time, gray levels of 255", error, ours, None, limit=LIMIT)]
    moved = material.BATCH * 2 * image.nbytes
    race(ours, single, package="jaxlens", checks=checks, moved=moved, per=material.BATCH)
