"""A lens that has nothing but `distort`: the region where it is one-to-one, its inverse, its derivatives, its flags."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxlens as jl
from jaxlens.numerics import as_floating, as_points, join, split

invert = jax.jit(lambda lens, points: lens.invert(points))
distort = jax.jit(lambda lens, points: lens.distort(points))
one_to_one = jax.jit(lambda lens, points: lens.one_to_one(points))
determinant = jax.jit(lambda lens, points: lens.jacobian_determinant(points))


class Plain(jl.Lens):
    """Eq. 9 as somebody would write it who knows of nothing else."""

    kappa: Float[Array, " order"]

    def __init__(self, kappa):
        self.kappa = as_floating(kappa)

    def distort(self, points):
        x, y = split(as_points(points))
        squared = x * x + y * y
        factor = 1 + sum(kappa * squared ** (i + 1) for i, kappa in enumerate(self.kappa))
        return join(x * factor, y * factor)


class Torn(jl.Lens):
    """Jumps by a quarter at x = 1/2, where nothing folds."""

    gap: Float[Array, ""]

    def __init__(self, gap):
        self.gap = as_floating(gap)

    def distort(self, points):
        x, y = split(as_points(points))
        return join(jnp.where(x > 0.5, x + self.gap, x), y)


def disc(count, radius, seed=0):
    random = np.random.default_rng(seed)
    radii, angles = radius * random.uniform(size=count), 2 * np.pi * random.uniform(size=count)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)


@pytest.mark.parametrize("kappa", [(1.0, -0.5), (-0.28, 0.0), (-0.1, -0.05), (0.5, 0.3), (0.0, 0.0)])
def test_it_says_what_the_radial_lens_says(dtype, kappa):
    """Whose inverse is one-dimensional, and whose fold is a polynomial's root."""
    plain, radial = Plain(np.asarray(kappa, dtype)), jl.RadialPolynomial(np.asarray(kappa, dtype))
    fold, edge = float(radial.fold_radius()), float(radial.edge_radius())
    observed = disc(3000, 1.3 * edge if np.isfinite(edge) else 3.0).astype(dtype)
    found, expected = invert(plain, observed), invert(radial, observed)
    radius = np.hypot(*observed.astype(np.float64).T)
    # Within rounding of the edge either answer is right.
    slack = {"float32": 1e-6, "float64": 1e-13}[dtype]
    decided = np.abs(radius - edge) > slack * edge if np.isfinite(edge) else np.full(len(radius), True)
    np.testing.assert_array_equal(np.asarray(found.status)[decided], np.asarray(expected.status)[decided])
    valid = np.asarray(expected.valid) & (radius < 0.999 * edge)
    tolerance = {"float32": 5e-6, "float64": 1e-12}[dtype]
    np.testing.assert_allclose(found.points[valid], expected.points[valid], rtol=0, atol=tolerance)
    assert bool(jnp.all(jnp.isfinite(found.points)))
    if np.isfinite(fold):
        lost = np.hypot(*np.asarray(found.points)[decided & (radius > 1.02 * edge)].T)
        np.testing.assert_allclose(lost, fold, rtol=1e-3)
    ideal = disc(1000, 1.5 * fold if np.isfinite(fold) else 10.0, seed=1).astype(dtype)
    apart = np.abs(np.hypot(*ideal.T) - fold) > 1e-5 if np.isfinite(fold) else np.full(len(ideal), True)
    np.testing.assert_array_equal(
        np.asarray(one_to_one(plain, ideal))[apart], np.asarray(one_to_one(radial, ideal))[apart]
    )


def random_lens(random):
    size = random.choice([0.1, 0.3, 1.0])
    radial, tangential, rational = random.normal(size=3), random.normal(size=2), random.normal(size=3)
    tangential = tangential * random.choice([0.0, 0.001, 0.02])
    return jl.BrownConrady([*(size * radial[:2]), *tangential, size * radial[2], *(size * rational)])


@pytest.mark.parametrize("seed", range(6))
def test_against_a_search_along_many_rays(x64, seed):
    """The edge on 360 rays, each looked at in 3000 places: no flag is wrong but within two per mille of it."""
    random = np.random.default_rng(seed)
    lens = random_lens(random)
    angles, radii = 2 * np.pi * np.arange(361) / 360, np.linspace(1e-3, 3.0, 3000)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    regular = np.asarray(determinant(lens, rays[:, None] * radii[:, None])) > 0
    edges = np.where(regular.all(axis=1), np.inf, radii[np.argmin(regular, axis=1)])

    def beside(points):
        ray = np.floor(np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi) * 180 / np.pi).astype(int)
        return np.minimum(edges[ray], edges[ray + 1]), np.maximum(edges[ray], edges[ray + 1])

    ideal = disc(4000, 1.3, seed)
    radius, (near, far) = np.hypot(*ideal.T), beside(ideal)
    inside, outside = radius < 0.998 * near, radius > 1.002 * far
    np.testing.assert_array_equal(np.asarray(one_to_one(lens, ideal))[inside | outside], inside[inside | outside])
    inverse = invert(lens, distort(lens, ideal))
    assert np.asarray(inverse.valid)[inside].all()
    np.testing.assert_allclose(inverse.points[inside], ideal[inside], rtol=0, atol=1e-12)
    observed = random.uniform(-1.5, 1.5, (4000, 2))
    inverse = invert(lens, observed)
    valid, found = np.asarray(inverse.valid), np.asarray(inverse.points)
    assert (np.hypot(*found[valid].T) < 1.002 * beside(found[valid])[1]).all()
    np.testing.assert_allclose(distort(lens, found[valid]), observed[valid], rtol=0, atol=1e-13)
    assert np.isfinite(found).all()


