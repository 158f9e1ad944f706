"""OpenCV's lens of 5 and 8 coefficients, maps of the plane and their inverses, batches of pictures, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers, truth
from benchmarks.checks import check

_COUNTS = pytest.mark.parametrize("count", [5, 8])
POSITION = "largest error of the source position inside the picture, pixels"
# float32 keeps positions near 1000 to 1e-4 pixels.
_LIMIT = 2e-3


def _lens(count: int, dtype: jax.typing.DTypeLike = np.float32) -> jl.BrownConrady:
    return jl.BrownConrady(np.asarray(material.BROWN_CONRADY[:count], dtype))


def _frame(dtype: jax.typing.DTypeLike = np.float32) -> jl.Frame:
    return jl.Frame.from_camera_matrix(np.asarray(material.CAMERA_MATRIX, dtype))


def _source_error(coordinates: np.ndarray, expected: np.ndarray) -> float:
    inside = truth.interior(expected)
    return float(np.max(np.abs(coordinates - expected)[inside]))


def _observed_error(coordinates: np.ndarray, count: int) -> float:
    """How far from each pixel the lens takes the source that was found for it."""
    inside = np.isfinite(coordinates).all(-1) & truth.interior(np.nan_to_num(coordinates, nan=-1.0))
    grid = truth.pixel_grid()[inside]
    return float(np.max(np.abs(truth.brown_conrady(coordinates[inside].astype(np.float64), count) - grid)))


@pytest.mark.row("`undistort_image`, Brown–Conrady", against="`cv2.initUndistortRectifyMap` + `cv2.remap`", target=1.3)
@_COUNTS
def bench_undistort_brown_conrady(race, count):
    image = material.picture()
    pixels, frame = jnp.asarray(image), _frame()
    error = check(
        POSITION,
        lambda found: _source_error(found, truth.brown_conrady(truth.pixel_grid(), count)),
        lambda: jl.undistortion_map(_lens(count), material.SIZE, material.SIZE, frame=frame),
        peers.opencv_undistort_map(count),
        limit=_LIMIT,
    )
    ours = lambda: jl.undistort_image(pixels, _lens(count), frame=frame)  # noqa: E731
    race(ours, peers.opencv_undistort_by_map(image, count), package="OpenCV", checks=[error], moved=2 * image.nbytes)


@pytest.mark.row(
    "`distort_image`, Brown–Conrady", against="`cv2.initInverseRectificationMap` + `cv2.remap`", target=0.12
)
@_COUNTS
def bench_distort_brown_conrady(race, count):
    image = material.picture()
    pixels, frame = jnp.asarray(image), _frame()
    error = check(
        "largest distance from where the lens takes what was found, inside the picture, pixels",
        lambda found: _observed_error(found, count),
        lambda: jl.distortion_map(_lens(count), material.SIZE, material.SIZE, frame=frame),
        peers.opencv_distort_map(material.SIZE, count),
        limit=_LIMIT,
    )
    ours = lambda: jl.distort_image(pixels, _lens(count), frame=frame)  # noqa: E731
    race(ours, peers.opencv_distort(image, count), package="OpenCV", checks=[error], moved=2 * image.nbytes)


@pytest.mark.row(
    "`lens.undistort`, Brown–Conrady, 10⁶ points, float64",
    against="`cv2.undistortPoints`, iterated to 1e-12",
    target=0.25,
)
@_COUNTS
def bench_undistort_points_brown_conrady(race, count):
    ideal, _ = material.observed_points()
    with jax.enable_x64(True):
        lens = _lens(count, np.float64)
        observed = np.asarray(lens.distort(ideal))
        points, peer = jnp.asarray(observed), peers.opencv_undistort_points(observed, 1e-12, count)
        ours = lambda: lens.undistort(points)  # noqa: E731
        error = check(
            "largest error, normalized units",
            lambda found: float(np.max(np.abs(found - ideal))),
            ours,
            peer,
            limit=1e-12,
        )
        race(ours, peer, package="OpenCV", checks=[error], moved=2 * observed.nbytes)


@pytest.mark.row("`warp` by a `Homography`", against="`cv2.warpPerspective`, `WARP_INVERSE_MAP`", target=1.3)
def bench_homography(race):
    image = material.picture()
    frame = jl.Frame([0.0, 0.0], 1.0)
    mapping = jl.deformations.Homography(np.asarray(material.HOMOGRAPHY, np.float32))
    pixels = jnp.asarray(image)
    error = check(
        POSITION,
        lambda found: _source_error(found, truth.homography(truth.pixel_grid())),
        lambda: jl.source_coordinates(mapping, material.SIZE, material.SIZE, frame=frame),
        None,
        limit=_LIMIT,
    )
    ours = lambda: jl.warp(pixels, mapping, frame=frame)  # noqa: E731
    peer = peers.opencv_warp_perspective(image, material.HOMOGRAPHY)
    race(ours, peer, package="OpenCV", checks=[error], moved=2 * image.nbytes)


def _deformation(kind: str) -> jl.CoordinateMap:
    random = np.random.default_rng(3)
    corners = {"lower": (-1.0, -1.0), "upper": (1.0, 1.0)}
    if kind == "b-spline":
        return jl.deformations.BSplineField(0.02 * random.normal(size=(19, 19, 2)).astype(np.float32), **corners)
    still = jl.deformations.FreeForm.identity(4, 4, **corners)
    moved = still.control_points + 0.1 * random.normal(size=(5, 5, 2)).astype(np.float32)
    return jl.deformations.FreeForm(moved, **corners)


def _warp_back(race, kind: str) -> None:
    image, mapping = material.picture(), _deformation(kind)
    pixels, inverse = jnp.asarray(image), mapping.inverse()
    grid = jax.random.uniform(jax.random.key(0), (10_000, 2), minval=-0.6, maxval=0.6)
    error = check(
        "largest error of a round trip, normalized units",
        lambda found: float(np.max(np.abs(found - np.asarray(grid)))),
        lambda: mapping(inverse(grid)),
        None,
        limit=5e-6,
    )
    race(lambda: jl.warp(pixels, inverse), None, package=None, checks=[error], moved=2 * image.nbytes)


@pytest.mark.row("`warp` by the inverse of a `BSplineField`, 16×16 cells (at most 250 ms)", against="—")
def bench_inverse_b_spline(race):
    _warp_back(race, "b-spline")


@pytest.mark.row("`warp` by the inverse of a `FreeForm`, degrees 4×4 (at most 150 ms)", against="—")
def bench_inverse_free_form(race):
    _warp_back(race, "free form")


@pytest.mark.row("`warp` by a `BSplineField`, 16×16 cells", against="—")
def bench_b_spline(race):
    image, mapping = material.picture(), _deformation("b-spline")
    pixels = jnp.asarray(image)
    race(lambda: jl.warp(pixels, mapping), None, package=None, checks=[], moved=2 * image.nbytes)


def _small_batch() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(4)
    images = random.uniform(0, 255, (64, 224, 224, 3)).astype(np.float32)
    return images, np.stack([random.uniform(-0.3, 0.3, 64), random.uniform(-0.1, 0.1, 64)], -1).astype(np.float32)


def _undistorted(images, kappas):
    return jax.vmap(lambda image, kappa: jl.undistort_image(image, jl.RadialPolynomial(kappa)))(images, kappas)


@pytest.mark.row("`vmap` of `undistort_image`, 64 pictures of 224×224×3", against="a loop over OpenCV's", target=1.0)
def bench_small_batch(race):
    images, kappas = _small_batch()
    pixels, batched = jnp.asarray(images), jax.jit(_undistorted)
    error = check(
        "largest difference from one at a time, gray levels of 255",
        lambda found: float(np.max(np.abs(found[7] - jl.undistort_image(images[7], jl.RadialPolynomial(kappas[7]))))),
        lambda: batched(pixels, kappas),
        None,
        limit=0.05,
    )
    peer = peers.opencv_undistort_loop(images, kappas)
    race(lambda: batched(pixels, kappas), peer, package="OpenCV", checks=[error], moved=2 * images.nbytes)


def _gradient(race, images: np.ndarray, kappas: np.ndarray) -> None:
    pixels, coefficients = jnp.asarray(images), jnp.asarray(kappas)
    forward, backward = jax.jit(_undistorted), jax.jit(jax.grad(lambda k: jnp.mean(_undistorted(pixels, k) ** 2)))
    own = peers.Peer(lambda: jax.block_until_ready(forward(pixels, coefficients)), device=jax.default_backend().upper())
    race(lambda: backward(coefficients), own, package="jaxlens", checks=[], moved=2 * images.nbytes)


@pytest.mark.row("the gradient of their mean square by the coefficients", against="our own forward pass", target=5.0)
def bench_small_batch_gradient(race):
    _gradient(race, *_small_batch())


@pytest.mark.row("the same of one picture, 1024×1024×3", against="our own forward pass")
def bench_gradient(race):
    _gradient(race, material.picture()[None], np.array([material.KAPPA], np.float32))


@pytest.mark.row("`distort_image`, 12 megapixels, uint8", against="our own `undistort_image` of it", target=1.5)
def bench_distort_large(race):
    image = np.tile(np.round(material.picture()).astype(np.uint8), (3, 4, 1))
    pixels, lens = jnp.asarray(image), jl.RadialPolynomial(material.KAPPA)
    own = peers.Peer(
        lambda: jax.block_until_ready(jl.undistort_image(pixels, lens)), device=jax.default_backend().upper()
    )
    race(lambda: jl.distort_image(pixels, lens), own, package="jaxlens", checks=[], moved=2 * image.nbytes)
