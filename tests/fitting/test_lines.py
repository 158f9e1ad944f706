"""Plumb lines: exact, against an orthogonal-distance fit by SciPy, against their own noise; gradients, failures."""

import functools

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import jaxlens as jl
from jaxlens.fitting import FitError, FitStatus, FitWarning, fit_lines

HEIGHT, WIDTH = 600, 800
NAMES = ("kappa1", "kappa2", "center_x", "center_y")
TRUTH = np.array([-0.2, 0.05, 0.02, -0.01])
NOISE = 0.3
# One shape, dtype and choice wherever it can be: a compilation takes many seconds here.
LINES, POINTS = 16, 25


@pytest.fixture
def _untyped():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def _frame():
    scale = np.hypot(HEIGHT, WIDTH) / 2
    return jl.Frame(np.array([WIDTH / 2, HEIGHT / 2]), np.array([scale, scale]))


def _straight(offset=250.0):
    """Lines all over the picture, in pixels; through its middle where the offset is zero."""
    random = np.random.default_rng(1)
    angle, distance = random.uniform(0, np.pi, (LINES, 1)), offset * random.uniform(-1, 1, (LINES, 1))
    along = np.linspace(-300, 300, POINTS)
    x = along * np.cos(angle) - distance * np.sin(angle)
    y = along * np.sin(angle) + distance * np.cos(angle)
    return np.stack([WIDTH / 2 + x, HEIGHT / 2 + y], axis=-1)


def _seen(lens):
    return np.asarray(_frame().denormalize(lens.distort(_frame().normalize(_straight()))))


def _clean():
    return _seen(jl.RadialPolynomial(TRUTH[:2], center=TRUTH[2:]))


def _fit(lines, **keywords):
    if hasattr(lines, "ndim"):
        keywords = {"weights": np.ones((LINES, POINTS))} | keywords
    return fit_lines(jl.RadialPolynomial(np.zeros(2)), lines, center=True, **({"frame": _frame()} | keywords))


@functools.cache
def _four():
    """Fits of the division model to four pictures at once."""

    def fit(lines, weights):
        return fit_lines(jl.Division(np.zeros(())), lines, frame=_frame(), weights=weights, center=True)

    return jax.jit(jax.vmap(fit))


def test_exact_lines_give_the_lens_back(x64):
    """In pixels, and normalized already: the same lens, and residuals in the units of the points."""
    clean = _clean()
    fit = _fit(clean)
    assert fit.names == NAMES
    np.testing.assert_allclose(fit.values, TRUTH, rtol=1e-9)
    np.testing.assert_array_equal(fit.lens.coefficients, fit.values[:2])
    np.testing.assert_array_equal(fit.lens.center, fit.values[2:])
    assert fit.status == FitStatus.CONVERGED
    assert fit.rms < 1e-9
    assert fit.residuals.shape == (LINES, POINTS, 1)
    # Two parameters a line are counted, though they are eliminated.
    assert fit.degrees_of_freedom == LINES * POINTS - 2 * LINES - 4
    noisy = clean + NOISE * np.random.default_rng(2).normal(size=clean.shape)
    fit, frame = _fit(noisy), _frame()
    normalized = _fit(np.asarray(frame.normalize(noisy)), frame=jl.Frame(np.zeros(2), np.ones(2)))
    np.testing.assert_allclose(normalized.values, fit.values, rtol=1e-7)
    np.testing.assert_allclose(normalized.covariance, fit.covariance, rtol=1e-6)
    pixels = frame.scale[0] * np.asarray(normalized.residuals)
    np.testing.assert_allclose(np.abs(pixels), np.abs(fit.residuals), atol=1e-7)


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_noise(x64):
    """And straight lines are not bought by shrinking the picture: the residuals stay as long as the noise."""
    clean, random = _clean(), np.random.default_rng(3)
    fits = [_fit(clean + NOISE * random.normal(size=clean.shape)) for _ in range(60)]
    errors = np.array([fit.values for fit in fits]) - TRUTH
    predicted = np.mean([fit.standard_errors for fit in fits], axis=0)
    np.testing.assert_allclose(errors.std(0) / predicted, 1, atol=0.25)
    total = sum(error @ np.linalg.solve(fit.covariance, error) for error, fit in zip(errors, fits, strict=True))
    low, high = scipy.stats.chi2(60 * 4).interval(0.99)
    assert low < total < high
    noise = [np.sqrt(np.sum(np.square(fit.residuals)) / fit.degrees_of_freedom) for fit in fits]
    assert np.mean(noise) == pytest.approx(NOISE, rel=3 / np.sqrt(2 * 60 * (LINES * POINTS - 2 * LINES - 4)))


