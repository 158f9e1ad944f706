"""B-spline fields: scipy's splines, refinement, bending energy, inverses, derivatives, and fits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import NdBSpline

import jaxlens as jl
from jaxlens.deformations import BSplineField, fit_bspline_field

LOWER, UPPER = np.array([-1.0, 2.0]), np.array([3.0, 5.0])
CELLS = (5, 4)
UNIT = np.random.default_rng(0).uniform(0, 1, (300, 2))
POINTS = LOWER + UNIT * (UPPER - LOWER)
COEFFICIENTS = 0.15 * np.random.default_rng(1).normal(size=(8, 7, 2))


@pytest.fixture
def field(x64):
    return BSplineField(COEFFICIENTS, LOWER, UPPER)


def reference(coefficients=COEFFICIENTS, cells=CELLS):
    knots = tuple(LOWER[k] + (UPPER[k] - LOWER[k]) / count * np.arange(-3, count + 4) for k, count in enumerate(cells))
    return NdBSpline(knots, np.asarray(coefficients), 3)


def test_scipy_s_tensor_product(field):
    np.testing.assert_allclose(field(POINTS), POINTS + reference()(POINTS), rtol=0, atol=1e-14)
    assert field.cells == CELLS


def test_one_coefficient_by_hand(dtype):
    """2/3 at its peak, 1/6 a cell away, 1/48 half a cell further."""
    bump = BSplineField(np.zeros((8, 7, 2), dtype), (0, 0), (5, 4))
    bump = BSplineField(bump.coefficients.at[3, 2, 0].set(36), (0, 0), (5, 4))
    points = np.array([[2, 1], [3, 1], [2, 2], [1, 0], [3.5, 1], [4, 1]], dtype)
    moved = bump(points)
    assert moved.dtype == dtype
    expected = points + np.array([[16, 0], [4, 0], [4, 0], [1, 0], [0.5, 0], [0, 0]])
    np.testing.assert_allclose(moved, expected, rtol=4 * jnp.finfo(dtype).eps)


def test_zero_is_the_identity_and_equal_ones_translate(field):
    np.testing.assert_array_equal(BSplineField(np.zeros((8, 7, 2)), LOWER, UPPER)(POINTS), POINTS)
    shifted = BSplineField(np.full((8, 7, 2), 0.3), LOWER, UPPER)
    np.testing.assert_allclose(shifted(POINTS * 3), POINTS * 3 + 0.3, rtol=0, atol=1e-14)


def test_beyond_the_rectangle_the_border_goes_on(field):
    around = LOWER + (2 * UNIT - 0.5) * (UPPER - LOWER)
    border = np.clip(around, LOWER, UPPER)
    np.testing.assert_allclose(field(around) - around, field(border) - border, rtol=0, atol=1e-14)
    assert np.isnan(field(np.array([[np.nan, 3.0]]))).any()


def test_refinement_changes_nothing(field):
    fine = field.refine()
    assert fine.cells == (10, 8)
    assert fine.refine().cells == (20, 16)
    for points in (POINTS, 2 * POINTS):
        np.testing.assert_allclose(fine(points), field(points), rtol=0, atol=1e-14)
        np.testing.assert_allclose(fine.refine()(points), field(points), rtol=0, atol=1e-14)


def test_bending_energy_is_the_integral(field):
    """Gauss–Legendre quadrature of scipy's second derivatives, exact for these degrees."""
    nodes, shares = np.polynomial.legendre.leggauss(4)
    x, y = (
        LOWER[k] + (UPPER[k] - LOWER[k]) / count * (np.arange(count)[:, None] + (nodes + 1) / 2).ravel().reshape(-1, 4)
        for k, count in enumerate(CELLS)
    )
    places = np.stack(np.meshgrid(x.ravel(), y.ravel(), indexing="ij"), axis=-1)
    weights = np.outer(np.tile(shares / 2, CELLS[0]), np.tile(shares / 2, CELLS[1])) / np.prod(CELLS)
    spline = reference()
    expected = sum(
        factor * np.sum(weights[..., None] * spline(places, nu=order) ** 2)
        for factor, order in ((1, (2, 0)), (2, (1, 1)), (1, (0, 2)))
    )
    np.testing.assert_allclose(field.bending_energy(), expected, rtol=1e-12)
    np.testing.assert_allclose(field.refine().bending_energy(), expected, rtol=1e-12)


def test_round_trip(field):
    """Within the rectangle, across its border and beyond."""
    around = LOWER + (1.6 * UNIT - 0.3) * (UPPER - LOWER)
    assert float(field.jacobian_determinant(around).min()) > 0.3
    inverse = field.invert(field(around))
    assert bool(inverse.valid.all())
    np.testing.assert_allclose(inverse.points, around, rtol=0, atol=1e-12)


