"""Fits to correspondences: exact, against regression and SciPy, against their own noise; gradients, failures."""

import functools

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import jaxlens as jl
from jaxlens.fitting import FitError, FitStatus, FitWarning, fit_points

FRAME = ([319.5, 239.5], [400.0, 410.0])
CENTER = [0.02, -0.01]
# What is fitted with `center=True`, nearly everywhere below.
NAMES = ("kappa1", "kappa2", "center_x", "center_y")
TRUTH = np.array([-0.2, 0.05, *CENTER])
NOISE = 1e-3
# Fits that agree in shapes, dtypes and choice share a compilation, which is nearly all the time: hence one number of
# points, and weights in float32 (as they are by default) or in float64 on purpose.
COUNT = 200
# Of a standard error: the solver takes a step of a millionth of the residuals' length as its last.
SETTLED = 1e-5


@pytest.fixture
def _untyped():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def _start(order=2):
    return jl.RadialPolynomial(np.zeros(order))


def _ideal(seed=0):
    return np.random.default_rng(seed).uniform(-0.7, 0.7, (COUNT, 2))


def _model(parameters, ideal):
    """The lens of order two and its centre, written once more in NumPy."""
    kappa1, kappa2, *center = parameters
    offset = ideal - np.array(center)
    squared = np.sum(offset**2, axis=-1, keepdims=True)
    return np.array(center) + offset * (1 + kappa1 * squared + kappa2 * squared**2)


def _noisy(seed=0):
    ideal = _ideal(seed)
    return ideal, _model(TRUTH, ideal) + NOISE * np.random.default_rng(1000 + seed).normal(size=ideal.shape)


def _none_of(lens):
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, bool), lens)


EXACT = {
    "radial, 1": (jl.RadialPolynomial, [-0.2], False, False),
    "radial, 2, centre": (jl.RadialPolynomial, [0.1, 0.05], True, False),
    "radial, 3, centre, scale": (jl.RadialPolynomial, [0.3, -0.2, 0.1], True, True),
    "division, centre, scale": (jl.Division, -0.15, True, True),
    "brown, 4": (jl.BrownConrady, [-0.28, 0.07, 1e-3, -2e-3], False, False),
    "brown, 5, scale": (jl.BrownConrady, [-0.28, 0.07, 1e-3, -2e-3, 0.02], False, True),
}
COEFFICIENTS = {
    jl.RadialPolynomial: ["kappa1", "kappa2", "kappa3"],
    jl.Division: ["k"],
    jl.BrownConrady: ["k1", "k2", "p1", "p2", "k3"],
}


@pytest.mark.parametrize("case", EXACT)
def test_exact_data_give_the_lens_back(x64, case):
    """The scale goes with a frame: then all is in pixels, and the picture 7 % larger than the frame says."""
    kind, coefficients, center, scale = EXACT[case]
    coefficients = np.array(coefficients)
    lens = kind(coefficients, center=np.array(CENTER)) if center else kind(coefficients)
    ideal = _ideal()
    expected = dict(zip(COEFFICIENTS[kind], coefficients.ravel(), strict=False))
    expected |= dict(zip(NAMES[2:], CENTER, strict=True)) if center else {}
    frame = jl.Frame(*map(np.array, FRAME)) if scale else None
    observed = frame.zoomed(1.07).denormalize(lens.distort(ideal)) if scale else lens.distort(ideal)
    expected |= {"scale": 1.07} if scale else {}
    start = kind(np.zeros_like(coefficients))
    fit = fit_points(start, ideal, observed, frame=frame, center=center, scale=scale)
    assert fit.parameters.keys() == expected.keys()
    for name, value in expected.items():
        assert fit.parameters[name] == pytest.approx(value, rel=1e-9)
    for found, true in zip(jax.tree.leaves(fit.lens), jax.tree.leaves(lens), strict=True):
        np.testing.assert_allclose(found, true, rtol=1e-9)
    if scale:
        np.testing.assert_allclose(fit.frame.scale, 1.07 * np.array(FRAME[1]), rtol=1e-9)
        np.testing.assert_array_equal(fit.frame.center, FRAME[0])
    assert fit.status == FitStatus.CONVERGED
    assert fit.degrees_of_freedom == 2 * COUNT - len(expected)
    assert fit.residuals.shape == (COUNT, 2)
    assert np.max(np.abs(fit.residuals)) < (1e-9 if scale else 1e-12)
    assert fit.loss_scale == np.inf
    assert fit.poses is None
    assert not fit.folds


