"""Fits to correspondences: exact, against regression and SciPy, against their own noise; gradients, failures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import jaxlens as jl
from jaxlens.fitting import FitError, FitStatus, FitWarning, fit_points

FRAME = ([319.5, 239.5], [400.0, 410.0])
CENTER = [0.02, -0.01]
# What is fitted with `center=True`, here and everywhere below: kappa1, kappa2, center_x, center_y.
TRUTH = np.array([-0.2, 0.05, *CENTER])
NAMES = ("kappa1", "kappa2", "center_x", "center_y")
NOISE = 1e-3


def _start(order=2):
    return jl.RadialPolynomial(np.zeros(order))


def _ideal(count, seed=0):
    return np.random.default_rng(seed).uniform(-0.7, 0.7, (count, 2))


def _model(parameters, ideal):
    """The lens of order two and its centre, written once more in NumPy."""
    *kappas, x, y = parameters
    offset = ideal - np.array([x, y])
    squared = np.sum(offset**2, axis=-1, keepdims=True)
    return np.array([x, y]) + offset * (1 + sum(k * squared ** (i + 1) for i, k in enumerate(kappas)))


def _noisy(count, seed=0):
    random = np.random.default_rng(1000 + seed)
    ideal = _ideal(count, seed)
    return ideal, _model(TRUTH, ideal) + NOISE * random.normal(size=(count, 2))


LENSES = {
    "radial, 1": jl.RadialPolynomial(np.array([-0.2])),
    "radial, 2": jl.RadialPolynomial(np.array([-0.2, 0.05])),
    "radial, 3": jl.RadialPolynomial(np.array([0.3, -0.2, 0.1])),
    "division": jl.Division(np.array(0.25)),
    "brown, 4": jl.BrownConrady(np.array([-0.28, 0.07, 1e-3, -2e-3])),
    "brown, 5": jl.BrownConrady(np.array([-0.28, 0.07, 1e-3, -2e-3, 0.02])),
}


@pytest.mark.parametrize("framed", [False, True], ids=["normalized", "pixels"])
@pytest.mark.parametrize("model", LENSES)
def test_exact_data_give_the_lens_back(x64, model, framed):
    """In pixels everything is unknown at once: coefficients, centre and scale."""
    lens = jax.tree.map(jnp.asarray, LENSES[model])
    start = jax.tree.map(jnp.zeros_like, lens)
    has_center = hasattr(lens, "center")
    if has_center and framed:
        lens = type(lens)(*jax.tree.leaves(lens)[1:], center=np.array(CENTER))
    ideal = _ideal(100)
    if framed:
        frame = jl.Frame(*map(np.array, FRAME))
        observed = frame.zoomed(1.07).denormalize(lens.distort(ideal))
        fit = fit_points(start, ideal, observed, frame=frame, center=has_center, scale=True)
        np.testing.assert_allclose(fit.frame.scale, 1.07 * np.array(FRAME[1]), rtol=1e-9)
        np.testing.assert_array_equal(fit.frame.center, FRAME[0])
    else:
        fit = fit_points(start, ideal, lens.distort(ideal))
    for found, expected in zip(jax.tree.leaves(fit.lens), jax.tree.leaves(lens), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    coefficients = {
        "radial": ["kappa1", "kappa2", "kappa3"],
        "division": ["k"],
        "brown,": ["k1", "k2", "p1", "p2", "k3"],
    }[model.split(" ")[0].replace("radial,", "radial")][: jax.tree.leaves(lens)[-1].size]
    further = (["center_x", "center_y"] if has_center else []) + ["scale"]
    assert fit.names == tuple(coefficients + (further if framed else []))
    assert fit.status == FitStatus.CONVERGED
    assert fit.residuals.shape == (100, 2)
    assert fit.degrees_of_freedom == 200 - len(fit.names)
    assert not fit.folds
    assert fit.rms < (1e-9 if framed else 1e-12)


def test_without_a_centre_it_is_linear_regression(x64):
    """Closed form: the observed point is linear in the coefficients."""
    ideal, observed = _noisy(60)
    squared = np.sum(ideal**2, axis=1, keepdims=True)
    design = np.stack([(ideal * squared ** (i + 1)).ravel() for i in range(2)], axis=1)
    goal = (observed - ideal).ravel()
    expected, sum_of_squares = np.linalg.lstsq(design, goal)[:2]
    variance = sum_of_squares[0] / (120 - 2)
    fit = fit_points(_start(), ideal, observed)
    np.testing.assert_allclose(fit.values, expected, rtol=1e-10)
    np.testing.assert_allclose(fit.covariance, variance * np.linalg.inv(design.T @ design), rtol=1e-10)
    np.testing.assert_allclose(fit.residuals.ravel(), goal - design @ expected, atol=1e-12)
    # `rms` is of lengths in the plane; there are 60 of them.
    assert fit.rms == pytest.approx(np.sqrt(sum_of_squares[0] / 60), rel=1e-10)
    unit = design / np.linalg.norm(design, axis=0)
    assert fit.condition_number == pytest.approx(np.linalg.cond(unit), rel=1e-8)
    np.testing.assert_allclose(fit.inflation, np.diag(np.linalg.inv(unit.T @ unit)), rtol=1e-8)
    weakest = np.linalg.svd(unit)[2][-1]
    assert abs(weakest @ np.asarray(fit.weakest_direction)) == pytest.approx(1, rel=1e-10)


def test_as_many_equations_as_parameters(x64):
    """An exact fit says nothing about the noise."""
    lens = jl.BrownConrady(np.array([-0.28, 0.07, 1e-3, -2e-3]))
    ideal = np.array([[0.5, 0.2], [-0.1, 0.6]])
    fit = fit_points(jl.BrownConrady(np.zeros(4)), ideal, lens.distort(ideal))
    np.testing.assert_allclose(fit.values, lens.coefficients, rtol=1e-9)
    assert fit.degrees_of_freedom == 0
    assert fit.status == FitStatus.CONVERGED
    assert np.isnan(fit.covariance).all()


@pytest.fixture(scope="module")
def study():
    """300 fits to as many noisy pictures of the same points, by loss; one compilation each."""
    with jax.enable_x64(True):
        ideal = _ideal(200)
        random = np.random.default_rng(5)
        clean = _model(TRUTH, ideal) + NOISE * random.normal(size=(300, 200, 2))
        wrong = random.random((300, 200)) < 0.2
        spoilt = np.where(wrong[..., None], random.uniform(-0.7, 0.7, clean.shape), clean)

        def fits(loss):
            return jax.jit(jax.vmap(lambda observed: fit_points(_start(), ideal, observed, center=True, loss=loss)))

        compiled = {loss: fits(loss) for loss in ("linear", "huber", "cauchy")}
        yield clean, spoilt, compiled


@pytest.mark.parametrize("loss", ["linear", "huber", "cauchy"])
def test_standard_errors_are_those_of_repeated_noise(x64, study, loss):
    clean, _, fits = study
    found = fits[loss](clean)
    assert found.names == NAMES
    assert not np.any(found.status)
    errors = np.asarray(found.values) - TRUTH
    np.testing.assert_allclose(np.mean(np.square(errors), 0) ** 0.5 / np.mean(found.standard_errors, 0), 1, atol=0.1)
    # Correlations included: normalized errors are χ² with four degrees of freedom in each of the 300.
    total = np.sum(errors * np.linalg.solve(np.asarray(found.covariance), errors[..., None])[..., 0])
    low, high = scipy.stats.chi2(300 * 4).interval(0.99)
    assert low < total < high
    # And unbiased, up to the standard error of a mean.
    assert np.all(np.abs(errors.mean(0)) < 3 * errors.std(0) / np.sqrt(300))
    if loss != "linear":
        # The tuning constants' promise: 95 % efficiency, and a bend at that multiple of the noise.
        plain = np.asarray(fits["linear"](clean).values) - TRUTH
        np.testing.assert_allclose(plain.var(0) / errors.var(0), 0.95, atol=0.05)
        bend = {"huber": 1.345, "cauchy": 2.3849}[loss] * NOISE
        assert np.mean(found.loss_scale) == pytest.approx(bend, rel=0.02)


def test_a_fifth_of_gross_outliers(x64, study):
    """Anywhere in the picture: plain least squares is far off, the Cauchy loss stays within its standard errors."""
    _, spoilt, fits = study
    found = fits["cauchy"](spoilt)
    assert not np.any(found.status)
    errors = np.asarray(found.values) - TRUTH
    assert np.max(np.abs(errors) / np.asarray(found.standard_errors)) < 4
    plain = np.asarray(fits["linear"](spoilt).values) - TRUTH
    assert np.all(np.sqrt(np.mean(plain**2, 0)) > 50 * np.sqrt(np.mean(errors**2, 0)))
    # The scale does not grow with the outliers either: the median moves by the share that is wrong, not by its size.
    assert np.max(found.loss_scale) < 2 * 2.3849 * NOISE


def test_agrees_with_scipy(x64):
    ideal, observed = _noisy(80, seed=1)
    weights = np.random.default_rng(2).uniform(0.3, 3, 80)

    def residuals(parameters):
        return (np.sqrt(weights)[:, None] * (observed - _model(parameters, ideal))).ravel()

    theirs = scipy.optimize.least_squares(residuals, np.zeros(4), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = fit_points(_start(), ideal, observed, weights=weights, center=True)
    errors = np.asarray(fit.standard_errors)
    np.testing.assert_allclose(np.asarray(fit.values) / errors, theirs.x / errors, atol=1e-5)
    covariance = 2 * theirs.cost / (160 - 4) * np.linalg.inv(theirs.jac.T @ theirs.jac)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-5)
    assert fit.rms == pytest.approx(np.sqrt(2 * theirs.cost / weights.sum()), rel=1e-10)
    np.testing.assert_allclose(fit.residuals, observed - _model(theirs.x, ideal), atol=1e-8)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_agrees_with_scipy(x64, loss):
    """SciPy's losses act on numbers; on the residuals' lengths they are the same loss."""
    ideal, observed = _noisy(80, seed=1)
    observed[::7] += 0.02

    def lengths(parameters):
        return np.linalg.norm(observed - _model(parameters, ideal), axis=1)

    scale = 2 * NOISE
    fit = fit_points(_start(), ideal, observed, center=True, loss=loss, loss_scale=scale)
    theirs = scipy.optimize.least_squares(
        lengths,
        np.asarray(fit.values) + 1e-3,
        loss=loss,
        f_scale=scale,
        jac="3-point",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert fit.loss_scale == scale
    errors = np.asarray(fit.standard_errors)
    np.testing.assert_allclose(np.asarray(fit.values) / errors, theirs.x / errors, atol=1e-3)
    linear = fit_points(_start(), ideal, observed, center=True)
    assert np.max(np.abs(np.asarray(linear.values) - theirs.x) / errors) > 1


def test_weights_repeat_points(x64):
    ideal, observed = _noisy(40)
    times = np.random.default_rng(3).integers(1, 4, 40)
    weighted = fit_points(_start(), ideal, observed, weights=times, center=True)
    repeated = fit_points(_start(), np.repeat(ideal, times, 0), np.repeat(observed, times, 0), center=True)
    np.testing.assert_allclose(weighted.values, repeated.values, rtol=1e-10)
    # Weights are relative: each point is counted once for the noise.
    ratio = (2 * times.sum() - 4) / (80 - 4)
    np.testing.assert_allclose(weighted.covariance, ratio * np.asarray(repeated.covariance), rtol=1e-8)
    rescaled = fit_points(_start(), ideal, observed, weights=1e4 * times, center=True)
    np.testing.assert_allclose(rescaled.values, weighted.values, rtol=1e-10)
    np.testing.assert_allclose(rescaled.covariance, weighted.covariance, rtol=1e-8)
    np.testing.assert_allclose(rescaled.rms, weighted.rms, rtol=1e-10)
    np.testing.assert_allclose(rescaled.residuals, weighted.residuals, atol=1e-13)


@pytest.mark.parametrize("loss", ["linear", "cauchy"])
def test_weight_zero_leaves_a_point_out(x64, loss):
    ideal, observed = _noisy(40)
    weights = np.ones(40)
    weights[[0, 7, 21]] = 0
    alone = fit_points(_start(), ideal[weights > 0], observed[weights > 0], center=True, loss=loss)
    spoilt, blank = observed.copy(), ideal.copy()
    spoilt[0], spoilt[7], blank[7], blank[21] = np.nan, [np.inf, 1e30], np.nan, np.nan
    for pair in ((ideal, observed), (blank, spoilt)):
        fit = fit_points(_start(), *pair, weights=weights, center=True, loss=loss)
        np.testing.assert_allclose(fit.values, alone.values, rtol=1e-10)
        np.testing.assert_allclose(fit.covariance, alone.covariance, rtol=1e-8)
        np.testing.assert_allclose(fit.residuals[weights > 0], alone.residuals, atol=1e-13)
        assert np.all(np.asarray(fit.residuals)[weights == 0] == 0)
        assert fit.degrees_of_freedom == alone.degrees_of_freedom == 74 - 4
        assert not fit.folds


def test_bounds(x64):
    ideal, observed = _noisy(40)
    unbounded = fit_points(_start(), ideal, observed, center=True)
    wide = fit_points(_start(), ideal, observed, center=True, bounds={"kappa1": (-1.0, 1.0), "center_x": (-1.0, 1.0)})
    np.testing.assert_allclose(wide.values, unbounded.values, rtol=1e-10)
    # Where a bound is active the rest is that of a fit in which the parameter is fixed there.
    at_bound = jl.RadialPolynomial(np.array([-0.15, 0.0]))
    mask = jl.RadialPolynomial([0.0, 0.0])
    mask = jax.tree.map(lambda leaf: np.ones(leaf.shape, bool), mask)
    mask.coefficients[0] = False
    fixed = fit_points(at_bound, ideal, observed, free=mask)
    assert fixed.names == NAMES[1:]
    assert fixed.lens.coefficients[0] == -0.15
    for bounds in ((-0.15, 1.0), (-0.15, -0.15)):
        fit = fit_points(at_bound, ideal, observed, center=True, bounds={"kappa1": bounds})
        assert fit.names == NAMES
        assert fit.status == FitStatus.CONVERGED
        assert fit.values[0] == -0.15
        np.testing.assert_allclose(fit.values[1:], fixed.values, rtol=1e-8)
    # From inside the interval, too, and with several at once.
    low = fit_points(_start(), ideal, observed, center=True, bounds={"kappa1": (-0.15, np.inf)})
    np.testing.assert_allclose(low.values[1:], fixed.values, rtol=1e-8)
    both = {"kappa1": (-0.15, 0.2), "center_x": (-0.01, 0.01)}
    cornered = fit_points(_start(), ideal, observed, center=True, bounds=both)
    np.testing.assert_array_equal(cornered.values[jnp.array([0, 2])], [-0.15, 0.01])


def test_a_mask_frees_single_coefficients(x64):
    lens = jl.RadialPolynomial(np.array([-0.2, 0.05]), center=np.array(CENTER))
    ideal = _ideal(50)
    start = jl.RadialPolynomial(np.array([-0.2, 0.0]), center=np.array(CENTER))
    mask = jax.tree.map(lambda leaf: np.zeros(leaf.shape, bool), start)
    mask.coefficients[1] = True
    fit = fit_points(start, ideal, lens.distort(ideal), free=mask)
    assert fit.names == ("kappa2",)
    np.testing.assert_allclose(fit.values, [0.05], rtol=1e-9)
    np.testing.assert_array_equal(fit.lens.center, CENTER)
    assert fit.lens.coefficients[0] == -0.2
    assert fit.degrees_of_freedom == 99


def test_single_precision():
    """All in float32, and still to a small share of a standard error where double precision would be."""
    ideal, observed = _noisy(200)
    single = fit_points(_start(), ideal.astype(np.float32), observed.astype(np.float32), center=True)
    assert {leaf.dtype for leaf in jax.tree.leaves(single) if jnp.issubdtype(leaf.dtype, jnp.floating)} == {
        np.dtype("float32")
    }
    with jax.enable_x64(True):
        double = fit_points(_start(), ideal, observed, center=True)
    assert double.values.dtype == np.float64
    difference = np.asarray(single.values, float) - np.asarray(double.values)
    assert np.max(np.abs(difference) / np.asarray(double.standard_errors)) < 5e-3
    np.testing.assert_allclose(single.standard_errors, double.standard_errors, rtol=2e-3)


def test_a_batch_is_a_loop_and_a_bad_fit_stays_alone(x64):
    ideal, observed = zip(*(_noisy(40, seed) for seed in range(4)), strict=True)
    ideal, observed = np.stack(ideal), np.stack(observed)
    spoilt = observed.copy()
    spoilt[2, 5, 0] = np.nan
    fits = jax.jit(jax.vmap(lambda i, o: fit_points(_start(), i, o, center=True)))
    together, with_nan = fits(ideal, observed), fits(ideal, spoilt)
    assert together.status.tolist() == [FitStatus.CONVERGED] * 4
    bad = FitStatus.NOT_FINITE
    assert with_nan.status.tolist() == [FitStatus.CONVERGED, FitStatus.CONVERGED, bad, FitStatus.CONVERGED]
    for k in range(4):
        alone = fit_points(_start(), ideal[k], observed[k], center=True)
        for batch in (together, with_nan):
            if batch.status[k] != bad:
                np.testing.assert_allclose(batch.values[k], alone.values, rtol=1e-9)
                np.testing.assert_allclose(batch.covariance[k], alone.covariance, rtol=1e-7)
                np.testing.assert_allclose(batch.residuals[k], alone.residuals, atol=1e-12)
                assert batch.steps[k] == alone.steps
    assert np.isnan(with_nan.covariance[2]).all()
    np.testing.assert_allclose(
        together.standard_errors[1], np.sqrt(np.diag(np.asarray(together.covariance[1]))), rtol=1e-12
    )
    np.testing.assert_array_equal(together.parameters["kappa2"], together.values[:, 1])


@pytest.mark.parametrize(("loss", "loss_scale"), [("linear", None), ("cauchy", 2 * NOISE)])
def test_derivatives_by_the_data(x64, loss, loss_scale):
    ideal, observed = map(jnp.asarray, _noisy(25))

    @jax.jit
    def estimate(ideal, observed):
        return fit_points(_start(), ideal, observed, center=True, loss=loss, loss_scale=loss_scale).values

    reverse = jax.jacrev(estimate, (0, 1))(ideal, observed)
    forward = jax.jacfwd(estimate, (0, 1))(ideal, observed)
    random = np.random.default_rng(4)
    step = 1e-6
    for k in range(2):
        size = np.max(np.abs(reverse[k]))
        np.testing.assert_allclose(reverse[k], forward[k], rtol=1e-7, atol=1e-10 * size)
        for _ in range(3):
            towards = random.normal(size=(25, 2))
            shift = [jnp.zeros((25, 2)), jnp.zeros((25, 2))]
            shift[k] = jnp.asarray(step * towards)
            there = estimate(ideal + shift[0], observed + shift[1])
            back = estimate(ideal - shift[0], observed - shift[1])
            expected = np.einsum("pnc,nc->p", reverse[k], towards)
            np.testing.assert_allclose((there - back) / (2 * step), expected, rtol=1e-5)


def test_derivatives_by_weights_frame_and_fixed_parameters(x64):
    ideal, observed = map(jnp.asarray, _noisy(25))
    observed = jl.Frame(*map(np.array, FRAME)).denormalize(observed)
    start = {
        "weights": jnp.asarray(np.random.default_rng(6).uniform(0.5, 2, 25)),
        "frame": jl.Frame(*map(jnp.array, FRAME)),
        "center": jnp.array(CENTER),
    }

    @jax.jit
    def estimate(inputs):
        lens = jl.RadialPolynomial(jnp.zeros(2), center=inputs["center"])
        return fit_points(lens, ideal, observed, weights=inputs["weights"], frame=inputs["frame"]).values

    derivative = jax.jacrev(estimate)(start)
    random = np.random.default_rng(7)
    leaves, structure = jax.tree.flatten(start)
    for k, leaf in enumerate(leaves):
        towards = 1e-5 * np.asarray(leaf) * random.normal(size=leaf.shape)
        there, back = (
            estimate(jax.tree.unflatten(structure, [*leaves[:k], leaf + sign * towards, *leaves[k + 1 :]]))
            for sign in (1, -1)
        )
        expected = np.asarray(jax.tree.leaves(derivative)[k]) @ towards
        np.testing.assert_allclose((there - back) / 2, expected, rtol=1e-5)


def test_a_lens_that_folds_within_the_data(x64):
    lens = jl.RadialPolynomial(np.array([-0.9]))
    ideal = _ideal(50)
    with pytest.warns(FitWarning, match="folds over within the data"):
        fit = fit_points(_start(1), ideal, lens.distort(ideal))
    assert fit.folds
    np.testing.assert_allclose(fit.values, [-0.9], rtol=1e-9)
    # The points beyond the fold may be left out: then the lens is a lens where it is used.
    inside = np.asarray(lens.one_to_one(ideal))
    assert 10 < inside.sum() < 50
    assert not fit_points(_start(1), ideal, lens.distort(ideal), weights=inside.astype(float)).folds


def _circle(count=50, radius=0.5):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def test_a_circle_does_not_determine_two_coefficients(x64):
    """All its points have the same radius, so only one combination of the coefficients is seen."""
    ideal = _circle()
    observed = 1.05 * ideal + NOISE * np.random.default_rng(8).normal(size=ideal.shape)
    with pytest.raises(FitError, match=r"do not determine kappa1, kappa2 separately .*give more varied data"):
        fit_points(_start(), ideal, observed)
    fit = fit_points(_start(), ideal, observed, throw=False)
    assert fit.status == FitStatus.RANK_DEFICIENT
    assert np.isnan(fit.covariance).all()
    assert np.isnan(fit.standard_errors).all()
    assert np.all(fit.unidentified)
    # What is undetermined: κ1 against κ2, in scaled columns one for one.
    np.testing.assert_allclose(np.abs(fit.weakest_direction), np.sqrt([0.5, 0.5]), rtol=1e-6)
    assert fit.condition_number > 1e6
    # One coefficient is determined, by the ratio of the radii.
    single = fit_points(_start(1), ideal, observed)
    assert abs(single.values[0] - 0.05 / 0.25) < 3 * single.standard_errors[0]


def test_scale_and_coefficients_need_different_radii(x64):
    with pytest.raises(FitError, match=r"kappa1, scale separately"):
        fit_points(_start(1), _circle(), 1.05 * _circle(), scale=True)


def test_out_of_steps(x64):
    ideal, observed = _noisy(40)
    with pytest.raises(FitError, match="not converged after 2 steps: raise max_steps"):
        fit_points(_start(), ideal, observed, center=True, max_steps=2)
    assert fit_points(_start(), ideal, observed, center=True, max_steps=2, throw=False).status == FitStatus.MAX_STEPS


def test_too_few_points(x64):
    ideal, observed = _noisy(40)
    with pytest.raises(ValueError, match=r"too few points: 2 equations for 4 parameters \(kappa1, kappa2, center_x"):
        fit_points(_start(), ideal[:1], observed[:1], center=True)
    with pytest.raises(ValueError, match="too few points: 2 equations for 4 parameters"):
        fit_points(_start(), ideal, observed, center=True, weights=np.eye(40)[3])
    # Under a transformation there is only the status to tell.
    status = jax.jit(lambda weights: fit_points(_start(), ideal, observed, center=True, weights=weights).status)
    assert status(np.eye(40)[3]) == FitStatus.TOO_FEW
    assert status(np.zeros(40)) == FitStatus.TOO_FEW
    assert status(np.ones(40)) == FitStatus.CONVERGED


def test_points_that_are_not_finite_are_named():
    ideal, observed = _noisy(20)
    for name, row in (("ideal", 4), ("observed", 17)):
        pair = {"ideal": ideal.copy(), "observed": observed.copy()}
        pair[name][row, 1] = np.nan
        with pytest.raises(ValueError, match=rf"{name}\[{row}\] is not finite: .*nan\]; remove it"):
            fit_points(_start(), **pair)
        pair[name][[row + 1, row + 2]] = np.inf
        with pytest.raises(ValueError, match=rf"{name}\[{row}\] is not finite: .* \(and 2 more\)"):
            fit_points(_start(), **pair)


def _keywords(**keywords):
    return pytest.param(keywords.pop("message"), keywords, id=next(iter(keywords)) + str(len(str(keywords))))


@pytest.mark.parametrize(
    ("message", "keywords"),
    [
        ("loss must be one of linear, huber, cauchy, got 'tukey'", {"loss": "tukey"}),
        (r"must both have shape \(N, 2\), got \(20, 2\) and \(19, 2\)", {"observed": np.zeros((19, 2))}),
        (r"for a batch of fits use jax\.vmap", {"ideal": np.zeros((2, 20, 2)), "observed": np.zeros((2, 20, 2))}),
        (r"points must have shape \(\.\.\., 2\)", {"ideal": np.zeros((20, 3))}),
        ("bounds are given for 'k1', which is not fitted; fitted are kappa1, kappa2", {"bounds": {"k1": (0.0, 1.0)}}),
        ("given for 'scale', which is not fitted", {"bounds": {"scale": (0.9, 1.1)}}),
        (r"bounds of kappa2 must be \(smallest, largest\), got \(1.0, -1.0\)", {"bounds": {"kappa2": (1.0, -1.0)}}),
        ("bounds of kappa1 must be", {"bounds": {"kappa1": (np.nan, 1.0)}}),
        (r"weights need shape \(20,\), one for each point, got \(19,\)", {"weights": np.ones(19)}),
        ("finite and not negative, got -1.0 at index 3", {"weights": 1 - 2 * np.eye(20)[3]}),
        ("finite and not negative, got nan at index 0", {"weights": np.r_[np.nan, np.ones(19)]}),
        ("finite and not negative, got inf at index 19", {"weights": np.r_[np.ones(19), np.inf]}),
        ("too few points: 0 equations", {"weights": np.zeros(20)}),
        ("`free` must have the structure of what is fitted", {"free": True}),
        ("`free` needs a boolean", {"free": jl.RadialPolynomial(np.ones(2))}),
        ("nothing to fit", {"free": jax.tree.map(lambda _: False, jl.RadialPolynomial(np.ones(2)))}),
        ("center=True needs a lens with a centre", {"lens": jl.BrownConrady(np.zeros(4)), "center": True}),
    ],
)
def test_arguments_that_no_fit_could_use(message, keywords):
    ideal, observed = _noisy(20)
    with pytest.raises(ValueError, match=message):
        fit_points(**{"lens": _start(), "ideal": ideal, "observed": observed, **keywords})
