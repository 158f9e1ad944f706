"""Coordinate maps on their own: the plane's Newton, chains, inverses and restrictions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxlens as jl
from jaxlens.maps import Chain, CoordinateMap, InverseStatus, Inverted, OneToOne
from jaxlens.numerics import as_points, join, split


class Shear(CoordinateMap):
    """(x, y) → (x + a y + b x², y + b x y): not radial, with a fold."""

    a: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    b: Float[Array, ""] = eqx.field(converter=jnp.asarray)

    def __call__(self, points):
        x, y = split(as_points(points))
        return join(x + self.a * y + self.b * x * x, y + self.b * x * y)


POINTS = np.random.default_rng(0).uniform(-0.6, 0.6, (40, 2))


def test_inverse_of_a_map_that_is_not_radial(x64):
    mapping = Shear(0.2, 0.3)
    inverse = mapping.invert(mapping(POINTS))
    assert inverse.valid.all()
    np.testing.assert_allclose(inverse.points, POINTS, atol=1e-14)


def test_what_it_does_not_reach_is_masked(x64):
    # On y = 0 the map is x + 0.3 x², which never falls below −1/1.2.
    inverse = Shear(0.0, 0.3).invert(jnp.array([[-0.8, 0.0], [-1.0, 0.0], [jnp.inf, 0.0]]))
    assert inverse.status.tolist() == [InverseStatus.CONVERGED, InverseStatus.NO_PREIMAGE, InverseStatus.NOT_FINITE]
    assert np.isfinite(inverse.points).all()
    assert np.isnan(inverse.masked()[1:]).all()


def test_implicit_derivatives(x64):
    target = Shear(0.2, 0.3)(POINTS[:3])

    def solution(a, b):
        return Shear(a, b).invert(target).points

    for argument in (0, 1):
        forward = jax.jacfwd(solution, argument)(0.2, 0.3)
        np.testing.assert_allclose(forward, jax.jacrev(solution, argument)(0.2, 0.3), atol=1e-13)
        step = np.eye(2)[argument] * 1e-6
        difference = (solution(0.2 + step[0], 0.3 + step[1]) - solution(0.2 - step[0], 0.3 - step[1])) / 2e-6
        np.testing.assert_allclose(forward, difference, atol=1e-8)


def test_jacobian_is_row_output_column_input(x64):
    np.testing.assert_allclose(Shear(0.2, 0.3).jacobian(jnp.array([0.5, -1.0])), [[1.3, 0.2], [-0.3, 1.15]], atol=1e-15)
    assert Shear(0.2, 0.3).jacobian_determinant(jnp.array([0.5, -1.0])) == pytest.approx(1.3 * 1.15 + 0.06)


def test_chains(x64):
    shear, lens = Shear(0.2, 0.3), jl.RadialPolynomial([-0.2])
    chain = shear.then(lens, Inverted(shear))
    np.testing.assert_allclose(chain(POINTS), shear.invert(lens(shear(POINTS))).points, atol=1e-15)
    inverse = chain.invert(chain(POINTS))
    assert inverse.valid.all()
    np.testing.assert_allclose(inverse.points, POINTS, atol=1e-13)
    assert len(chain.then(lens).maps) == 4
    np.testing.assert_array_equal(Chain(())(POINTS), POINTS)
    assert chain.one_to_one(POINTS).all()
    # One step without a preimage is enough.
    assert lens.then(lens).invert(jnp.array([1.0, 0.0])).status == InverseStatus.NO_PREIMAGE


def test_inverse_of_the_inverse(x64):
    lens = jl.RadialPolynomial([-0.2])
    assert lens.inverse().inverse() is lens
    inverse = Inverted(lens).invert(jnp.array([[0.5, 0.0], [2.0, 0.0], [jnp.nan, 0.0]]))
    assert inverse.valid.tolist() == [True, False, False]
    np.testing.assert_allclose(inverse.points[0], lens(jnp.array([0.5, 0.0])))


def test_restriction_to_where_a_map_is_one_to_one(x64):
    lens = jl.RadialPolynomial([-1 / 3])  # folds at radius one
    restricted = OneToOne(lens)(jnp.array([[0.5, 0.0], [1.5, 0.0]]))
    np.testing.assert_allclose(restricted[0], lens(jnp.array([0.5, 0.0])))
    assert np.isnan(restricted[1]).all()
    assert OneToOne(lens).invert(jnp.array([0.6, 0.0])).valid