def test_without_a_center_it_is_linear_regression(x64):
    """Closed form: the observed points are linear in the coefficients."""
    ideal, observed = _noisy()
    weights = np.random.default_rng(2).uniform(0.3, 3, COUNT)
    squared = np.sum(ideal**2, axis=1, keepdims=True)
    root = np.sqrt(weights).repeat(2)
    design = root[:, None] * np.stack([(ideal * squared ** (i + 1)).ravel() for i in range(2)], axis=1)
    goal = root * (observed - ideal).ravel()
    expected, (sum_of_squares,) = np.linalg.lstsq(design, goal)[:2]
    variance = sum_of_squares / (2 * COUNT - 2)
    fit = fit_points(_start(), ideal, observed, weights=weights)
    np.testing.assert_allclose(fit.values, expected, rtol=1e-10)
    np.testing.assert_allclose(fit.covariance, variance * np.linalg.inv(design.T @ design), rtol=1e-10)
    np.testing.assert_allclose(fit.residuals.ravel(), (goal - design @ expected) / root, atol=1e-12)
    # `rms` is of lengths in the plane, of which there are as many as points.
    assert fit.rms == pytest.approx(np.sqrt(sum_of_squares / weights.sum()), rel=1e-10)
    unit = design / np.linalg.norm(design, axis=0)
    assert fit.condition_number == pytest.approx(np.linalg.cond(unit), rel=1e-8)
    np.testing.assert_allclose(fit.inflation, np.diag(np.linalg.inv(unit.T @ unit)), rtol=1e-8)
    weakest = np.linalg.svd(unit)[2][-1]
    assert abs(weakest @ np.asarray(fit.weakest_direction)) == pytest.approx(1, rel=1e-10)


@functools.cache
def _study(loss):
    """A function that fits to 300 pictures of the same points at once, with weights of their own."""

    def fit(observed, weights):
        return fit_points(_start(), _ideal(), observed, weights=weights, center=True, loss=loss)

    return jax.jit(jax.vmap(fit))


def _pictures():
    """300 of them: with normal noise, and with a fifth of the points put anywhere in the picture; weights."""
    random = np.random.default_rng(5)
    clean = _model(TRUTH, _ideal()) + NOISE * random.normal(size=(300, COUNT, 2))
    wrong = random.random((300, COUNT, 1)) < 0.2
    spoilt = np.where(wrong, random.uniform(-0.7, 0.7, clean.shape), clean)
    return clean, spoilt, np.ones((300, COUNT), np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["linear", "huber", "cauchy"])
def test_standard_errors_are_those_of_repeated_noise(x64, loss):
    clean, _, ones = _pictures()
    fits = _study(loss)(clean, ones)
    assert fits.names == NAMES
    assert not np.any(fits.status)
    errors = np.asarray(fits.values) - TRUTH
    np.testing.assert_allclose(errors.std(0) / np.mean(fits.standard_errors, 0), 1, atol=0.1)
    # Correlations included: normalized errors are χ² with four degrees of freedom in each of the 300.
    total = np.sum(errors * np.linalg.solve(np.asarray(fits.covariance), errors[..., None])[..., 0])
    low, high = scipy.stats.chi2(300 * 4).interval(0.99)
    assert low < total < high
    # And unbiased, up to the standard error of a mean.
    assert np.all(np.abs(errors.mean(0)) < 3 * errors.std(0) / np.sqrt(300))
    if loss != "linear":
        # What the tuning constants promise: 95 % efficiency, and a bend at that multiple of the noise.
        plain = np.asarray(_study("linear")(clean, ones).values) - TRUTH
        np.testing.assert_allclose(plain.var(0) / errors.var(0), 0.95, atol=0.05)
        bend = {"huber": 1.345, "cauchy": 2.3849}[loss] * NOISE
        assert np.mean(fits.loss_scale) == pytest.approx(bend, rel=0.02)