def test_derivatives(field):
    """By points against scipy's; by coefficients the map is linear; at the border they are those of the inside."""
    jacobian = np.asarray(field.jacobian(POINTS))
    spline = reference()
    expected = np.stack([spline(POINTS, nu=(1, 0)), spline(POINTS, nu=(0, 1))], axis=-1) + np.eye(2)
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=1e-13)
    corners = np.stack([LOWER, UPPER, LOWER])
    at_corners = np.asarray(field.jacobian(corners))
    inside = np.clip(corners, LOWER + 1e-12, UPPER - 1e-12)
    expected = np.stack([spline(inside, nu=(1, 0)), spline(inside, nu=(0, 1))], axis=-1) + np.eye(2)
    np.testing.assert_allclose(at_corners, expected, rtol=0, atol=1e-10)

    def evaluate(coefficients):
        return BSplineField(coefficients, LOWER, UPPER)(POINTS)

    change = np.random.default_rng(2).normal(size=COEFFICIENTS.shape)
    _, forward = jax.jvp(evaluate, (jnp.asarray(COEFFICIENTS),), (jnp.asarray(change),))
    np.testing.assert_allclose(forward, reference(change)(POINTS), rtol=0, atol=1e-13)
    (reverse,) = jax.vjp(evaluate, jnp.asarray(COEFFICIENTS))[1](forward)
    np.testing.assert_allclose(np.sum(reverse * change), np.sum(forward**2), rtol=1e-12)


def test_batches(field):
    batch = jax.vmap(BSplineField, (0, None, None))(COEFFICIENTS * np.array([1, 2])[:, None, None, None], LOWER, UPPER)
    moved = jax.jit(jax.vmap(lambda field: field(POINTS)))(batch)
    np.testing.assert_allclose(moved[0], field(POINTS), rtol=0, atol=1e-14)
    np.testing.assert_allclose(moved[1] - POINTS, 2 * (field(POINTS) - POINTS), rtol=0, atol=1e-14)
    assert field(jnp.zeros((0, 2))).shape == (0, 2)
    mask = field.adjustable()
    assert (mask.coefficients, mask.lower, mask.upper) == (True, False, False)


def fit(source, target, **options):
    options = {"cells": CELLS, "lower": LOWER, "upper": UPPER, "penalty": 1e-4} | options
    return fit_bspline_field(source, target, **options)


def test_a_fit_is_the_minimum_of_what_it_says(field):
    """Against dense least squares of stacked rows; the energy's square root by quadrature of scipy's derivatives."""
    random = np.random.default_rng(3)
    target = np.asarray(field(POINTS)) + 0.02 * random.normal(size=POINTS.shape)
    weights = random.uniform(0, 2, len(POINTS))
    found = fit(POINTS, target, weights=weights)
    basis = reference(np.eye(56).reshape(8, 7, 56))
    nodes, shares = np.polynomial.legendre.leggauss(4)
    x, y = (
        (LOWER[k] + (UPPER[k] - LOWER[k]) / count * (np.arange(count)[:, None] + (nodes + 1) / 2)).ravel()
        for k, count in enumerate(CELLS)
    )
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    mean = np.outer(np.tile(shares / 2, CELLS[0]), np.tile(shares / 2, CELLS[1])).ravel() / np.prod(CELLS)
    rows = [np.sqrt(weights / weights.sum())[:, None] * basis(POINTS)]
    for factor, order in ((1, (2, 0)), (2, (1, 1)), (1, (0, 2))):
        rows.append(np.sqrt(1e-4 * factor * mean)[:, None] * basis(places, nu=order))
    right = np.zeros((sum(map(len, rows)), 2))
    right[: len(POINTS)] = np.sqrt(weights / weights.sum())[:, None] * (target - POINTS)
    expected = np.linalg.lstsq(np.concatenate(rows), right)[0].reshape(8, 7, 2)
    np.testing.assert_allclose(found.coefficients, expected, rtol=0, atol=1e-10)


def test_an_exact_field_is_found(field):
    found = fit(POINTS, field(POINTS), penalty=1e-13)
    np.testing.assert_allclose(found(POINTS), field(POINTS), rtol=0, atol=1e-9)


