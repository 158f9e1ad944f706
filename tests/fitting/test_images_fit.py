"""Fits of picture pairs: exact pairs, light, centres, patches and masks, honest errors, what no fit could use."""

import jax
import jaxtyping
import numpy as np
import pytest
import skimage.color
import skimage.data
import skimage.transform

import jaxlens as jl
from jaxlens.fitting import FitError, FitStatus, fit_images

# One size for nearly all, because each shape is compiled for itself.
SIZE = 160
PAIRS = [(0.0, 1.0), (1.0, 1.0), (1.0, 2.0), (1.0, 3.0), (2.0, 3.0), (3.0, 2.0)]
EVERYWHERE = np.ones((SIZE, SIZE), bool)
PATCH = (slice(45, 95), slice(60, 120))
START = [0.0, 0.0]


@pytest.fixture
def unchecked():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def _crop():
    gray = 255 * skimage.color.rgb2gray(skimage.data.astronaut())
    return skimage.transform.resize(gray[:400, 60:460], (SIZE, SIZE), anti_aliasing=True)


SOURCE = _crop()
SMALL = skimage.transform.resize(SOURCE, (40, 48), anti_aliasing=True)


def _seen(source, coefficients, center=None):
    return np.asarray(jl.distort_image(source, jl.RadialPolynomial(np.array(coefficients), center=center)))


def _fit(distorted, mask=EVERYWHERE, **keywords):
    return fit_images(jl.RadialPolynomial(START), SOURCE, distorted, mask=mask, **keywords)