def test_a_fifth_of_gross_outliers(x64):
    """Plain least squares is far off; with the Cauchy loss every one of 300 fits stays within its standard errors."""
    _, spoilt, ones = _pictures()
    fits = _study("cauchy")(spoilt, ones)
    assert not np.any(fits.status)
    errors = np.asarray(fits.values) - TRUTH
    assert np.max(np.abs(errors) / np.asarray(fits.standard_errors)) < 4
    plain = np.asarray(_study("linear")(spoilt, ones).values) - TRUTH
    assert np.all(np.sqrt(np.mean(plain**2, 0)) > 50 * np.sqrt(np.mean(errors**2, 0)))
    # A median moves with the share of what is wrong, not with its size.
    assert np.max(fits.loss_scale) < 2 * 2.3849 * NOISE


def test_agrees_with_scipy(x64):
    ideal, observed = _noisy(seed=1)
    weights = np.random.default_rng(2).uniform(0.3, 3, COUNT).astype(np.float32)

    def residuals(parameters):
        return (np.sqrt(weights.astype(float))[:, None] * (observed - _model(parameters, ideal))).ravel()

    theirs = scipy.optimize.least_squares(residuals, np.zeros(4), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = fit_points(_start(), ideal, observed, weights=weights, center=True)
    errors = np.asarray(fit.standard_errors)
    np.testing.assert_allclose(np.asarray(fit.values) / errors, theirs.x / errors, atol=SETTLED, rtol=0)
    covariance = 2 * theirs.cost / (2 * COUNT - 4) * np.linalg.inv(theirs.jac.T @ theirs.jac)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-5)
    assert fit.rms == pytest.approx(np.sqrt(2 * theirs.cost / weights.sum(dtype=float)), rel=1e-10)
    np.testing.assert_allclose(fit.residuals, observed - _model(theirs.x, ideal), atol=1e-8)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_agrees_with_scipy(x64, loss):
    """SciPy's losses act on numbers: on the residuals' lengths they are the same loss."""
    clean, spoilt, ones = _pictures()
    fits = _study(loss)(spoilt, ones)
    plain = np.asarray(_study("linear")(clean, ones).values)
    for k in range(3):

        def lengths(parameters, observed=spoilt[k]):
            return np.linalg.norm(observed - _model(parameters, _ideal()), axis=1)

        scale = float(fits.loss_scale[k])
        theirs = scipy.optimize.least_squares(
            lengths, plain[k], loss=loss, f_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=10000
        )
        errors = np.asarray(fits.standard_errors[k])
        np.testing.assert_allclose(np.asarray(fits.values[k]) / errors, theirs.x / errors, atol=1e-4, rtol=0)


