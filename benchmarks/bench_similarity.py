"""Metrics of two images."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers
from benchmarks.checks import check

# float32 against float64, relative to one.
LIMIT = 1e-4


def _images() -> tuple[np.ndarray, np.ndarray]:
    reference = material.picture()
    return reference, np.asarray(jl.distort_image(reference, jl.RadialPolynomial([0.01])))


def _ssim(race, *, gaussian, **options):
    reference, image = _images()
    x, y = jnp.asarray(reference), jnp.asarray(image)
    ours = lambda: jl.metrics.ssim(x, y, data_range=255.0, **options)  # noqa: E731
    theirs = peers.skimage_ssim(reference, image, gaussian=gaussian)
    checks = []
    double = peers.skimage_ssim(reference.astype(np.float64), image.astype(np.float64), gaussian=gaussian)
    if double is not None:
        exact = double.run()
        what = "error of the mean index, against scikit-image in float64"
        checks.append(check(what, lambda value: abs(float(value) - exact), ours, theirs, limit=LIMIT, peer_limit=LIMIT))
    race(ours, theirs, package="scikit-image", checks=checks, moved=2 * reference.nbytes)


@pytest.mark.row("`ssim`", against="`skimage` `structural_similarity`, Gaussian window", target=0.2)
def bench_ssim(race):
    _ssim(race, gaussian=True)


@pytest.mark.row("`ssim`, 7×7 window", against="`skimage` `structural_similarity`, default")
def bench_ssim_uniform(race):
    _ssim(race, gaussian=False, window="uniform", sample_covariance=True)


@pytest.mark.row("`metrics.evaluate`, all nine", against="—")
def bench_evaluate(race):
    reference, image = _images()
    x, y = jnp.asarray(reference), jnp.asarray(image)
    ours = lambda: jl.metrics.evaluate(x, y, data_range=255.0)  # noqa: E731
    exact = np.sqrt(np.mean((reference.astype(np.float64) - image) ** 2))
    found = check(
        "relative error of the RMSE, against NumPy in float64",
        lambda value: abs(float(value) / exact - 1),
        lambda: ours()["rmse"],
        None,
        limit=LIMIT,
    )
    race(ours, None, package=None, checks=[found], moved=2 * reference.nbytes)
