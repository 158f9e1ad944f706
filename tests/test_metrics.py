import math
from functools import cache, partial

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads
from skimage import metrics as skimage_metrics

from jaxlens import metrics

# Table 1 of the paper: (κ1, κ2) and SNR, PSNR, RMSE. Row (2, 3) repeats the RMSE of row (1, 2).
TABLE_1 = {
    (0, 1): (9.338424, 16.313903, 29.5027238),
    (1, 2): (3.996214, 10.971689, 54.5723698),
    (1, 3): (3.410667, 10.386142, 58.3781284),
    (2, 3): (2.923990, 9.899470, 54.5723698),
    (3, 2): (2.479110, 9.454590, 64.9871918),
    (3, 1): (1.863934, 8.839413, 69.7568175),
}
GAUSSIAN = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}

# Each metric with its required options. The windows are small here: what XLA compiles grows with them.
POINTWISE = {
    "mse": metrics.mse,
    "rmse": metrics.rmse,
    "mae": metrics.mae,
    "minkowski": partial(metrics.minkowski, p=3.0),
    "psnr": partial(metrics.psnr, data_range=255.0),
    "snr": metrics.snr,
    "range_snr": metrics.range_snr,
}


def blended_factors(reference, image, **options):
    factors = metrics.uqi_components(reference, image, window=3, **options)
    return factors.correlation + 2 * factors.luminance + 4 * factors.contrast


WINDOWED = {
    "uqi": partial(metrics.uqi, window=4),
    "uqi_components": blended_factors,
    "ssim": partial(metrics.ssim, data_range=255.0, size=3, sigma=0.8),
}
ALL = POINTWISE | WINDOWED
each_metric = pytest.mark.parametrize("metric", ALL.values(), ids=ALL.keys())


@pytest.fixture(autouse=True)
def _strict_ranks():
    with jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture(params=["float32", "float64"])
def dtype(request):
    with jax.enable_x64(request.param == "float64"):
        yield np.dtype(request.param)


@pytest.fixture
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def x32():
    with jax.enable_x64(False):
        yield


@pytest.fixture
def _untyped():
    """Leave misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def photograph(shape, seed=0, peak=255.0, offset=0.0):
    """A smooth scene with some grain, and a distorted copy of it."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    scene = 0.5 + 0.3 * np.sin(rows / 5) * np.cos(columns / 7)
    scene = scene.reshape(shape[:2] + (1,) * (len(shape) - 2)) * np.linspace(1, 0.7, math.prod(shape[2:]))
    scene = scene.reshape(shape) + random.normal(0, 0.04, shape)
    copy = np.roll(scene, 1, axis=1) * 0.95 + random.normal(0, 0.03, shape)
    return tuple(np.clip(image, 0, 1) * peak + offset for image in (scene, copy))


@cache
def value_and_gradients(metric):
    """The compiled value and both gradients, shared by the tests because compiling is most of their time."""
    return jax.jit(jax.value_and_grad(lambda x, y, mask: metric(x, y, mask=mask), argnums=(0, 1)))


def brute_force_factors(x, y, size):
    """Correlation, luminance, contrast and index of every window, from their definitions."""
    factors = []
    for i in range(x.shape[0] - size + 1):
        for j in range(x.shape[1] - size + 1):
            a, b = x[i : i + size, j : j + size], y[i : i + size, j : j + size]
            mean_a, mean_b, std_a, std_b = a.mean(), b.mean(), a.std(), b.std()
            covariance = np.mean((a - mean_a) * (b - mean_b))
            luminance = 2 * mean_a * mean_b / (mean_a**2 + mean_b**2) if mean_a or mean_b else 1.0
            flat_a, flat_b = np.ptp(a) == 0, np.ptp(b) == 0
            correlation = float(flat_a and flat_b) if flat_a or flat_b else covariance / (std_a * std_b)
            contrast = 1.0 if flat_a and flat_b else 2 * std_a * std_b / (std_a**2 + std_b**2)
            contrast = 0.0 if flat_a != flat_b else contrast
            factors.append((correlation, luminance, contrast, correlation * luminance * contrast))
    return np.mean(factors, axis=0)


# Values worked by hand