def test_weights_repeat_points_and_weight_zero_leaves_them_out(x64):
    """Whatever stands in the rows that do not count."""
    half = COUNT // 2
    ideal, observed = _noisy()
    times = np.tile([1, 2, 3, 2], half // 4)
    weights = np.zeros(COUNT, np.float32)
    weights[::2] = times
    repeated = fit_points(_start(), ideal[::2].repeat(times, 0), observed[::2].repeat(times, 0), center=True)
    spoilt, blank = observed.copy(), ideal.copy()
    spoilt[1], spoilt[3], blank[3], blank[5] = np.nan, [np.inf, 1e30], np.nan, np.nan
    for left, right, factor in ((ideal, observed, 1), (blank, spoilt, 1), (ideal, observed, 1 << 12)):
        fit = fit_points(_start(), left, right, weights=np.float32(factor) * weights, center=True)
        assert fit.status == FitStatus.CONVERGED
        np.testing.assert_allclose(fit.values, repeated.values, rtol=1e-9)
        # For the noise each point is counted once, whatever its weight: weights are relative.
        assert fit.degrees_of_freedom == 2 * half - 4
        ratio = (2 * COUNT - 4) / (2 * half - 4)
        np.testing.assert_allclose(fit.covariance, ratio * np.asarray(repeated.covariance), rtol=1e-8)
        assert fit.rms == pytest.approx(float(repeated.rms), rel=1e-10)
        np.testing.assert_allclose(fit.residuals[::2].repeat(times, 0), repeated.residuals, atol=1e-12)
        assert np.all(np.asarray(fit.residuals[1::2]) == 0)
        assert not fit.folds


def test_as_many_equations_as_parameters(x64):
    """A fit without residuals says nothing about the noise."""
    ideal = _ideal()
    weights = np.zeros(COUNT, np.float32)
    weights[:2] = 1
    observed = _model(TRUTH, ideal)
    start = jl.RadialPolynomial(np.array([-0.1, 0.0]))
    fit = fit_points(start, ideal, observed, weights=weights, center=True)
    assert fit.status == FitStatus.CONVERGED
    assert fit.degrees_of_freedom == 0
    np.testing.assert_allclose(fit.residuals, 0, atol=1e-12)
    assert np.isnan(fit.covariance).all()


def test_a_mask_frees_single_coefficients(x64):
    ideal = _ideal()
    start = jl.RadialPolynomial(np.array([-0.2, 0.0]))
    mask = _none_of(start)
    mask.coefficients[1] = True
    fit = fit_points(start, ideal, _model(TRUTH, ideal), free=mask, center=True)
    assert fit.names == NAMES[1:]
    np.testing.assert_allclose(fit.values, TRUTH[1:], rtol=1e-9)
    np.testing.assert_array_equal(fit.lens.coefficients, [-0.2, fit.values[0]])
    np.testing.assert_array_equal(fit.lens.center, fit.values[1:])
    assert fit.degrees_of_freedom == 2 * COUNT - 3


def test_bounds(x64):
    ideal, observed = _noisy()
    fits = functools.partial(fit_points, ideal=ideal, observed=observed, center=True)
    unbounded = fits(_start())
    errors = np.asarray(unbounded.standard_errors)
    wide = fits(_start(), bounds={"kappa1": (-1.0, 1.0), "center_x": (-np.inf, 1.0)})
    np.testing.assert_allclose(np.asarray(wide.values) / errors, np.asarray(unbounded.values) / errors, atol=SETTLED)
    # Where a bound is active the rest is that of a fit in which the parameter is fixed there.
    at_bound = jl.RadialPolynomial(np.array([-0.15, 0.0]))
    mask = _none_of(at_bound)
    mask.coefficients[1] = True
    fixed = fits(at_bound, free=mask)
    assert fixed.names == NAMES[1:]
    outside = jl.RadialPolynomial(TRUTH[:2])
    starts = (at_bound, -0.15, 1.0), (at_bound, -0.15, -0.15), (_start(), -0.15, np.inf), (outside, -0.15, np.inf)
    for start, low, high in starts:
        fit = fits(start, bounds={"kappa1": (low, high)})
        assert fit.names == NAMES
        assert fit.status == FitStatus.CONVERGED
        assert fit.values[0] == -0.15
        np.testing.assert_allclose(
            np.asarray(fit.values[1:]) / errors[1:], np.asarray(fixed.values) / errors[1:], atol=SETTLED, rtol=0
        )
        assert fit.rms > unbounded.rms
    cornered = fits(_start(), bounds={"kappa1": (-0.15, 0.2), "center_x": (-0.01, 0.01)})
    assert cornered.values[0] == -0.15
    assert cornered.values[2] == 0.01


def test_single_precision():
    """All in float32, and still within a small share of a standard error of what double precision finds."""
    ideal, observed = _noisy()
    with jax.enable_x64(False):
        single = fit_points(_start(), ideal.astype(np.float32), observed.astype(np.float32), center=True)
    floating = [leaf.dtype for leaf in jax.tree.leaves(single) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert set(floating) == {np.dtype("float32")}
    with jax.enable_x64(True):
        double = fit_points(_start(), ideal, observed, center=True)
        assert double.values.dtype == np.float64
        difference = np.asarray(single.values, float) - np.asarray(double.values)
        assert np.max(np.abs(difference) / np.asarray(double.standard_errors)) < 5e-3
        np.testing.assert_allclose(single.standard_errors, double.standard_errors, rtol=2e-3)


def test_a_batch_is_a_loop_and_a_bad_fit_stays_alone(x64):
    """Under a transformation nothing is raised: there is only the status to tell."""
    observed, _, weights = _pictures()
    observed[2, 5, 0] = np.nan
    weights[1, 3:] = 0
    weights[3, 1:] = 0
    weights[4] = 0
    fits = _study("linear")(observed, weights)
    good, bad, few = FitStatus.CONVERGED, FitStatus.NOT_FINITE, FitStatus.TOO_FEW
    assert fits.status[:5].tolist() == [good, good, bad, few, few]
    assert not np.any(fits.status[5:])
    assert np.isnan(fits.covariance[2:5]).all()
    for k in (0, 1, 5):
        alone = fit_points(_start(), _ideal(), observed[k], weights=weights[k], center=True)
        np.testing.assert_allclose(fits.values[k], alone.values, rtol=1e-8)
        np.testing.assert_allclose(fits.covariance[k], alone.covariance, rtol=1e-6)
        np.testing.assert_allclose(fits.residuals[k], alone.residuals, atol=1e-11)
        np.testing.assert_allclose(fits.standard_errors[k], alone.standard_errors, rtol=1e-6)
        np.testing.assert_allclose(fits.correlation[k], alone.correlation, rtol=1e-6)
        np.testing.assert_array_equal(fits.unidentified[k], alone.unidentified)
        assert fits.steps[k] == alone.steps
        assert fits.parameters["center_x"][k] == fits.lens.center[k, 0] == fits.values[k, 2]


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "scale", "tolerance"), [("linear", None, 1e-9), ("cauchy", 2 * NOISE, 1e-5)])
def test_derivatives(x64, loss, scale, tolerance):
    """By all that a fit depends on: forward, reverse, and differences of fourth order."""
    ideal, observed = _noisy()
    frame = jl.Frame(*map(np.array, FRAME))
    inputs = {
        "ideal": ideal,
        "observed": np.asarray(frame.denormalize(observed)),
        "frame": frame,
        "weights": np.random.default_rng(6).uniform(0.5, 2, COUNT),
        "center": np.array(CENTER),
    }
    pixels = float(frame.scale[0])
    units = {"ideal": NOISE, "observed": NOISE * pixels, "frame": 0.1, "weights": 0.01, "center": NOISE}
    loss_scale = None if scale is None else np.array(pixels * scale)

    def estimate(inputs, restarts=0):
        lens = jl.RadialPolynomial(np.zeros(2), center=inputs["center"])
        rest = {key: inputs[key] for key in inputs if key != "center"}
        for _ in range(restarts):
            lens = fit_points(lens, **rest, loss=loss, loss_scale=loss_scale).lens
        return fit_points(lens, **rest, loss=loss, loss_scale=loss_scale).values

    reverse, forward = jax.jit(lambda inputs: (jax.jacrev(estimate)(inputs), jax.jacfwd(estimate)(inputs)))(inputs)
    random = np.random.default_rng(7)
    for name, unit in units.items():
        towards = jax.tree.map(lambda leaf, unit=unit: 0.03 * unit * random.normal(size=leaf.shape), inputs[name])
        values = {}
        for step in (-2, -1, 1, 2):
            moved = jax.tree.map(lambda leaf, way, step=step: np.asarray(leaf) + step * way, inputs[name], towards)
            # Differences would see the millionth of a standard error at which the solver stops: start again from there.
            values[step] = np.asarray(estimate(inputs | {name: moved}, restarts=10))
        difference = (8 * (values[1] - values[-1]) - (values[2] - values[-2])) / 12
        expected = np.zeros(2)
        for by, back, way in zip(*map(jax.tree.leaves, (reverse[name], forward[name], towards)), strict=True):
            np.testing.assert_allclose(by, back, rtol=1e-8, atol=1e-10 * np.max(np.abs(back)))
            expected += np.tensordot(np.asarray(by), way, way.ndim)
        np.testing.assert_allclose(difference, expected, rtol=0, atol=tolerance * np.max(np.abs(expected)))