def test_agrees_with_orthogonal_distances_by_scipy(x64):
    """The whole problem, nothing eliminated: a lens, lines, and where on its line each point is."""
    observed = _clean() + NOISE * np.random.default_rng(4).normal(size=(LINES, POINTS, 2))
    fit = _fit(observed)
    scale = float(_frame().scale[0])
    goal = (observed - np.array([WIDTH / 2, HEIGHT / 2])) / scale

    def unpack(parameters):
        angle, distance = parameters[4 : 4 + 2 * LINES].reshape(2, LINES, 1)
        along = parameters[4 + 2 * LINES :].reshape(LINES, POINTS)
        return parameters[:4], angle, distance, along

    def predicted(parameters):
        (kappa1, kappa2, *center), angle, distance, along = unpack(parameters)
        x = along * np.cos(angle) - distance * np.sin(angle) - center[0]
        y = along * np.sin(angle) + distance * np.cos(angle) - center[1]
        squared = x * x + y * y
        factor = 1 + kappa1 * squared + kappa2 * squared**2
        return np.stack([center[0] + x * factor, center[1] + y * factor], axis=-1)

    def jacobian(parameters):
        """The lens and its lines by complex steps, a point's place by one for all points: it moves only itself."""
        step, size = 1e-30, len(parameters)
        columns = np.zeros((goal.size, size))
        for k in range(4 + 2 * LINES):
            moved = parameters.astype(complex)
            moved[k] += 1j * step
            columns[:, k] = predicted(moved).imag.ravel() / step
        moved = parameters.astype(complex)
        moved[4 + 2 * LINES :] += 1j * step
        each = predicted(moved).imag.reshape(-1, 2) / step
        for k in range(LINES * POINTS):
            columns[2 * k : 2 * k + 2, 4 + 2 * LINES + k] = each[k]
        return columns

    straight = (_straight() - np.array([WIDTH / 2, HEIGHT / 2])) / scale
    direction = straight[:, -1] - straight[:, 0]
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    distance = straight[:, 0, 1] * np.cos(angle) - straight[:, 0, 0] * np.sin(angle)
    along = straight[..., 0] * np.cos(angle)[:, None] + straight[..., 1] * np.sin(angle)[:, None]
    start = np.concatenate([TRUTH, angle, distance, along.ravel()])
    theirs = scipy.optimize.least_squares(
        lambda parameters: (predicted(parameters) - goal).ravel(), start, jac=jacobian, method="lm", xtol=1e-12
    )
    errors = np.asarray(fit.standard_errors)
    # Distances from the curve are of first order in the noise, which is a thousandth of the picture.
    np.testing.assert_allclose(np.asarray(fit.values) / errors, theirs.x[:4] / errors, atol=0.02, rtol=0)
    freedom = goal.size - len(start)
    assert fit.degrees_of_freedom == freedom
    covariance = 2 * theirs.cost / freedom * np.linalg.inv(theirs.jac.T @ theirs.jac)[:4, :4]
    np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance)), rtol=0.01)
    lengths = scale * np.linalg.norm(theirs.fun.reshape(LINES, POINTS, 2), axis=-1)
    np.testing.assert_allclose(np.abs(fit.residuals[..., 0]), lengths, atol=0.01 * NOISE)


