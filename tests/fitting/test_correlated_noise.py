"""Pictures whose noise is correlated from pixel to pixel: intervals that still hold, and a summary that says so."""

import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxlens as jl
from jaxlens.fitting import fit_images

pytestmark = pytest.mark.slow

SHAPE = (96, 128)
LENS = [0.3, 0.2]


def _picture(random):
    """Smooth shapes of three sizes, as a photograph has, in gray values."""
    total = np.full(SHAPE, 128.0)
    for cells, contrast in ((6, 42), (14, 21), (40, 8)):
        noise = random.normal(size=(cells * 3 // 4 + 1, cells + 1))
        total += contrast * np.asarray(jax.image.resize(noise, SHAPE, "cubic"))
    return total.clip(0, 255)


def _through_jpeg(pixels):
    file = io.BytesIO()
    Image.fromarray(np.round(np.asarray(pixels)).clip(0, 255).astype(np.uint8)).save(file, "JPEG", quality=80)
    return np.asarray(Image.open(file)).astype(float)


def _pair(seed):
    picture = _picture(np.random.default_rng(seed))
    return picture, np.asarray(jl.distort_image(jnp.asarray(picture), jl.RadialPolynomial(LENS)))


def _fit(source, distorted):
    return fit_images(jl.RadialPolynomial([0.0, 0.0]), source, distorted)


def test_intervals_of_compressed_pictures_hold(x64):
    fits = [_fit(*map(_through_jpeg, _pair(seed))) for seed in range(40)]
    scores = np.array([(fit.values[:2] - np.array(LENS)) / fit.standard_errors[:2] for fit in fits])
    for coverage in np.mean(np.abs(scores) < 1.96, axis=0):
        assert 0.80 <= coverage <= 0.99
    inflation = np.array([fit.noise_inflation for fit in fits])
    assert (np.median(inflation, axis=0) > 2).all()
    assert "independent only between windows of 16 pixels" in fits[0].summary()


def test_independent_noise_is_left_alone(x64):
    source, distorted = _pair(0)
    fit = _fit(source, distorted + np.random.default_rng(1).normal(size=SHAPE))
    np.testing.assert_array_equal(fit.noise_inflation, np.ones(4))
    assert "the noise of each pixel is taken for independent" in fit.summary()


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_the_inflation_is_that_of_smoothed_noise(x64, loss):
    """Noise that is one value for each 4 × 4 pixels counts for a sixteenth of them, where nothing varies faster."""
    source, distorted = _pair(2)
    coarse = np.random.default_rng(3).normal(size=(SHAPE[0] // 4, SHAPE[1] // 4))
    fit = fit_images(jl.Division(0.0), source, distorted + np.kron(coarse, np.ones((4, 4))), loss=loss)
    offset = fit.names.index("offset")
    assert 8 < float(fit.noise_inflation[offset]) < 24
    single = fit_images(
        jl.Division(0.0),
        source.astype(np.float32),
        (distorted + np.kron(coarse, np.ones((4, 4)))).astype(np.float32),
        loss=loss,
    )
    np.testing.assert_allclose(single.noise_inflation, fit.noise_inflation, rtol=0.05)