def _patched(distorted):
    """Something else in front of a twelfth of the picture."""
    covered = distorted.copy()
    covered[PATCH] = skimage.transform.resize(skimage.data.camera().astype(float), (50, 60), anti_aliasing=True)
    return covered


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS)
def test_all_six_lenses_from_zero(x64, pair):
    fit = _fit(_seen(SOURCE, pair))
    assert fit.names == ("kappa1", "kappa2", "gain", "offset")
    assert int(fit.status) == FitStatus.CONVERGED
    np.testing.assert_allclose(fit.values, [*pair, 1, 0], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(fit.lens.coefficients, fit.values[:2])
    assert fit.lens.center.tolist() == [0.0, 0.0]
    assert float(fit.rms) < 1e-9
    assert fit.residuals.shape == (SIZE, SIZE, 1)
    assert not bool(fit.folds)


@pytest.mark.parametrize("pair", PAIRS[::3])
@pytest.mark.slow
def test_light(x64, pair):
    fit = _fit(0.9 * _seen(SOURCE, pair) + 12.5)
    np.testing.assert_allclose(fit.values, [*pair, 0.9, 12.5], rtol=0, atol=1e-9)


def test_a_folding_lens(x64):
    """What the lens does not show at all must not count."""
    distorted = _seen(SOURCE, [-0.2, 0.02])
    fit = _fit(distorted)
    np.testing.assert_allclose(fit.values, [-0.2, 0.02, 1, 0], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_noise(x64):
    exact = 0.9 * _seen(SOURCE, (1.0, 2.0)) + 12.5
    random = np.random.default_rng(0)
    fits = [_fit(exact + 3 * random.normal(size=exact.shape)) for _ in range(40)]
    values = np.array([fit.values for fit in fits])
    errors = np.array([fit.standard_errors for fit in fits])
    scores = (values - [1.0, 2.0, 0.9, 12.5]) / errors
    # 40 fits know a spread to 11 %, and the mean of the scores to 0.16.
    np.testing.assert_allclose(np.sqrt(np.mean(scores**2, axis=0)), 1, atol=0.3)
    assert np.abs(scores.mean(axis=0)).max() < 0.5
    # A gray value of noise is a pixel's; what is not covered does not count.
    fit = fits[0]
    used = np.asarray(fit.residuals) != 0
    freedom = used.sum() - 4
    assert int(fit.degrees_of_freedom) == freedom
    assert float(fit.rms) == pytest.approx(np.sqrt(np.mean(np.asarray(fit.residuals)[used] ** 2)), rel=1e-12)
    assert float(fit.rms) == pytest.approx(3, abs=4 * 3 / np.sqrt(2 * freedom))


def test_residuals_are_observed_less_predicted(x64):
    lens, noise = jl.RadialPolynomial([1.0, 2.0]), np.random.default_rng(1).normal(size=(SIZE, SIZE))
    distorted = 0.9 * np.asarray(jl.distort_image(SOURCE, lens)) + 12.5 + noise
    fit = _fit(distorted)
    predicted = fit.parameters["gain"] * jl.distort_image(SOURCE, fit.lens) + fit.parameters["offset"]
    residuals = np.asarray(fit.residuals[..., 0])
    used = residuals != 0
    assert used.mean() > 0.5
    np.testing.assert_allclose(residuals[used], (distorted - predicted)[used], rtol=0, atol=1e-9)


def test_a_mask_hides_a_patch(x64):
    distorted, mask = _patched(_seen(SOURCE, (1.0, 3.0))), EVERYWHERE.copy()
    mask[PATCH] = False
    fit = _fit(distorted, mask)
    np.testing.assert_allclose(fit.values, [1, 3, 1, 0], rtol=0, atol=1e-9)
    assert np.all(np.asarray(fit.residuals)[PATCH] == 0)
    without = _fit(distorted)
    assert np.abs(np.asarray(without.values) - [1, 3, 1, 0]).max() > 1e-3


@pytest.mark.slow
def test_a_robust_loss_sees_past_a_patch(x64):
    random = np.random.default_rng(2)
    for pair in ((1.0, 3.0), (2.0, 3.0)):
        distorted = _patched(_seen(SOURCE, pair))
        fit = _fit(distorted, None, loss="cauchy")
        np.testing.assert_allclose(fit.values, [*pair, 1, 0], rtol=0, atol=1e-6)
        noisy = _fit(distorted + 2 * random.normal(size=distorted.shape), None, loss="cauchy")
        # 2.3849 standard deviations of the noise; the patch makes the median a little larger.
        assert 2.3849 * 2 < float(noisy.loss_scale) < 1.3 * 2.3849 * 2
        # The patch is brighter or darker than what it covers: it pulls at the light a little, not at the lens.
        scores = (np.asarray(noisy.values[:2]) - pair) / np.asarray(noisy.standard_errors[:2])
        assert np.abs(scores).max() < 4
        assert abs(float(noisy.parameters["gain"]) - 1) < 0.01


def test_another_picture_altogether(x64):
    """A minimum there is always; a lens that explains nothing is not called converged."""
    other = skimage.transform.resize(skimage.data.camera().astype(float), (SIZE, SIZE), anti_aliasing=True)
    with pytest.raises(FitError, match=r"does not look like the distorted picture|not converged"):
        _fit(other)


@pytest.mark.slow
def test_a_center_of_its_own(x64):
    """Two per cent of the width, either way; the unit is half the diagonal."""
    for pair, shift in (((1.0, 2.0), (0.02, -0.02)), ((0.0, 1.0), (-0.02, 0.01))):
        center = np.array(shift) * SIZE / (SIZE / np.sqrt(2))
        fit = _fit(_seen(SOURCE, pair, center), None, center=True)
        assert fit.names == ("kappa1", "kappa2", "center_x", "center_y", "gain", "offset")
        np.testing.assert_allclose(fit.values, [*pair, *center, 1, 0], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(fit.lens.center, fit.values[2:4])


def _fit_small(source, distorted, **keywords):
    return fit_images(jl.Division(0.2), source, distorted, search=False, **keywords)


def test_without_a_search_from_nearby(x64):
    for light in ((1.0, 0.0), (0.8, 20.0)):
        distorted = light[0] * np.asarray(jl.distort_image(SMALL, jl.Division(0.3))) + light[1]
        fit = _fit_small(SMALL, distorted)
        assert fit.names == ("k", "gain", "offset")
        np.testing.assert_allclose(fit.values, [0.3, *light], rtol=0, atol=1e-9)


def test_colours_are_averaged(x64):
    random = np.random.default_rng(3)
    tint = np.array([0.8, 1.0, 0.6])
    source = np.round(SMALL[..., None] * tint).astype(np.uint8)
    distorted = np.round(np.asarray(jl.distort_image(SMALL, jl.Division(0.3)))[..., None] * tint)
    distorted = (distorted + random.integers(0, 9, distorted.shape)).astype(np.uint8)
    colour = _fit_small(source, distorted)
    gray = _fit_small(source.mean(axis=-1), distorted.mean(axis=-1))
    assert colour.lens.k.dtype == np.float64
    np.testing.assert_allclose(colour.values, gray.values, rtol=0, atol=1e-9)
    np.testing.assert_allclose(colour.standard_errors, gray.standard_errors, rtol=1e-6)
    assert abs(float(colour.lens.k) - 0.3) < 4 * float(colour.standard_errors[0])


def test_derivatives_by_the_picture(x64):
    """By the implicit function theorem, against fits of pictures a little different."""
    exact = np.asarray(jl.distort_image(SMALL, jl.Division(0.3)))
    random = np.random.default_rng(4)
    distorted, direction = (exact + random.normal(size=exact.shape)), random.normal(size=exact.shape)

    def values(distorted):
        return _fit_small(SMALL, distorted, throw=False).values

    step = 1e-4
    differences = (values(distorted + step * direction) - values(distorted - step * direction)) / (2 * step)
    slope = jax.jit(lambda distorted, direction: jax.jvp(values, (distorted,), (direction,))[1])(distorted, direction)
    np.testing.assert_allclose(slope, differences, rtol=1e-4, atol=1e-6)


def _with(image, place, value):
    image = image.copy()
    image[place] = value
    return image


@pytest.mark.parametrize(
    ("source", "distorted", "keywords", "message"),
    [
        (_with(SMALL, (3, 5), np.nan), SMALL, {}, r"source is not finite at \(row, column\) \(3, 5\)"),
        (SMALL, _with(SMALL, (7, 2), np.inf), {}, r"distorted is not finite at \(row, column\) \(7, 2\)"),
        (np.full((40, 48), 7.0), SMALL, {}, "source shows nothing: all its pixels are 7.0"),
        (SMALL, np.zeros((40, 48)), {}, "distorted shows nothing: all its pixels are 0.0"),
        (SMALL, SMALL, {"mask": np.ones((48, 40), bool)}, r"shape \(40, 48\), got \(48, 40\)"),
        (SMALL[:7], SMALL, {}, r"source must have shape .* 8 pixels a side at least, got \(7, 48\)"),
        (SMALL, SMALL[:, :7], {}, r"distorted must have shape .* got \(40, 7\)"),
        (SMALL + 0j, SMALL, {}, "source must be real, got dtype complex"),
        (SMALL, SMALL, {"loss": "tukey"}, "loss must be one of linear, huber, cauchy"),
        (SMALL, SMALL, {"bounds": {"k1": (0.0, 1.0)}}, "bounds are given for 'k1', which is not fitted"),
        (SMALL, SMALL, {"free": jax.tree.map(lambda _: False, jl.Division(0.0))}, "nothing to fit"),
    ],
)
def test_what_no_fit_could_use(x64, unchecked, source, distorted, keywords, message):
    with pytest.raises(ValueError, match=message):
        fit_images(jl.Division(0.0), source, distorted, **keywords)


def test_a_lens_without_a_center_has_none_to_fit():
    with pytest.raises(ValueError, match="BrownConrady has none"):
        fit_images(jl.BrownConrady(np.zeros(4)), SMALL, SMALL, center=True)
