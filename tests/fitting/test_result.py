"""What a fit returns: names, errors, correlations, the table, its warnings, and what each status means."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.fitting import Fit, FitError, FitStatus, FitWarning, fit_points
from jaxlens.fitting._result import checked, explain

NAMES = ("kappa1", "kappa2", "center_x")


def _fit(**changes):
    """A fit of known numbers, made by hand: what is reported does not depend on how it was found."""
    errors = np.array([2e-3, 4e-3, 1e-3])
    # Two columns of J at an angle such that the condition number is 7.04, and a third at right angles to both.
    cosine = (7.04**2 - 1) / (7.04**2 + 1)
    information = np.array([[1.0, cosine, 0.0], [cosine, 1.0, 0.0], [0.0, 0.0, 1.0]])
    correlation = np.array([[1.0, -0.96, 0.1], [-0.96, 1.0, 0.0], [0.1, 0.0, 1.0]])
    known = {
        "lens": jl.RadialPolynomial(jnp.array([-0.2, 0.05]), center=jnp.array([0.02, 0.0])),
        "frame": jl.Frame(jnp.array([319.5, 239.5]), jnp.array([400.0, 410.0])),
        "poses": None,
        "names": NAMES,
        "values": jnp.array([-0.2, 0.05, 0.02]),
        "covariance": jnp.asarray(errors[:, None] * errors * correlation),
        "information": jnp.asarray(information),
        "inflation": jnp.array([12.9, 12.8, 1.0]),
        "residuals": jnp.zeros((40, 2)),
        "rms": jnp.asarray(1.25e-3),
        "per_view_rms": None,
        "degrees_of_freedom": jnp.asarray(77),
        "loss_scale": jnp.asarray(jnp.inf),
        "status_code": jnp.asarray(int(FitStatus.CONVERGED)),
        "steps": jnp.asarray(5),
        "folds": jnp.asarray(False),
    }
    return Fit(**(known | changes))


def test_status_values():
    """They are stored, and compared, as numbers."""
    assert [(status.name, status.value) for status in FitStatus] == [
        ("CONVERGED", 0),
        ("MAX_STEPS", 1),
        ("DIVERGED", 2),
        ("RANK_DEFICIENT", 3),
        ("TOO_FEW", 4),
        ("NOT_FINITE", 5),
        ("UNEXPLAINED", 6),
    ]


def test_a_status_is_printed_by_its_name():
    assert str(FitStatus.MAX_STEPS) == f"{FitStatus.MAX_STEPS}" == "MAX_STEPS"
    assert f"{jl.InverseStatus.NO_PREIMAGE:>12}" == " NO_PREIMAGE"
    fit = _fit(status_code=jnp.asarray(3))
    assert fit.status is FitStatus.RANK_DEFICIENT
    assert "status_code=<FitStatus.RANK_DEFICIENT: 3>" in str(fit)


def test_a_status_is_a_number_where_it_is_not_known_or_of_many():
    fit = _fit(status_code=jnp.asarray(3))
    assert int(jax.jit(lambda fit: fit.status + 1)(fit)) == 4
    fits = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), fit)
    assert fits.status.tolist() == jax.vmap(lambda fit: fit.status)(fits).tolist() == [3, 3]
    assert "status_code=weak_i32[2]" in repr(fits)
    assert "status_code=ShapeDtypeStruct" in repr(jax.eval_shape(lambda: fit))
    assert jax.device_get(fit).status is FitStatus.RANK_DEFICIENT


def test_parameters_errors_and_correlations(x64):
    fit = _fit()
    assert list(fit.parameters) == list(NAMES)
    assert [float(value) for value in fit.parameters.values()] == [-0.2, 0.05, 0.02]
    np.testing.assert_allclose(fit.standard_errors, [2e-3, 4e-3, 1e-3], rtol=1e-14)
    np.testing.assert_allclose(np.diag(fit.correlation), 1, rtol=1e-14)
    np.testing.assert_allclose(fit.correlation[0], [1, -0.96, 0.1], rtol=1e-14)
    assert not np.any(fit.unidentified)
    np.testing.assert_array_equal(fit.camera_matrix, [[400, 0, 319.5], [0, 410, 239.5], [0, 0, 1]])
    with pytest.raises(ValueError, match="no frame, and so no camera matrix"):
        _ = _fit(frame=None).camera_matrix


def test_summary(x64):
    lines = _fit().summary().splitlines()
    assert lines[0] == "RadialPolynomial: converged after 5 steps"
    assert lines[1] == "root mean square residual 0.00125, 77 degrees of freedom, condition number 7.04"
    rows = {line.split()[0]: line.split() for line in lines if line}
    # Two digits of the standard error, and as many decimals of the estimate; 1.96 of them either way.
    assert rows["kappa1"] == ["kappa1", "-0.2000", "0.0020", "-0.2039", "…", "-0.1961", "12.9"]
    assert rows["kappa2"] == ["kappa2", "0.0500", "0.0040", "0.0422", "…", "0.0578", "12.8"]
    assert rows["center_x"] == ["center_x", "0.0200", "0.0010", "0.0180", "…", "0.0220", "1"]
    assert lines[-1] == "strong correlations: kappa2–kappa1 -0.960"
    text = _fit(loss_scale=jnp.asarray(2.5e-3)).summary()
    assert "robust loss, bending at residuals of 0.0025" in text
    text = _fit(per_view_rms=jnp.array([0.3, 0.1, 0.2])).summary()
    assert "3 views, root mean square residuals from 0.1 to 0.3" in text


def test_summary_of_what_is_not_known(x64):
    fit = _fit(covariance=jnp.full((3, 3), jnp.nan), inflation=jnp.full(3, jnp.inf), status_code=jnp.asarray(3))
    text = fit.summary()
    for name in NAMES:
        row = next(line for line in text.splitlines() if line.startswith(name))
        assert row.split()[2:] == ["unknown", "unknown", "inf"]
    assert "the data do not determine kappa1, kappa2 separately" in text
    assert "strong correlations" not in text
    assert np.all(fit.unidentified)


def test_warnings(x64):
    weak = _fit(inflation=jnp.array([2e6, 2e6, 1.0]))
    assert weak.unidentified.tolist() == [True, True, False]
    with pytest.warns(FitWarning, match="kappa1, kappa2 are not identified"):
        assert checked(weak, True) is weak
    assert "warning: kappa1, kappa2 are not identified" in weak.summary()
    one = _fit(inflation=jnp.array([1.0, jnp.nan, 1.0]))
    assert "warning: kappa2 is not identified" in one.summary()
    folding = _fit(folds=jnp.asarray(True))
    with pytest.warns(FitWarning, match="folds over within the data or the picture"):
        checked(folding, True)
    assert "warning: the fitted lens folds over" in folding.summary()
    assert _fit().problems() == []
    assert checked(_fit(), True).problems() == []


@pytest.mark.parametrize(
    ("status", "message"),
    [
        (FitStatus.MAX_STEPS, "not converged after 5 steps: raise max_steps"),
        (FitStatus.DIVERGED, "stuck after 5 steps, at no minimum"),
        (FitStatus.RANK_DEFICIENT, r"do not determine kappa1, kappa2 separately \(condition number 7.0e\+00\)"),
        (FitStatus.TOO_FEW, "fewer residuals than there are parameters: kappa1, kappa2, center_x"),
        (FitStatus.NOT_FINITE, "are not finite"),
        (FitStatus.UNEXPLAINED, "does not look like the distorted picture"),
    ],
)
def test_a_failure_is_raised_unless_told_otherwise(x64, status, message):
    fit = _fit(status_code=jnp.asarray(int(status)))
    with pytest.raises(FitError, match=message):
        checked(fit, True)
    assert checked(fit, False) is fit
    assert explain(fit) in fit.summary()


def test_one_parameter_that_is_not_determined(x64):
    fit = _fit(status_code=jnp.asarray(3), information=jnp.diag(jnp.array([1.0, 1.0, 1e-20])))
    assert "the data do not determine center_x (condition" in explain(fit)


def test_a_batch_of_fits(x64):
    """Under `jax.vmap` every array has a leading axis, and so have the derived ones."""
    fit = _fit()
    two = eqx.tree_at(
        lambda fit: (fit.values, fit.covariance, fit.inflation),
        fit,
        (
            jnp.stack([fit.values, 2 * fit.values]),
            jnp.stack([fit.covariance, 4 * fit.covariance]),
            jnp.stack([fit.inflation, 1e6 * fit.inflation]),
        ),
    )
    np.testing.assert_allclose(two.standard_errors, [fit.standard_errors, 2 * fit.standard_errors], rtol=1e-14)
    np.testing.assert_allclose(two.correlation, [fit.correlation, fit.correlation], rtol=1e-14)
    np.testing.assert_array_equal(two.parameters["kappa2"], [0.05, 0.1])
    assert two.unidentified.tolist() == [[False] * 3, [True] * 3]


def test_coefficients_that_the_data_trade_against_each_other(x64):
    """On a narrow ring r² and r⁴ are nearly proportional: it converges, and says what that is worth."""
    random = np.random.default_rng(0)
    angle, radius = random.uniform(0, 2 * np.pi, 60), random.uniform(0.4999, 0.5001, 60)
    ideal = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    observed = 0.95 * ideal + 1e-4 * random.normal(size=ideal.shape)
    with pytest.warns(FitWarning, match="kappa1, kappa2 are not identified"):
        fit = fit_points(jl.RadialPolynomial(np.zeros(2)), ideal, observed)
    assert fit.status == FitStatus.CONVERGED
    assert np.all(fit.unidentified)
    np.testing.assert_allclose(np.diag(fit.correlation), 1, rtol=1e-12)
    assert fit.correlation[0, 1] < -0.999999
    summary = fit.summary()
    assert all(name in summary for name in fit.names)
    assert "warning: kappa1, kappa2 are not identified" in summary
    # The combination that is seen is known as well as the noise allows.
    seen = jnp.array([0.25, 0.0625])
    assert abs(float(seen @ fit.values) + 0.05) < 4 * float(jnp.sqrt(seen @ fit.covariance @ seen)) < 1e-3