def test_a_ragged_list_is_a_padded_array(x64):
    noisy = _clean() + NOISE * np.random.default_rng(5).normal(size=(LINES, POINTS, 2))
    counts = np.random.default_rng(6).integers(3, POINTS, LINES)
    counts[4] = POINTS
    used = np.arange(POINTS) < counts[:, None]
    listed = _fit([line[:count] for line, count in zip(noisy, counts, strict=True)])
    padded = _fit(np.where(used[..., None], noisy, np.nan))
    weighted = _fit(noisy, weights=used.astype(float))
    for fit in (padded, weighted):
        np.testing.assert_allclose(fit.values, listed.values, rtol=1e-10)
        np.testing.assert_allclose(fit.covariance, listed.covariance, rtol=1e-9)
        np.testing.assert_allclose(fit.residuals, listed.residuals, atol=1e-10)
    assert np.all(np.asarray(listed.residuals)[~used] == 0)
    assert listed.degrees_of_freedom == counts.sum() - 2 * LINES - 4


@pytest.mark.filterwarnings("ignore::jaxlens.fitting.FitWarning")
def test_lines_through_the_center_say_nothing(x64):
    """They stay straight under every radial lens; what lens the fit ends with, folding or not, means nothing."""
    lines = _straight(offset=0.0)
    with pytest.raises(FitError, match=r"do not determine .*give more varied data"):
        _fit(lines)
    fit = _fit(lines, throw=False)
    assert fit.status == FitStatus.RANK_DEFICIENT
    assert np.isnan(fit.covariance).all()


@pytest.mark.slow
def test_a_batch_of_the_division_model(x64):
    """Exact for four lenses at once, with points that are missing."""
    truth = np.array([[0.25, 0.02, -0.01], [0.1, 0.0, 0.03], [-0.1, 0.01, 0.01], [0.2, 0.0, 0.0]])
    lines = np.stack([_seen(jl.Division(np.array(k), center=np.array(center))) for k, *center in truth])
    weights = np.ones((4, LINES, POINTS))
    weights[:, 3, 5:9] = 0
    lines[:2, 3, 5:9] = np.nan
    fits = _four()(lines, weights)
    assert fits.names == ("k", "center_x", "center_y")
    assert fits.status.tolist() == [FitStatus.CONVERGED] * 4
    np.testing.assert_allclose(fits.values, truth, rtol=1e-9, atol=1e-12)
    assert np.all(fits.rms < 1e-9)
    assert fits.degrees_of_freedom.tolist() == [LINES * POINTS - 4 - 2 * LINES - 3] * 4


@pytest.mark.slow
def test_gradients_by_the_points(x64):
    """Finite where a point is missing, too."""
    clean, random = _seen(jl.Division(np.array(0.25), center=TRUTH[2:])), np.random.default_rng(7)
    lines = clean + NOISE * random.normal(size=clean.shape)
    weights = np.ones((LINES, POINTS))
    weights[3, 5:9] = 0
    mixture = np.array([1.0, 2.0, -3.0])

    @jax.jit
    def gradient(lines):
        def mixed(lines):
            fit = fit_lines(jl.Division(np.zeros(())), lines, frame=_frame(), weights=weights, center=True)
            return fit.values @ mixture

        return jax.grad(mixed)(lines)

    found = np.asarray(gradient(jnp.asarray(lines)))
    assert np.isfinite(found).all()
    assert np.all(found[3, 5:9] == 0)
    towards = 0.01 * random.normal(size=lines.shape)
    steps = np.array([-2.0, -1.0, 1.0, 2.0])
    moved = lines + steps[:, None, None, None] * towards
    fits = _four()(moved, np.broadcast_to(weights, (4, LINES, POINTS)))
    lower, low, high, higher = np.asarray(fits.values) @ mixture
    assert (8 * (high - low) - (higher - lower)) / 12 == pytest.approx(np.sum(found * towards), rel=1e-4)