def test_values_by_hand(dtype):
    x = np.array([[1, 2], [3, 4]], dtype)
    y = np.array([[1, 4], [0, 4]], dtype)  # errors 0, −2, 3, 0
    close = partial(np.testing.assert_allclose, rtol=4 * np.finfo(dtype).eps)
    close(metrics.mse(x, y), 13 / 4)
    close(metrics.rmse(x, y), math.sqrt(13 / 4))
    close(metrics.mae(x, y), 5 / 4)
    close(metrics.minkowski(x, y, p=1), 5)
    close(metrics.minkowski(x, y, p=2), math.sqrt(13))
    close(metrics.minkowski(x, y, p=3.0), 35 ** (1 / 3))
    close(metrics.minkowski(x, y, p=0.5), (math.sqrt(2) + math.sqrt(3)) ** 2)
    close(metrics.minkowski(x, y, p=math.inf), 3)
    close(metrics.psnr(x, y, data_range=4), 10 * math.log10(16 / 3.25))
    close(metrics.snr(x, y), 10 * math.log10(30 / 13))
    spread = math.sqrt(13 / 4 - (1 / 4) ** 2)
    close(metrics.range_snr(x, y), 20 * math.log10(3 / spread))
    close(metrics.range_snr(x, y, bounds=(0, 10)), 20 * math.log10(10 / spread))
    assert all(metric(x, y).dtype == dtype for metric in POINTWISE.values())


def test_colour_is_the_mean_over_all_channels(dtype):
    x = np.zeros((1, 2, 3), dtype)
    y = np.array([[[3, 0, 0], [0, 0, 3]]], dtype)
    assert metrics.mse(x, y) == 3  # 18 / (two pixels × three channels)
    assert metrics.mse(x, y, mask=np.array([[True, False]])) == 3
    np.testing.assert_allclose(metrics.minkowski(x, y, p=2), math.sqrt(18), rtol=1e-6)


@pytest.mark.parametrize("name", ["psnr", "snr", "range_snr"])
def test_equal_images_have_infinite_decibels(x32, name):
    x = photograph((12, 13, 2))[0].astype(np.float32)
    for image in (x, 0 * x):
        value, gradients = value_and_gradients(ALL[name])(image, image, np.ones((12, 13), bool))
        assert value == np.inf
        assert not np.any(gradients)


def test_no_signal_is_minus_infinity(x32):
    black, noisy = np.zeros((2, 2), np.float32), np.array([[0, 1], [2, 3]], np.float32)
    assert metrics.snr(black, noisy) == -np.inf
    assert metrics.range_snr(black, noisy) == -np.inf
    assert metrics.range_snr(noisy, noisy + 1) == np.inf  # an offset has no spread


# Independent implementations


@pytest.mark.parametrize("shape", [(32, 45), (24, 31, 3)])
def test_agree_with_scikit_image(dtype, shape):
    x, y = (image.astype(dtype) for image in photograph(shape))
    exact = partial(np.testing.assert_allclose, rtol=2e-6 if dtype == np.float32 else 1e-12)
    wide = x.astype(np.float64), y.astype(np.float64)
    axis = {"channel_axis": -1} if len(shape) == 3 else {}
    exact(metrics.mse(x, y), skimage_metrics.mean_squared_error(*wide))
    exact(metrics.psnr(x, y, data_range=255), skimage_metrics.peak_signal_noise_ratio(*wide, data_range=255))
    reference = skimage_metrics.structural_similarity(*wide, data_range=255, **GAUSSIAN, **axis)
    exact(metrics.ssim(x, y, data_range=255), reference)
    reference = skimage_metrics.structural_similarity(*wide, data_range=255, **axis)
    exact(metrics.ssim(x, y, data_range=255, window="uniform", sample_covariance=True), reference)


def test_ssim_options_agree_with_scikit_image(x64):
    x, y = photograph((30, 34), seed=3)
    reference = partial(skimage_metrics.structural_similarity, x, y, data_range=200)
    close = partial(np.testing.assert_allclose, rtol=1e-12)
    ours = partial(metrics.ssim, x, y, data_range=200)
    close(ours(sigma=2.0), reference(gaussian_weights=True, sigma=2.0, use_sample_covariance=False))
    close(ours(k1=0.02, k2=0.05), reference(K1=0.02, K2=0.05, **GAUSSIAN))
    close(ours(window="uniform", size=11), reference(win_size=11, use_sample_covariance=False))
    close(ours(sample_covariance=True), reference(gaussian_weights=True, sigma=1.5))


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_ssim_float32_keeps_its_digits_on_16_bit_images(x32, offset):
    x, y = (np.round(image).astype(np.float32) for image in photograph((64, 64), peak=65535, offset=offset))
    for ours, theirs in (({}, GAUSSIAN), ({"window": "uniform", "sample_covariance": True}, {})):
        wide = x.astype(np.float64), y.astype(np.float64)
        reference = skimage_metrics.structural_similarity(*wide, data_range=65535, **theirs)
        assert abs(metrics.ssim(x, y, data_range=65535, **ours) - reference) < 1e-5


