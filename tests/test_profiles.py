"""Integral projections: sums by hand, and displacements that are known."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.profiles import integral_projections, profile_displacement

X = np.arange(160.0)


def _profile(x):
    """Features of many widths, everywhere."""
    return np.sin(x**2 / 400) + 0.4 * np.cos(x / 4) + 0.01 * x


def test_means_by_hand(dtype):
    image = np.array([[1, 2, 3], [4, 5, 9]], dtype)
    found = integral_projections(image)
    assert found.horizontal.dtype == dtype
    assert found.horizontal.tolist() == [2, 6]
    assert found.vertical.tolist() == [2.5, 3.5, 6]
    assert bool(found.horizontal_valid.all() & found.vertical_valid.all())


def test_what_is_masked_does_not_count(x64):
    image = np.array([[1.0, 2, np.nan], [4, 5, np.inf], [np.nan, np.nan, np.nan]])
    mask = np.isfinite(image)
    found = integral_projections(image, mask=mask)
    assert found.horizontal.tolist() == [1.5, 4.5, 0]
    assert found.vertical.tolist() == [2.5, 3.5, 0]
    assert found.horizontal_valid.tolist() == found.vertical_valid.tolist() == [True, True, False]
    gradient = jax.grad(lambda image: jnp.sum(integral_projections(image, mask=mask).vertical))(jnp.asarray(image))
    np.testing.assert_array_equal(gradient, np.where(mask, 0.5, 0))
    assert integral_projections(np.array([[0, 255]], np.uint8)).horizontal.tolist() == [127.5]


@pytest.mark.parametrize("shift", [0.0, 3.0, -7.0, 2.4, -5.5])
def test_a_shift(x64, shift):
    found = profile_displacement(_profile(X), 3 + 0.5 * _profile(X - shift))
    valid = np.asarray(found.valid)
    whole = shift == round(shift)
    # The parabola is exact in the middle and at whole shifts, and biased by a few hundredths between.
    assert abs(float(found.shift) - shift) <= 0.05
    assert valid.sum() >= 110
    assert np.median(np.abs(np.asarray(found.displacement) - shift)[valid]) <= 0.05
    if whole:
        # Near an end the window sought may lie outside, and another is found.
        assert np.median(found.score[valid]) >= 1 - 1e-3
    assert np.all(np.asarray(found.displacement)[~valid] == 0)
    assert not valid[:15].any()
    assert not valid[-15:].any()


def test_a_stretch(x64):
    """`other(x) = reference(80 + (x − 80) / 1.05)`: element i has moved by 0.05 (i − 80)."""
    found = profile_displacement(_profile(X), _profile(80 + (X - 80) / 1.05), window=21)
    valid = np.asarray(found.valid) & (np.asarray(found.score) > 0.9)
    error = np.abs(np.asarray(found.displacement) - 0.05 * (X - 80))[valid]
    assert valid.sum() >= 100
    assert np.median(error) <= 0.1
    assert np.percentile(error, 95) <= 0.4


def test_a_lens_moves_the_lines_of_a_grid(x64):
    """A row of dots along the middle column: the vertical positions move as the lens says, with the paper's k."""
    height = width = 161
    rows = np.arange(height) - 80.0
    signal = _profile(np.arange(height))
    picture = np.zeros((height, width))
    picture[:, 78:83] = signal[:, None]
    frame = jl.Frame([80.0, 80.0], 80.0)
    for kappa in (0.15, -0.15):
        warped = jl.distort_image(picture, jl.RadialPolynomial([kappa]), frame=frame, border="edge")
        mask = np.zeros((height, width), bool)
        mask[:, 80] = True
        found = profile_displacement(
            integral_projections(picture, mask=mask).horizontal,
            integral_projections(warped, mask=mask).horizontal,
            window=21,
        )
        expected = kappa * rows**3 / 80**2
        good = np.asarray(found.valid) & (np.asarray(found.score) > 0.95) & (np.abs(expected) < 6)
        assert good.sum() > 60
        error = np.abs(np.asarray(found.displacement) - expected)[good]
        assert np.median(error) <= 0.15
        assert np.percentile(error, 95) <= 0.6


def test_a_flat_vector_has_no_displacement(dtype):
    flat = np.full(160, 7, dtype)
    found = profile_displacement(flat, _profile(X).astype(dtype))
    assert not bool(found.valid.any())
    assert np.isfinite(found.displacement).all()
    assert float(found.shift) == 0


def test_derivatives(x64):
    """With respect to both vectors: against finite differences, and finite in flat places."""
    reference = _profile(X) * (X > 40)
    other = _profile(X - 2.3) * (X > 42)

    @jax.jit
    def value(reference, other):
        found = profile_displacement(reference, other)
        return jnp.sum(found.displacement[60:100]) + found.shift

    gradients = jax.jit(jax.grad(value, argnums=(0, 1)))(jnp.asarray(reference), jnp.asarray(other))
    assert all(np.isfinite(part).all() for part in gradients)
    direction = np.random.default_rng(0).normal(size=160)
    expected = float(jnp.sum(gradients[0] * direction) - jnp.sum(gradients[1] * direction))
    step = 1e-6
    ahead, behind = (value(reference + s * direction, other - s * direction) for s in (step, -step))
    np.testing.assert_allclose((ahead - behind) / (2 * step), expected, rtol=1e-6)


@pytest.fixture
def _untyped(monkeypatch):
    """Without the type checks of the tests: what a user meets."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.usefixtures("_untyped")
def test_misuse():
    with pytest.raises(ValueError, match=r"shape \(H, W\).*got \(2, 3, 3\)"):
        integral_projections(np.zeros((2, 3, 3)))
    with pytest.raises(ValueError, match=r"booleans of the image's shape \(2, 3\), got bool \(3, 2\)"):
        integral_projections(np.zeros((2, 3)), mask=np.ones((3, 2), bool))
    with pytest.raises(ValueError, match=r"got \(5,\) and \(6,\)"):
        profile_displacement(np.zeros(5), np.zeros(6))
    for window in (1, 10, 51):
        with pytest.raises(ValueError, match=f"window must be odd.*got {window}"):
            profile_displacement(np.zeros(50), np.zeros(50), window=window)
    with pytest.raises(ValueError, match="largest must be"):
        profile_displacement(np.zeros(50), np.zeros(50), largest=0)