@pytest.mark.usefixtures("_untyped")
def test_lines_that_no_fit_could_use():
    lens, frame = jl.RadialPolynomial(np.zeros(2)), _frame()
    lines = [np.asarray(line) for line in _straight()]
    fit = functools.partial(fit_lines, lens, frame=frame)
    with pytest.raises(ValueError, match="line 1 has 2 points; at least 3"):
        fit([lines[0], lines[1][:2]])
    short = np.array(lines)
    short[7, 2:] = np.nan
    with pytest.raises(ValueError, match="line 7 has 2 points"):
        fit(short)
    spoilt = [line.copy() for line in lines]
    spoilt[2][11, 0] = np.nan
    with pytest.raises(ValueError, match=r"line 2 is not finite at point 11: \[nan, .*\]; leave it out"):
        fit(spoilt)
    with pytest.raises(ValueError, match=r"line 0 must have shape \(n, 2\), got \(25, 3\)"):
        fit([np.zeros((25, 3))])
    with pytest.raises(ValueError, match=r"or an array \(L, N, 2\), got shape \(25, 2\)"):
        fit(lines[0])
    with pytest.raises(ValueError, match="no lines"):
        fit([])
    with pytest.raises(ValueError, match=r"weights belong to lines as an array"):
        fit(lines, weights=np.ones((LINES, POINTS)))
    with pytest.raises(ValueError, match=r"weights need shape \(16, 25\)"):
        fit(np.array(lines), weights=np.ones((LINES, 3)))
    with pytest.raises(ValueError, match=r"too few points on lines: 3 equations for 2 parameters .* and 2 more"):
        fit([lines[0][:3]])
    with pytest.raises(ValueError, match="loss must be one of"):
        fit(lines, loss="tukey")
    with pytest.raises(ValueError, match="bounds are given for 'k'"):
        fit(lines, bounds={"k": (0.0, 1.0)})


GRID = np.concatenate(
    [
        [np.stack([np.linspace(50, 1870, 25), np.full(25, y)], axis=-1) for y in range(100, 941, 120)],
        [np.stack([np.full(25, x), np.linspace(50, 1030, 25)], axis=-1) for x in range(100, 1641, 220)],
    ]
)


def _wide(scale=(1920**2 + 1080**2) ** 0.5 / 2):
    """The frame of the grid's picture."""
    return jl.Frame(np.array([960.0, 540.0]), np.array([scale, scale]))


@pytest.mark.parametrize(
    ("make", "truths", "center"),
    [
        (jl.RadialPolynomial, [[-0.35], [-0.3], [-0.25], [0.1], [0.5]], False),
        (jl.RadialPolynomial, [[-0.35, 0.0], [-0.25, 0.05], [0.3, 0.1]], True),
        (jl.BrownConrady, [[-0.3, 0.05, 1e-3, -1e-3], [0.3, 0.1, 0.0, 1e-3]], False),
    ],
)
@pytest.mark.slow
def test_strong_lenses_come_back_from_zero(x64, make, truths, center):
    """Where the nearest minimum, with an RMS of pixels, is a lens that folds within the lines."""
    frame = _wide(1300.0) if make is jl.BrownConrady else _wide()
    for truth in truths:
        lens = make(truth)
        seen = list(np.asarray(frame.denormalize(lens.distort(frame.normalize(GRID)))))
        fit = fit_lines(make(np.zeros(len(truth))), seen, frame=frame, center=center)
        np.testing.assert_allclose(fit.values, [*truth, 0, 0] if center else truth, rtol=0, atol=1e-9)
        assert float(fit.rms) < 1e-9
        assert not bool(fit.folds)


def test_residuals_of_a_wrong_model_are_told(x64):
    """One term where two bent the lines: neighbours err alike. Noise alone is not told so."""
    lens, frame = jl.RadialPolynomial([-0.3, 0.3]), _wide()
    lines = np.asarray(frame.denormalize(lens.distort(frame.normalize(GRID))))
    noisy = list(lines + np.random.default_rng(0).normal(scale=0.3, size=lines.shape))
    with pytest.warns(FitWarning, match="neighbour"):
        short = fit_lines(jl.RadialPolynomial([0.0]), noisy, frame=frame)
    assert float(short.noise_correlation) > 0.5
    fit = fit_lines(jl.RadialPolynomial([0.0, 0.0]), noisy, frame=frame, center=True)
    assert float(fit.noise_correlation) == 0
    assert float(fit.rms) < float(short.rms)
    assert bool(jnp.all(jnp.abs(fit.values - jnp.asarray([-0.3, 0.3, 0, 0])) < 4 * fit.standard_errors))