@pytest.mark.parametrize("size", [8, 5])
def test_uqi_agrees_with_brute_force(dtype, size):
    x, y = (np.round(image) for image in photograph((21, 18), seed=1))
    x[:10, :9], y[:10, :9] = 40, 50  # both flat
    x[12:, :9] = 7  # one flat
    y[:9, 9:] = 0
    x[:9, 9:] = 0  # both black
    expected = brute_force_factors(x, y, size)
    ours = metrics.uqi_components(x.astype(dtype), y.astype(dtype), window=size)
    index = metrics.uqi(x.astype(dtype), y.astype(dtype), window=size)
    tolerance = 3e-6 if dtype == np.float32 else 1e-12
    np.testing.assert_allclose([*ours, index], expected, rtol=tolerance, atol=tolerance)


def test_uqi_sees_a_faint_texture_on_a_large_offset(x32):
    random = np.random.default_rng(4)
    x, y = (np.float32(60000) + random.integers(0, 2, (16, 16)).astype(np.float32) for _ in range(2))
    expected = brute_force_factors(x.astype(np.float64), y.astype(np.float64), 8)[-1]
    np.testing.assert_allclose(metrics.uqi(x, y), expected, atol=1e-5)


def test_uqi_extremes(dtype):
    x = photograph((16, 17))[0].astype(dtype)
    close = partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6)
    close(metrics.uqi(x, x), 1)
    close(metrics.uqi(np.full_like(x, 0.1), np.full_like(x, 0.1)), 1)
    close(metrics.uqi(0 * x, 0 * x), 1)
    close(metrics.uqi(np.full_like(x, 10), np.full_like(x, 20)), 0.8)  # luminance alone: 2·200 / 500
    close(metrics.uqi(x, 2 * x), 0.64)  # luminance 0.8 times contrast 0.8
    close(metrics.uqi_components(x, 2 * x), (1, 0.8, 0.8))
    square = x[:8, :8]
    mirrored = 2 * square.mean() - square
    close(metrics.uqi(square, mirrored), -1)  # a single window, mirrored about its mean
    close(metrics.uqi_components(square, mirrored), (-1, 1, 1))
    checks = np.where(np.indices((8, 8)).sum(axis=0) % 2, 1, -1).astype(dtype)
    close(metrics.uqi(checks, -checks), -1)  # both means are 0: luminance is 1


def test_ssim_extremes(dtype):
    x = photograph((16, 17))[0].astype(dtype)
    assert metrics.ssim(x, x, data_range=255) == pytest.approx(1, abs=1e-6)
    flat = metrics.ssim(0 * x, 0 * x + 255, data_range=255)
    np.testing.assert_allclose(flat, 1e-4 / (1 + 1e-4), rtol=1e-5)
    assert metrics.ssim(x, 255 - x, data_range=255) < metrics.ssim(x, x, data_range=255)


@pytest.mark.parametrize("options", [{"window": "uniform", "size": 4}, {"size": 6, "sigma": 1.0}])
def test_ssim_takes_windows_of_even_side(x64, options):
    x, y = photograph((9, 10))
    size = options["size"]
    offsets = np.arange(size) - (size - 1) / 2
    row = np.ones(size) if "window" in options else np.exp(-(offsets**2) / 2)
    weights = np.outer(row, row) / row.sum() ** 2
    scores = []
    for i in range(10 - size):
        for j in range(11 - size):
            a, b = x[i : i + size, j : j + size], y[i : i + size, j : j + size]
            mean_a, mean_b = (weights * a).sum(), (weights * b).sum()
            moments = [weights * u * v for u in (a - mean_a, b - mean_b) for v in (a - mean_a, b - mean_b)]
            saa, sab, _, sbb = (moment.sum() for moment in moments)
            c1, c2 = 2.55**2, 7.65**2
            luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
            scores.append(luminance * (2 * sab + c2) / (saa + sbb + c2))
    np.testing.assert_allclose(metrics.ssim(x, y, data_range=255, **options), np.mean(scores), rtol=1e-12)


# The paper's Table 1


def images_of_row(rmse, peak=193.0, rms=193 / 10 ** (6.97548 / 20), side=100):
    """A reference of the given maximum and root-mean-square, and an image off by the given RMSE."""
    reference = np.full(side * side, math.sqrt((side * side * rms**2 - peak**2) / (side * side - 1)))
    reference[0] = peak
    error = np.zeros(side * side)
    error[::4] = 2 * rmse
    return reference.reshape(side, side), (reference - error).reshape(side, side)