def test_the_penalty_means_the_same_whatever_the_numbers(field):
    """A wave of wavelength 2π penalty^(1/4) comes out at half its height, on any lattice; an affine field whole."""
    wavelength = 0.8
    penalty = (wavelength / (2 * np.pi)) ** 4
    axes = [np.linspace(LOWER[k], UPPER[k], 121) for k in range(2)]
    source = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    wave = np.sin(2 * np.pi * source[:, :1] / wavelength) * np.array([0.1, 0.0])
    middle = np.all(np.abs(source - 0.5 * (LOWER + UPPER)) < 0.8, axis=-1)
    for cells in ((20, 6), (28, 8)):
        found = fit(source, source + wave, cells=cells, penalty=penalty)
        share = np.sum((found(source) - source)[middle] * wave[middle]) / np.sum(wave[middle] ** 2)
        np.testing.assert_allclose(share, 0.5, atol=1e-2)
    affine = source @ np.array([[1.1, 0.2], [-0.1, 0.9]]) + 3.0
    np.testing.assert_allclose(fit(source[::50], affine[::50], penalty=1.0)(source), affine, rtol=0, atol=1e-10)


def test_derivatives_of_a_fit(field):
    target = jnp.asarray(field(POINTS)) + 0.01 * np.sin(9 * POINTS)
    weights = jnp.ones(len(POINTS)).at[5].set(0)
    source = jnp.asarray(POINTS)
    random = np.random.default_rng(4)
    change = tuple(jnp.asarray(random.normal(size=shape)) for shape in ((300, 2), (300, 2), (300,), ()))
    leaves = (source, target, weights, jnp.asarray(1e-3))

    def coefficients(source, target, weights, penalty):
        # Traced, so that a weight may be taken below zero by a difference's step.
        return fit(source, target, weights=weights, penalty=penalty).coefficients

    coefficients = jax.jit(coefficients)
    change = (*change[:2], change[2].at[5].set(0), change[3])
    _, forward = jax.jvp(coefficients, leaves, change)
    step = 1e-6
    moved = [
        coefficients(*(leaf + sign * step * by for leaf, by in zip(leaves, change, strict=True))) for sign in (1, -1)
    ]
    np.testing.assert_allclose(forward, (moved[0] - moved[1]) / (2 * step), rtol=0, atol=1e-5 * np.abs(forward).max())
    cotangent = random.normal(size=forward.shape)
    pulled = jax.vjp(coefficients, *leaves)[1](jnp.asarray(cotangent))
    total = sum(np.sum(a * b) for a, b in zip(pulled, change, strict=True))
    np.testing.assert_allclose(total, np.sum(cotangent * forward), rtol=1e-9)


def test_points_that_do_not_count(field):
    """A missing point, of weight zero, is as none."""
    source, target = POINTS.copy(), np.array(field(POINTS))
    source[7], target[7] = np.nan, np.inf
    weights = np.ones(len(source))
    weights[7] = 0
    np.testing.assert_allclose(
        fit(source, target, weights=weights).coefficients,
        fit(np.delete(source, 7, 0), np.delete(target, 7, 0)).coefficients,
        rtol=0,
        atol=1e-10,
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"penalty": 0.0}, "penalty must be a finite number above 0, got 0.0"),
        ({"cells": (0, 3)}, "cells must be two numbers of one or more"),
        ({"target": np.zeros((4, 2))}, r"both have shape \(N, 2\), got \(300, 2\) and \(4, 2\)"),
        ({"weights": np.ones(4)}, r"weights must have shape \(300,\)"),
        ({"weights": -np.ones(300)}, "not negative, got -1.0 at index 0"),
        ({"target": np.full((300, 2), np.nan)}, r"target\[0\] is not finite"),
        ({"source": POINTS * [1, 0] + [0, 3]}, "do not lie on one line"),
        ({"source": POINTS[:2], "target": POINTS[:2]}, "do not lie on one line"),
        ({"upper": LOWER}, "is empty"),
    ],
)
@pytest.mark.usefixtures("untyped")
def test_misuse_of_a_fit(x64, options, message):
    with pytest.raises(ValueError, match=message):
        fit(**({"source": POINTS, "target": POINTS} | options))


def test_misuse():
    with pytest.raises(ValueError, match=r"shape \(nx \+ 3, ny \+ 3, 2\).*got \(3, 5, 2\)"):
        BSplineField(np.zeros((3, 5, 2)), (0, 0), (1, 1))


def test_a_picture_is_warped_by_it(field):
    """As a coordinate map among others: a translation by one pixel."""
    picture = np.random.default_rng(5).uniform(size=(6, 8))
    shift = BSplineField(np.ones((4, 4, 2)), (0, 0), (8, 6))
    moved = jl.warp(picture, shift, frame=jl.Frame((0, 0), 1))
    np.testing.assert_allclose(moved[:-1, :-1], picture[1:, 1:], rtol=0, atol=1e-12)