def test_what_the_solver_cannot_reach_is_no_fold(dtype):
    """Every status, each for its reason."""
    status = jl.InverseStatus
    inverse = Torn(np.asarray(0.25, dtype)).invert(jnp.asarray([[0.6, 0.1], [0.9, 0.2], [np.nan, 0.0]], dtype))
    assert inverse.status.tolist() == [status.NOT_CONVERGED, status.CONVERGED, status.NOT_FINITE]
    inverse = Plain(np.asarray([-0.3], dtype)).invert(jnp.asarray([[0.7, 0.1], [0.71, 0.0], [np.inf, 0.0]], dtype))
    assert inverse.status.tolist() == [status.NO_PREIMAGE, status.NO_PREIMAGE, status.NOT_FINITE]
    assert bool(jnp.all(jnp.isfinite(inverse.points)))


def test_a_pole_ends_the_region(x64):
    """1 / (1 − r²): at r = 1 the picture has gone to infinity, and comes back from the other side."""
    lens = jl.BrownConrady([0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    ideal = np.stack([np.asarray([0.5, 0.99, 0.9999, 1.0001, 1.5]), np.zeros(5)], axis=-1)
    assert lens.one_to_one(ideal).tolist() == [True, True, True, False, False]
    inverse = lens.invert(lens.distort(ideal[:3]))
    assert inverse.valid.all()
    np.testing.assert_allclose(inverse.points, ideal[:3], atol=1e-12)


def test_half_precision_is_solved_in_single():
    lens = jl.BrownConrady(np.asarray([-0.25, 0.0625, 0.0, 0.0], np.float16))
    observed = lens.distort(np.asarray([[0.25, 0.5], [0.0, 0.0]], np.float16))
    inverse = lens.invert(observed)
    assert (inverse.points.dtype, inverse.valid.tolist()) == (jnp.float32, [True, True])
    np.testing.assert_allclose(inverse.points, [[0.25, 0.5], [0.0, 0.0]], atol=1e-3)


@pytest.mark.slow
def test_derivatives(x64):
    """Of first and second order, by points and by parameters, against the radial lens's; finite in masked places."""
    kappa, observed = np.asarray([-0.25, 0.05]), disc(20, 0.6)
    weights = np.random.default_rng(3).normal(size=observed.shape)
    results = []
    for make in (Plain, jl.RadialPolynomial):

        def total(kappa, points, make=make):
            return jnp.sum(make(kappa).invert(points).points * weights)

        first = jax.jit(jax.grad(total, (0, 1)))(kappa, observed)
        second = jax.jit(jax.hessian(total))(kappa, observed)
        results.append((*first, second))
    for ours, theirs in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)
    masked = jax.grad(lambda kappa: jnp.nansum(Plain(kappa).undistort(jnp.asarray([[5.0, 5.0], [0.1, 0.0]]))))(
        jnp.asarray([-0.3])
    )
    assert bool(jnp.all(jnp.isfinite(masked)))


@pytest.mark.parametrize("count", [300, 40_000])
def test_a_batch_is_one_after_another(x64, count):
    """Lenses that fold and lenses that do not, in one batch; small ones together, large ones in turns."""
    lenses = jax.vmap(Plain)(jnp.asarray([[-0.3, 0.0], [0.2, 0.1]]))
    points = disc(count, 1.0)
    batch = jax.jit(jax.vmap(lambda lens: lens.invert(points)))(lenses)
    inside = jax.jit(jax.vmap(lambda lens: lens.one_to_one(points)))(lenses)
    for i in range(2):
        lens = jax.tree.map(lambda leaf, i=i: leaf[i], lenses)
        alone = invert(lens, points)
        np.testing.assert_array_equal(batch.status[i], alone.status)
        # At the fold itself, 0.7027, a rounding of the observed point moves the ideal one by its root.
        clear = np.hypot(*points.T) < 0.7
        np.testing.assert_allclose(batch.points[i][clear], alone.points[clear], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(inside[i], one_to_one(lens, points))