def test_the_cauchy_loss_and_points_of_weight_zero(x64):
    """NaN stays where it does not count, in the estimate, its covariance and its derivatives."""
    ideal, observed = _noisy()
    weights = np.ones(COUNT)
    weights[[0, 7, 21]] = 0
    fits = functools.partial(fit_points, _start(), weights=weights, loss="cauchy", loss_scale=np.array(2 * NOISE))
    clean = fits(ideal, observed)
    spoilt, blank = observed.copy(), ideal.copy()
    spoilt[0], spoilt[7], blank[7], blank[21] = np.nan, [np.inf, 1e30], np.nan, np.nan
    fit = fits(blank, spoilt)
    np.testing.assert_allclose(fit.values, clean.values, rtol=1e-12)
    np.testing.assert_allclose(fit.covariance, clean.covariance, rtol=1e-12)
    np.testing.assert_allclose(fit.residuals, clean.residuals, atol=1e-15)


def test_a_lens_that_folds_within_the_data(x64):
    lens = jl.RadialPolynomial(np.array([-0.9]))
    ideal = _ideal()
    with pytest.warns(FitWarning, match="folds over within the data"):
        fit = fit_points(_start(1), ideal, lens.distort(ideal))
    assert fit.folds
    np.testing.assert_allclose(fit.values, [-0.9], rtol=1e-9)
    # Without the points beyond the fold the same lens is a model of one.
    inside = np.asarray(lens.one_to_one(ideal))
    assert COUNT / 4 < inside.sum() < COUNT
    assert not fit_points(_start(1), ideal, lens.distort(ideal), weights=inside.astype(np.float32)).folds