@pytest.mark.parametrize("kappas", TABLE_1)
def test_table_1_identities(x64, kappas):
    snr, psnr, rmse = TABLE_1[kappas]
    implied = 193 / 10 ** (psnr / 20)
    if kappas == (2, 3):
        assert implied == pytest.approx(61.742, abs=5e-4)
        assert rmse == TABLE_1[1, 2][2]  # copied from the row above: the identity fails
    else:
        assert implied == pytest.approx(rmse, rel=1e-6)
    reference, image = images_of_row(implied)
    assert reference.max() == 193
    assert metrics.rmse(reference, image) == pytest.approx(implied, rel=1e-12)
    assert metrics.psnr(reference, image, data_range=193) == pytest.approx(psnr, abs=1e-9)
    assert metrics.snr(reference, image) == pytest.approx(snr, abs=6e-6)  # the digits that it prints
    difference = metrics.psnr(reference, image, data_range=193) - metrics.snr(reference, image)
    assert difference == pytest.approx(6.97548, abs=2e-6)
    rms = math.sqrt(np.mean(reference**2))
    assert rms == pytest.approx(86.4537, abs=1e-4)
    assert difference == pytest.approx(20 * math.log10(193 / rms), rel=1e-12)


# Masks


@each_metric
def test_a_true_mask_changes_nothing(x32, metric):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    whole = metric(x, y, mask=np.ones((12, 13), bool))
    np.testing.assert_allclose(whole, metric(x, y), rtol=10 * np.finfo(np.float32).eps)


@each_metric
def test_what_a_mask_hides_does_not_leak(x32, metric):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    seen = np.zeros((12, 13), bool)
    seen[2:11, 1:9] = True
    expected = metric(x[2:11, 1:9], y[2:11, 1:9])  # the mask's border is the image's
    for garbage in (0, np.nan, np.inf, 1e30):
        x[~seen], y[~seen] = garbage, -garbage
        value, gradients = value_and_gradients(metric)(x, y, seen)
        np.testing.assert_allclose(value, expected, rtol=2e-6)
        for gradient in gradients:
            assert np.all(np.isfinite(gradient))
            assert not np.any(np.asarray(gradient)[~seen])


@each_metric
def test_an_empty_mask_gives_nan(x32, metric):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    assert np.isnan(metric(x, y, mask=np.zeros((12, 13), bool)))


@pytest.mark.parametrize("metric", WINDOWED.values(), ids=WINDOWED.keys())
def test_a_mask_that_holds_no_window_gives_nan(x32, metric):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    mask = np.ones((12, 13), bool)
    mask[::3, ::3] = False
    assert np.isnan(metric(x, y, mask=mask))


def test_windows_count_only_where_the_mask_holds_them(x64):
    x, y = photograph((20, 20))
    mask = np.ones((20, 20), bool)
    mask[9, 10] = False
    scores = [
        metrics.uqi(x[i : i + 8, j : j + 8], y[i : i + 8, j : j + 8])
        for i in range(13)
        for j in range(13)
        if mask[i : i + 8, j : j + 8].all()
    ]
    assert len(scores) == 13 * 13 - 8 * 8
    np.testing.assert_allclose(metrics.uqi(x, y, mask=mask), np.mean(scores), rtol=1e-12)


@each_metric
def test_a_nan_that_counts_is_seen(x32, metric):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    y[5, 6] = np.nan
    assert np.isnan(metric(x, y))


# Derivatives


@each_metric
def test_gradients_agree_with_finite_differences(x64, metric):
    mask = jnp.ones((6, 7), bool).at[0, :].set(False)
    x, y = (jnp.asarray(image) for image in photograph((6, 7, 2), seed=2))
    masked = jax.jit(partial(metric, mask=mask))
    check_grads(masked, (x, y), order=1, modes=("fwd", "rev"), rtol=2e-6, atol=1e-8, eps=1e-4)


def test_ssim_gradient_with_its_default_window(x64):
    x, y = (jnp.asarray(image) for image in photograph((12, 13), seed=2))
    ssim = jax.jit(partial(metrics.ssim, data_range=255))
    check_grads(ssim, (x, y), order=1, modes=("rev",), rtol=2e-6, atol=1e-8, eps=1e-3)


def test_ssim_second_derivative(x64):
    x, y = (jnp.asarray(image) / 255 for image in photograph((4, 5), seed=2))
    ssim = jax.jit(partial(metrics.ssim, data_range=1.0, size=3))
    check_grads(ssim, (x, y), order=2, modes=("rev",), rtol=1e-5, atol=1e-6, eps=1e-4)


