"""What is fitted need not be a lens: lattices, fields, homographies and chains of maps come back, too."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxlens as jl
from jaxlens.deformations import BSplineField, FreeForm, Homography
from jaxlens.fitting import FitError, fit_images, fit_points
from jaxlens.fitting._parameters import choose, in_dtype
from jaxlens.numerics import join, split

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.uniform(-0.9, 0.9, (300, 2))
SQUARE = {"lower": (-1.0, -1.0), "upper": (1.0, 1.0)}
TILT = np.array([[1.02, 0.03, 0.02], [-0.02, 0.99, -0.01], [0.03, -0.02, 1.0]])
MOVES = 0.05 * RANDOM.normal(size=(3, 4, 2))
COEFFICIENTS = 0.03 * RANDOM.normal(size=(5, 4, 2))


def _lattice():
    still = FreeForm.identity(2, 3, **SQUARE)
    return still, FreeForm(still.control_points + MOVES, **SQUARE)


def _field():
    return BSplineField(np.zeros_like(COEFFICIENTS), **SQUARE), BSplineField(COEFFICIENTS, **SQUARE)


def _homography():
    return Homography(np.eye(3)), Homography(TILT)


class Amplifier(jl.Lens):
    """A lens of somebody's own, of one number, which it calls as light's is called."""

    gain: Float[Array, ""] = eqx.field(converter=jnp.asarray)

    def distort(self, points):
        x, y = split(points)
        factor = 1 + self.gain * (x * x + y * y)
        return join(x * factor, y * factor)


def _chain():
    start = jl.RadialPolynomial([0.0]).then(Homography(np.eye(3)))
    return start, jl.RadialPolynomial([-0.2]).then(Homography(TILT))


@pytest.mark.parametrize(("make", "count"), [(_lattice, 24), (_field, 40), (_homography, 8), (_chain, 9)])
@pytest.mark.slow
def test_exact_points_give_the_map_back(x64, make, count):
    """All of its adjustable numbers, and none of the others."""
    start, truth = make()
    fit = fit_points(start, POINTS, truth(POINTS))
    assert len(fit.names) == count
    for found, expected in zip(jax.tree.leaves(fit.lens), jax.tree.leaves(truth), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert float(fit.rms) < 1e-11


def test_control_points_without_data_are_not_determined(x64):
    corner = RANDOM.uniform(0.5, 1, (60, 2))
    start, truth = _field()
    with pytest.raises(FitError, match="the data do not determine"):
        fit_points(start, corner, truth(corner))


def test_a_homography_between_two_pictures(x64):
    noise = jax.random.uniform(jax.random.key(0), (8, 10))
    picture = jax.image.resize(noise, (64, 80), "cubic")
    start, truth = _homography()
    fit = fit_images(start, picture, jl.warp(picture, truth.inverse()))
    np.testing.assert_allclose(fit.lens.matrix, TILT, rtol=0, atol=1e-9)
    assert fit.names[:8] == ("h11", "h12", "h13", "h21", "h22", "h23", "h31", "h32")
    assert "gain" in fit.names


def test_what_adjusts(x64):
    lens = jl.Division(0.1).adjustable()
    assert (lens.k, lens.center) == (True, False)
    chain = jl.RadialPolynomial([0.1]).then(_lattice()[0])
    mask = chain.adjustable()
    assert (mask.maps[0].center, mask.maps[1].control_points, mask.maps[1].lower) == (False, True, False)
    assert jl.Inverted(jl.Division(0.1)).adjustable().mapping.center is False
    assert jl.OneToOne(jl.Division(0.1)).adjustable().mapping.k is True
    assert jnp.sum(jnp.asarray(Homography(TILT).adjustable().matrix)) == 8


def test_names_are_unique(x64):
    """Of a chain by where the map stands in it; of a lens that has a `gain`, beside light's, by whose it is."""
    chain = jl.RadialPolynomial([0.1, 0.0]).then(jl.Division(0.05), jl.RadialPolynomial([-0.1]))
    names = choose({"lens": chain}, {"lens": chain.adjustable()}).names
    assert names == ("maps[0].kappa1", "maps[0].kappa2", "maps[1].k", "maps[2].kappa1")
    inverse = jl.BrownConrady(np.zeros(4)).inverse()
    assert choose(inverse, inverse.adjustable()).names == tuple(f"mapping.{name}" for name in ("k1", "k2", "p1", "p2"))
    lens, light = Amplifier(0.1), {"gain": 1.0, "offset": 0.0}
    model = {"lens": lens, "light": light}
    assert choose(model, jax.tree.map(lambda _: True, model)).names == ("lens.gain", "gain", "offset")
    assert choose({"lens": lens}, {"lens": lens.adjustable()}).names == ("gain",)


@pytest.mark.slow
def test_a_picture_through_a_lens_with_a_gain(x64):
    noise = jax.random.uniform(jax.random.key(0), (8, 10))
    picture = jax.image.resize(noise, (64, 80), "cubic")
    fit = fit_images(Amplifier(0.0), picture, jl.distort_image(picture, Amplifier(0.1)))
    np.testing.assert_allclose(fit.parameters["lens.gain"], 0.1, rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.parameters["gain"], 1, rtol=0, atol=1e-8)


def test_only_floating_numbers_change_their_dtype(x64):
    tree = {"weights": np.ones(2, np.float32), "count": np.arange(2), "flag": np.asarray(True), "number": 2}
    cast = in_dtype(tree, jnp.float64)
    assert [str(jnp.asarray(cast[name]).dtype) for name in tree] == ["float64", "int64", "bool", "int64"]