def _circle():
    angle = np.linspace(0, 2 * np.pi, COUNT, endpoint=False)
    return 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def test_a_circle_does_not_determine_two_coefficients(x64):
    """All its points have the same radius, so only one combination of the coefficients is seen."""
    ideal, ones = _circle(), np.ones(COUNT)
    observed = 1.05 * ideal + NOISE * np.random.default_rng(8).normal(size=ideal.shape)
    with pytest.raises(FitError, match=r"do not determine kappa1, kappa2 separately .*give more varied data"):
        fit_points(_start(), ideal, observed, weights=ones)
    fit = fit_points(_start(), ideal, observed, weights=ones, throw=False)
    assert fit.status == FitStatus.RANK_DEFICIENT
    assert np.isnan(fit.covariance).all()
    assert np.isnan(fit.standard_errors).all()
    assert np.all(fit.unidentified)
    # What is undetermined is κ1 against κ2: their scaled columns are the same.
    np.testing.assert_allclose(np.abs(fit.weakest_direction), np.sqrt([0.5, 0.5]), rtol=1e-6)
    assert fit.condition_number > 1e6
    # One coefficient is determined, by the ratio of the radii.
    single = fit_points(_start(1), ideal, observed)
    assert abs(single.values[0] - 0.05 / 0.25) < 3 * single.standard_errors[0]