def test_derivatives_of_the_options(x64):
    x, y = (jnp.asarray(image) for image in photograph((6, 7), seed=2))

    def check(function, *arguments):
        check_grads(jax.jit(function), arguments, order=1, modes=("rev",), rtol=1e-6, eps=1e-5)

    check(lambda p: metrics.minkowski(x, y, p=p), 2.5)
    check(lambda peak: metrics.psnr(x, y, data_range=peak), 200.0)
    check(lambda peak, k: metrics.ssim(x, y, data_range=peak, k1=k, k2=k, size=3), 200.0, 0.3)
    check(lambda low, high: metrics.range_snr(x, y, bounds=(low, high)), 1.0, 200.0)


@each_metric
def test_gradients_are_finite_at_equal_images(x32, metric):
    x = photograph((12, 13, 2))[0].astype(np.float32)
    x[:, :9] = 3  # flat windows too
    for gradient in value_and_gradients(metric)(x, x, np.ones((12, 13), bool))[1]:
        assert np.all(np.isfinite(gradient))


traced_minkowski = jax.jit(lambda x, y, p: metrics.minkowski(x, y, p=p))
minkowski_gradient = jax.jit(jax.grad(traced_minkowski, argnums=1))


@pytest.mark.parametrize("p", [0.5, 1.0, 2.0, 7.3, math.inf])
def test_minkowski_gradient_with_zero_errors(dtype, p):
    x = np.zeros((2, 2), dtype)
    y = np.array([[0, 0], [-3, 0]], dtype)
    np.testing.assert_allclose(minkowski_gradient(x, y, p), [[0, 0], [-1, 0]], atol=1e-6)
    assert not np.any(minkowski_gradient(x, x, p))


@pytest.mark.parametrize("p", [0.1, 1.0, 40.0, 1e4, math.inf])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_minkowski_does_not_overflow(x32, p, scale):
    error = np.array([[1.0, 2.0, 3.0, 0.0]])
    exact = 3.0 if math.isinf(p) else 3.0 * np.sum((error[error > 0] / 3) ** p) ** (1 / p)
    x, y = np.zeros((1, 4), np.float32), (scale * error).astype(np.float32)
    np.testing.assert_allclose(metrics.minkowski(x, y, p=p) / np.float32(scale), exact, rtol=2e-5)
    np.testing.assert_allclose(traced_minkowski(x, y, p), metrics.minkowski(x, y, p=p), rtol=1e-6)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(
    p=st.floats(1, 12),
    q=st.floats(1, 12),
    errors=st.lists(st.floats(-100, 100, width=32), min_size=6, max_size=6),
)
def test_minkowski_falls_with_p(p, q, errors):
    with jax.enable_x64(True):
        x, y = np.zeros((2, 3)), np.reshape(np.array(errors), (2, 3))
        low, high = sorted((p, q))
        more, less = metrics.minkowski(x, y, p=low), metrics.minkowski(x, y, p=high)
        assert more >= less * (1 - 1e-12)
        assert less >= metrics.minkowski(x, y, p=math.inf) * (1 - 1e-12)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), gain=st.floats(0.1, 10))
def test_scale_and_symmetry(seed, gain):
    with jax.enable_x64(True):
        x, y = photograph((14, 15), seed=seed)
        close = partial(np.testing.assert_allclose, rtol=1e-9)
        close(metrics.rmse(gain * x, gain * y), gain * metrics.rmse(x, y))
        close(metrics.snr(gain * x, gain * y), metrics.snr(x, y))
        close(metrics.uqi(gain * x, gain * y), metrics.uqi(y, x))
        scaled = metrics.ssim(gain * x, gain * y, data_range=gain * 255)
        close(scaled, metrics.ssim(y, x, data_range=255))
        assert -1 <= metrics.uqi(x, y) <= 1


# Transformations


@each_metric
def test_vmap_changes_nothing(x32, metric):
    pairs = [tuple(image.astype(np.float32) for image in photograph((12, 13, 2), seed=seed)) for seed in range(3)]
    masks = np.random.default_rng(0).uniform(size=(3, 12, 13)) > 0.02
    xs, ys = (jnp.stack(images) for images in zip(*pairs, strict=True))
    batched = jax.jit(jax.vmap(lambda x, y, mask: metric(x, y, mask=mask)))(xs, ys, masks)
    singly = [metric(x, y, mask=mask) for (x, y), mask in zip(pairs, masks, strict=True)]
    np.testing.assert_allclose(batched, singly, rtol=2e-5)


