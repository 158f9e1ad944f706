"""Batches of pictures, each with its own lens, and gradients by the lens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers
from benchmarks.checks import check
from benchmarks.peers import own_work

SAME = "largest difference from one at a time, gray levels of 255"


@pytest.mark.row(
    f"`vmap` of `distort_image`, {material.BATCH} lenses over {material.BATCH} images, per image",
    against="our own single image",
    target=1.5,
)
@pytest.mark.parametrize("count", [5])
def bench_distort_image_batch(race, count):
    image = material.picture()
    shrinking = np.linspace(1, 0.5, material.BATCH, dtype=np.float32)
    lenses = jax.vmap(lambda scale, lens: jax.tree.map(lambda leaf: scale * leaf, lens), (0, None))(
        shrinking, material.lens(count)
    )
    images, frame = jnp.stack([jnp.asarray(image)] * material.BATCH), material.frame()
    pixels, lens = images[0], material.lens(count)
    batched = jax.jit(jax.vmap(lambda image, lens: jl.distort_image(image, lens, frame=frame)))
    ours = lambda: batched(images, lenses)  # noqa: E731

    def error(pictures: np.ndarray) -> float:
        alone = (
            jl.distort_image(pixels, jax.tree.map(lambda leaf, i=i: leaf[i], lenses), frame=frame)
            for i in range(material.BATCH)
        )
        return max(float(np.max(np.abs(found - one))) for found, one in zip(pictures, alone, strict=True))

    race(
        ours,
        own_work(lambda: jl.distort_image(pixels, lens, frame=frame)),
        package="jaxlens",
        checks=[check(SAME, error, ours, None, limit=0.01)],
        moved=material.BATCH * 2 * image.nbytes,
        per=material.BATCH,
    )


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
        SAME,
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
    own = own_work(lambda: forward(pixels, coefficients))
    race(lambda: backward(coefficients), own, package="jaxlens", checks=[], moved=2 * images.nbytes)


@pytest.mark.row("the gradient of their mean square by the coefficients", against="our own forward pass", target=5.0)
def bench_small_batch_gradient(race):
    _gradient(race, *_small_batch())


@pytest.mark.row("the same of one picture, 1024×1024×3", against="our own forward pass")
def bench_gradient(race):
    _gradient(race, material.picture()[None], material.BROWN_CONRADY[None, :2].astype(np.float32))