def test_out_of_steps(x64):
    ideal, observed = _noisy()
    with pytest.raises(FitError, match="not converged after 2 steps: raise max_steps"):
        fit_points(_start(), ideal, observed, center=True, max_steps=2)
    fit = fit_points(_start(), ideal, observed, center=True, max_steps=2, throw=False)
    assert fit.status == FitStatus.MAX_STEPS
    assert fit.rms < np.sqrt(np.mean(np.sum((observed - ideal) ** 2, axis=1)))


def test_too_few_points():
    ideal, observed = _noisy()
    with pytest.raises(ValueError, match=r"too few points: 2 equations for 4 parameters \(kappa1, kappa2, center_x"):
        fit_points(_start(), ideal[:1], observed[:1], center=True)
    with pytest.raises(ValueError, match="too few points: 2 equations for 4 parameters"):
        fit_points(_start(), ideal, observed, center=True, weights=np.eye(COUNT)[3])


@pytest.mark.parametrize(("name", "row"), [("ideal", 4), ("observed", 17)])
def test_points_that_are_not_finite_are_named(name, row):
    ideal, observed = _noisy()
    points = {"ideal": ideal, "observed": observed}
    points[name][row, 1] = np.nan
    with pytest.raises(ValueError, match=rf"{name}\[{row}\] is not finite: .*nan\]; remove it, or give it weight 0"):
        fit_points(_start(), **points)
    points[name][[row + 1, row + 2]] = np.inf
    with pytest.raises(ValueError, match=rf"{name}\[{row}\] is not finite: .* \(and 2 more\)"):
        fit_points(_start(), **points)


def _spike(value, index):
    weights = np.ones(COUNT)
    weights[index] = value
    return weights


@pytest.mark.usefixtures("_untyped")
@pytest.mark.parametrize(
    ("message", "keywords"),
    [
        ("loss must be one of linear, huber, cauchy, got 'tukey'", {"loss": "tukey"}),
        (r"both have shape \(N, 2\), got \(200, 2\) and \(199, 2\)", {"observed": np.zeros((199, 2))}),
        (r"for a batch of fits use jax\.vmap", dict.fromkeys(["ideal", "observed"], np.zeros((2, 200, 2)))),
        (r"points must have shape \(\.\.\., 2\)", {"ideal": np.zeros((200, 3))}),
        ("bounds are given for 'k1', which is not fitted; fitted are kappa1, kappa2", {"bounds": {"k1": (0.0, 1.0)}}),
        ("given for 'scale', which is not fitted", {"bounds": {"scale": (0.9, 1.1)}}),
        (r"bounds of kappa2 must be \(smallest, largest\), got \(1.0, -1.0\)", {"bounds": {"kappa2": (1.0, -1.0)}}),
        ("bounds of kappa1 must be", {"bounds": {"kappa1": (np.nan, 1.0)}}),
        (r"weights need shape \(200,\), one for each point, got \(199,\)", {"weights": np.ones(199)}),
        ("finite and not negative, got -1.0 at index 3", {"weights": _spike(-1, 3)}),
        ("finite and not negative, got nan at index 0", {"weights": _spike(np.nan, 0)}),
        ("finite and not negative, got inf at index 199", {"weights": _spike(np.inf, 199)}),
        ("too few points: 0 equations", {"weights": np.zeros(200)}),
        ("`free` must have the structure of what is fitted", {"free": True}),
        ("`free` needs a boolean", {"free": _start()}),
        ("nothing to fit", {"free": _none_of(_start())}),
        ("center=True needs a lens with a centre", {"lens": jl.BrownConrady(np.zeros(4)), "center": True}),
    ],
)
def test_arguments_that_no_fit_could_use(message, keywords):
    ideal, observed = _noisy()
    with pytest.raises(ValueError, match=message):
        fit_points(**{"lens": _start(), "ideal": ideal, "observed": observed, **keywords})