@pytest.mark.parametrize("name", ["psnr", "minkowski", "ssim"])
def test_jit_changes_nothing(x32, name):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    compiled = ALL[name](x, y)
    with jax.disable_jit():
        np.testing.assert_allclose(ALL[name](x, y), compiled, rtol=2e-6)


def test_ssim_in_a_batch_of_colour_images(x32):
    pairs = [photograph((12, 13, 3), seed=seed) for seed in range(2)]
    xs, ys = (jnp.stack(images) for images in zip(*pairs, strict=True))
    batched = jax.jit(jax.vmap(partial(metrics.ssim, data_range=255.0)))(xs, ys)
    singly = [metrics.ssim(x, y, data_range=255.0) for x, y in pairs]
    np.testing.assert_allclose(batched, singly, rtol=1e-5)


def test_batched_options(x32):
    x, y = photograph((14, 15))
    ps, peaks = jnp.array([0.5, 2, jnp.inf, -1]), jnp.array([1.0, 255, 0, -1])
    distances = jax.vmap(lambda p: metrics.minkowski(x, y, p=p))(ps)
    np.testing.assert_allclose(distances[:3], [metrics.minkowski(x, y, p=float(p)) for p in ps[:3]], rtol=1e-6)
    levels = jax.vmap(lambda peak: metrics.psnr(x, y, data_range=peak))(peaks)
    indices = jax.vmap(lambda peak: metrics.ssim(x, y, data_range=peak))(peaks)
    np.testing.assert_allclose(levels[1], metrics.psnr(x, y, data_range=255), rtol=1e-6)
    np.testing.assert_allclose(indices[1], metrics.ssim(x, y, data_range=255), rtol=1e-6)
    assert np.isnan(distances[3])
    assert np.all(np.isnan(levels[2:]))
    assert np.all(np.isnan(indices[2:]))


# Dtypes and accuracy


@pytest.mark.parametrize("kind", ["uint8", "uint16", "uint32", "int8", "int16", "int32", "int64", "bool"])
def test_integers_do_not_wrap(dtype, kind):
    x, y = (np.zeros((12, 12), kind), np.full((12, 12), 1, kind))
    assert metrics.mse(x, y) == 1
    assert metrics.mse(jnp.asarray(x), y) == metrics.mse(x, jnp.asarray(y)) == 1


def test_integers_become_the_default_float(dtype):
    x, y = (image.astype(np.uint8) for image in photograph((12, 13)))
    for name in ("mae", "uqi"):
        score = ALL[name](x, y)
        assert score.dtype == dtype
        np.testing.assert_allclose(score, ALL[name](x.astype(dtype), y.astype(dtype)), rtol=1e-6)


def test_large_64_bit_integers(dtype):
    x, y = np.full((2, 2), 2**40, np.int64), np.full((2, 2), 2**40 - 2**20, np.int64)
    assert metrics.rmse(x, y) == 2**20


@pytest.mark.parametrize("kind", ["float16", "bfloat16"])
def test_half_precision_is_computed_in_single(x32, kind):
    x, y = (jnp.asarray(image, kind) * 200 for image in photograph((12, 13)))  # squares overflow float16
    for name in ("mse", "snr", "ssim"):
        score = ALL[name](x, y)
        assert score.dtype == jnp.float32
        np.testing.assert_allclose(score, ALL[name](x.astype("float32"), y.astype("float32")), rtol=1e-6)


def test_mixed_dtypes_take_the_wider(x64):
    x, y = photograph((12, 13))
    assert metrics.mse(x.astype(np.float32), y.astype(np.float32)).dtype == np.float32
    assert metrics.mse(x.astype(np.float32), y).dtype == np.float64
    assert metrics.mse(x.astype(np.float16), y.astype(np.uint8)).dtype == np.float64


def test_sums_over_a_megapixel_are_accurate(x32):
    random = np.random.default_rng(0)
    x = random.uniform(0, 65535, (1024, 1024)).astype(np.float32)
    y = (x + np.float32(0.1) * random.uniform(900, 1100, x.shape)).astype(np.float32)
    wide_x, wide_y = x.astype(np.float64), y.astype(np.float64)
    close = partial(np.testing.assert_allclose, rtol=1e-6)
    close(metrics.mse(x, y), np.mean((wide_x - wide_y) ** 2))
    close(metrics.mae(x, y), np.mean(np.abs(wide_x - wide_y)))
    close(metrics.minkowski(x, y, p=4), np.sum((wide_x - wide_y) ** 4) ** 0.25)
    close(metrics.range_snr(x, y), 20 * np.log10(np.ptp(wide_x) / np.std(wide_x - wide_y)))


# All at once


def test_evaluate_is_each_metric(x32):
    x, y = (image.astype(np.float32) for image in photograph((12, 13, 2)))
    mask = np.ones((12, 13), bool)
    mask[:, 0] = False
    scores = metrics.evaluate(x, y, data_range=255, mask=mask)
    expected = {
        "snr": metrics.snr(x, y, mask=mask),
        "psnr": metrics.psnr(x, y, data_range=255, mask=mask),
        "rmse": metrics.rmse(x, y, mask=mask),
        "mae": metrics.mae(x, y, mask=mask),
        "mse": metrics.mse(x, y, mask=mask),
        "range_snr": metrics.range_snr(x, y, mask=mask),
        "uqi": metrics.uqi(x, y, mask=mask),
        "ssim": metrics.ssim(x, y, data_range=255, mask=mask),
        "minkowski": metrics.minkowski(x, y, p=4, mask=mask),
    }
    assert list(scores) == list(expected)
    np.testing.assert_allclose(list(scores.values()), list(expected.values()), rtol=20 * np.finfo(np.float32).eps)
    assert all(score.shape == () and score.dtype == np.float32 for score in scores.values())


def test_evaluate_in_a_batch_keeps_its_order(x32):
    pairs = [photograph((11, 12), seed=seed) for seed in range(2)]
    xs, ys = (jnp.stack(images) for images in zip(*pairs, strict=True))
    batched = jax.jit(jax.vmap(partial(metrics.evaluate, data_range=255.0)))(xs, ys)
    for index, (x, y) in enumerate(pairs):
        scores = metrics.evaluate(x, y, data_range=255)
        assert list(batched) == list(scores)
        for name, score in scores.items():
            np.testing.assert_allclose(batched[name][index], score, rtol=1e-5)


@pytest.mark.parametrize(("side", "missing"), [(1, {"uqi", "ssim"}), (10, {"ssim"})])
def test_evaluate_takes_images_smaller_than_a_window(dtype, side, missing):
    x, y = (image.astype(dtype) for image in photograph((side, 40)))
    scores = metrics.evaluate(x, y, data_range=255)
    assert {name for name, score in scores.items() if np.isnan(score)} == missing
    assert all(score.dtype == dtype for score in scores.values())


# Misuse

IMAGE = np.zeros((12, 13), np.float32)


@pytest.mark.usefixtures("_untyped")
@pytest.mark.parametrize("metric", [*ALL.values(), partial(metrics.evaluate, data_range=1.0)])
@pytest.mark.parametrize(
    ("reference", "image", "mask", "message"),
    [
        (IMAGE, IMAGE[1:], None, r"\(12, 13\) and image \(11, 13\)"),
        (IMAGE, np.zeros((12, 13, 1)), None, "must be equal"),
        (IMAGE[0], IMAGE[0], None, r"\(H, W\) or \(H, W, C\)"),
        (IMAGE[None, None], IMAGE[None, None], None, "jax.vmap"),
        (IMAGE[:0], IMAGE[:0], None, "no pixels"),
        (IMAGE.astype(complex), IMAGE, None, "reference is complex"),
        (IMAGE, IMAGE.astype(complex), None, "image is complex"),
        (IMAGE, IMAGE, np.ones((13, 12), bool), r"mask has shape \(13, 12\)"),
        (IMAGE, IMAGE, np.ones((12, 13, 1), bool), "one mask serves all channels"),
        (IMAGE, IMAGE, np.ones((12, 13), np.uint8), "mask > 0"),
    ],
)
def test_misuse_of_images(metric, reference, image, mask, message):
    with pytest.raises(ValueError, match=message):
        metric(reference, image, mask=mask)


@pytest.mark.usefixtures("_untyped")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (partial(metrics.psnr, data_range=0), "data_range is 0; it must be above 0"),
        (partial(metrics.psnr, data_range=-1.0), "255 for 8-bit"),
        (partial(metrics.psnr, data_range=np.float32("nan")), "data_range is nan"),
        (partial(metrics.ssim, data_range=jnp.float32(0)), "data_range is 0"),
        (partial(metrics.evaluate, data_range=0), "data_range is 0"),
        (partial(metrics.minkowski, p=0), "p is 0"),
        (partial(metrics.minkowski, p=-2.0), "p is -2.0"),
        (partial(metrics.minkowski, p=math.nan), "p is nan"),
        (partial(metrics.range_snr, bounds=(1, 1)), r"bounds are \(1, 1\)"),
        (partial(metrics.range_snr, bounds=(2.0, math.nan)), "a_min below a_max"),
        (partial(metrics.uqi, window=13), "window is 13, but the image is 12×13"),
        (partial(metrics.uqi_components, window=0), "window is 0"),
        (partial(metrics.uqi, window=8.0), "window is 8.0"),
        (partial(metrics.ssim, data_range=1, sigma=2.0), "size is 15, but the image is 12×13"),
        (partial(metrics.ssim, data_range=1, size=True), "size is True"),
        (partial(metrics.ssim, data_range=1, sigma=0), "sigma is 0"),
        (partial(metrics.ssim, data_range=1, k1=0), "k1 is 0"),
        (partial(metrics.ssim, data_range=1, k2=-0.1), "k2 is -0.1"),
        (partial(metrics.ssim, data_range=1, window="box"), "window is 'box'"),
        (partial(metrics.ssim, data_range=1, size=1, sample_covariance=True), "more than one pixel"),
    ],
)
def test_misuse_of_options(call, message):
    with pytest.raises(ValueError, match=message):
        call(IMAGE, IMAGE)


def test_options_are_keyword_only_and_required(x32):
    with pytest.raises(TypeError):
        metrics.psnr(IMAGE, IMAGE)
    with pytest.raises(TypeError):
        metrics.mse(IMAGE, IMAGE, np.ones((12, 13), bool))


# How rows are cut does not depend on the dtype.
@pytest.mark.parametrize(
    ("rows", "dtype"),
    [(rows, np.uint8) for rows in (1, 5, 10, 11, 17, 39, 40, 41, None)] + [(17, np.float32), (17, np.float64)],
)
@pytest.mark.slow
def test_strips_give_the_same(rows, dtype):
    rng = np.random.default_rng(3)
    reference = (200 * rng.random((40, 23, 3))).astype(dtype)
    image = np.clip(reference + rng.normal(0, 20, reference.shape), 0, 255).astype(dtype)
    with jax.enable_x64(True):
        whole = metrics.evaluate(reference, image, data_range=255.0)
        parts = metrics.evaluate_in_strips(reference, image, data_range=255.0, rows=rows)
        assert list(parts) == list(whole)
        tight = 1e-12 if dtype != np.float32 else 1e-5
        for name, score in whole.items():
            np.testing.assert_allclose(parts[name], score, rtol=tight, err_msg=name)


@pytest.mark.parametrize("rows", [3, None])
@pytest.mark.parametrize("shape", [(7, 30), (30, 7), (10, 30), (30, 10), (1, 1)])
@pytest.mark.parametrize("change", [0.0, 3.0])
def test_strips_of_small_flat_and_equal_images(rows, shape, change):
    for reference in (np.zeros(shape), np.arange(float(np.prod(shape))).reshape(shape)):
        whole = metrics.evaluate(reference, reference + change, data_range=255.0)
        parts = metrics.evaluate_in_strips(reference, reference + change, data_range=255.0, rows=rows)
        for name, score in whole.items():
            np.testing.assert_allclose(parts[name], score, rtol=1e-6, err_msg=name)


@pytest.mark.usefixtures("_untyped")
def test_strips_that_cannot_be():
    with pytest.raises(ValueError, match="must be equal"):
        metrics.evaluate_in_strips(np.zeros((4, 4)), np.zeros((4, 5)), data_range=1.0)
    with pytest.raises(ValueError, match="rows is 0"):
        metrics.evaluate_in_strips(np.zeros((4, 4)), np.zeros((4, 4)), data_range=1.0, rows=0)
    with pytest.raises(ValueError, match="holds no pixels"):
        metrics.evaluate_in_strips(np.zeros((0, 4)), np.zeros((0, 4)), data_range=1.0)


def largest_error(reference, image, *, mask=None):
    return metrics.minkowski(reference, image, p=np.inf, mask=mask)


def test_a_new_metric_is_a_function_and_a_row(monkeypatch, x32):
    reference = np.arange(24.0).reshape(4, 6)
    before = metrics.evaluate(reference, reference / 2, data_range=255)
    row = metrics.Metric(largest_error, "largest error", "gray levels", "the largest of the errors")
    monkeypatch.setitem(metrics.METRICS, "largest", row)
    for evaluate in (metrics.evaluate, metrics.evaluate_in_strips):
        scores = evaluate(reference, reference / 2, data_range=255)
        assert list(scores) == [*before, "largest"]
        assert float(scores["largest"]) == 11.5
