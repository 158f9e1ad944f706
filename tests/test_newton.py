import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxlens import newton

EPSILON = {"float32": 2.0**-23, "float64": 2.0**-52}


def cubic(x):
    return x + x**3


def cubic_and_slope(x):
    return x + x**3, 1 + 3 * x * x


def wave_and_slope(x):
    """Rises up to π/2, where its slope vanishes, and falls from there."""
    return jnp.sin(x), jnp.cos(x)


def cardano(r):
    """The real root of x + x³ = r."""
    r = np.asarray(r, np.longdouble)
    u = np.cbrt(r / 2 + np.sqrt(r * r / 4 + np.longdouble(1) / 27))
    return u - 1 / (3 * u)


solve_cubic = jax.jit(lambda r: newton.solve_increasing(cubic_and_slope, r, lambda r: r, jnp.asarray(jnp.inf, r.dtype)))
solve_wave = jax.jit(
    lambda r: newton.solve_increasing(wave_and_slope, r, lambda r: r, jnp.asarray(np.float32(np.pi / 2), r.dtype))
)


def test_roots_of_a_cubic(dtype):
    targets = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 500)]).astype(dtype)
    found = np.asarray(solve_cubic(targets))
    assert found.dtype == dtype
    assert found[0] == 0
    # A residual of eight units in the last place, divided by the slope.
    bound = 10 * EPSILON[dtype] * (targets / (1 + 3 * found**2) + found)
    assert np.all(np.abs(found - cardano(targets))[1:] <= bound[1:])


def test_roots_up_to_where_the_slope_vanishes(dtype):
    end = np.float32(np.pi / 2).astype(dtype)
    expected = np.concatenate([np.linspace(0, 1.57, 200), end - np.geomspace(1e-5, 1e-2, 50)])
    targets = np.append(np.sin(expected), np.sin(float(end))).astype(dtype)
    found = solve_wave(targets)
    assert np.all((np.asarray(found) >= 0) & (np.asarray(found) <= end))
    # Eight units in the last place of x, which is the larger of the two here, and what the sine itself is off by.
    assert np.max(np.abs(np.sin(np.asarray(found, float)) - targets)) <= (8 * np.pi / 2 + 2) * EPSILON[dtype]


def test_every_chunk_gets_its_second_chance(x64):
    """Most elements are easy, some of each chunk are not; the last chunk overlaps the one before."""
    count = 2 * newton._CHUNK + 100
    targets = np.full(count, 1e-2)
    hard = np.arange(0, count, 1001)
    targets[hard] = 1e9
    targets[-1] = 1e12
    found = np.asarray(solve_cubic(targets))
    np.testing.assert_allclose(found, cardano(targets).astype(float), rtol=1e-14)


@pytest.mark.parametrize("shape", [(), (0,), (3, 0, 2), (4, 5)])
def test_shapes(shape):
    assert solve_cubic(jnp.ones(shape)).shape == shape


@pytest.mark.parametrize(
    ("function", "inverse", "upper"),
    [
        (cubic, lambda r: cardano(r), np.inf),
        (jnp.sin, np.arcsin, np.pi / 2),
        (jnp.tanh, np.arctanh, np.inf),  # Newton's own steps diverge
        (jnp.expm1, np.log1p, np.inf),
    ],
    ids=["cubic", "sin", "tanh", "exp"],
)
def test_bracketed_roots(x64, function, inverse, upper):
    targets = np.linspace(0.01, 0.99, 99)
    start = np.concatenate([np.zeros(33), np.full(33, 1e-3), np.full(33, 1.5)])
    found = newton.solve_bracketed(
        function, jnp.asarray(targets), jnp.asarray(start), jnp.zeros(99), jnp.full(99, upper)
    )
    np.testing.assert_allclose(found, np.asarray(inverse(targets), float), rtol=1e-13)


def test_slopes_whose_square_overflows():
    """A step of x / ∞ is no standstill."""
    coefficient = 2.6e5

    def power(x):
        return coefficient * x**13

    targets = jnp.geomspace(1e-3, 1e6, 50, dtype=jnp.float32)
    start = jnp.linspace(20, 300, 50, dtype=jnp.float32)
    found = newton.solve_bracketed(power, targets, start, jnp.zeros(50), jnp.full(50, jnp.inf))
    np.testing.assert_allclose(found, (np.asarray(targets, float) / coefficient) ** (1 / 13), rtol=2e-6)


def test_is_root_counts_units_in_the_last_place(dtype):
    one = jnp.ones((), dtype)
    for target, ulps, expected in [(1.0, 0, True), (1.0, 8, True), (1.0, 9, False), (100.0, 700, True)]:
        value = target * one + ulps * EPSILON[dtype]
        assert bool(newton.is_root(value, target * one, one, 8.0)) is expected
    assert not newton.is_root(jnp.nan * one, one, one)


def test_derivatives(x64):
    x = jnp.linspace(-1, 1, 7)
    for found, expected in zip(newton.derivatives(jnp.sin, x), (jnp.sin(x), jnp.cos(x), -jnp.sin(x)), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-15)


def swirl(points):
    """A deformation of the identity that is not radial: shear, a quadratic term, a rotation that grows outwards."""
    x, y = points[..., 0], points[..., 1]
    angle = 0.3 * (x * x + y * y)
    u, v = x + 0.2 * y + 0.1 * x * y, y - 0.15 * x * x
    return jnp.stack([u * jnp.cos(angle) - v * jnp.sin(angle), u * jnp.sin(angle) + v * jnp.cos(angle)], axis=-1)


def test_value_and_jacobian(x64):
    points = jax.random.normal(jax.random.key(0), (5, 2))
    value, jacobian = jax.jit(lambda x: newton.value_and_jacobian(swirl, x))(points)
    np.testing.assert_allclose(value, swirl(points), rtol=1e-15)
    np.testing.assert_allclose(jacobian, jax.jit(jax.vmap(jax.jacrev(swirl)))(points), rtol=1e-12)
    np.testing.assert_allclose(newton.determinant(jacobian), np.linalg.det(jacobian), rtol=1e-12)


def test_small_systems(x64):
    random = np.random.default_rng(0)
    matrices, right = random.normal(size=(20, 2, 2)), random.normal(size=(20, 2))
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    np.testing.assert_allclose(newton.solve_small(jnp.asarray(matrices), jnp.asarray(right)), expected, rtol=1e-11)
    singular = jnp.asarray([[1.0, 2.0], [2.0, 4.0]])
    np.testing.assert_array_equal(newton.solve_small(singular, jnp.ones(2)), 0)
    np.testing.assert_array_equal(jax.grad(lambda m: newton.solve_small(m, jnp.ones(2)).sum())(singular), 0)


solve_swirl = jax.jit(lambda target: newton.solve_points(swirl, target, target))


def test_plane_roots(dtype):
    ideal = np.random.default_rng(0).uniform(-0.6, 0.6, (500, 2)).astype(dtype)
    target = swirl(ideal)
    found, converged, _ = solve_swirl(target)
    assert found.dtype == dtype
    assert bool(jnp.all(converged))
    np.testing.assert_allclose(found, ideal, atol=30 * EPSILON[dtype])


def fold(points):
    """Folds along x = 1, where it reaches 2/3."""
    x, y = points[..., 0], points[..., 1]
    return jnp.stack([x - x**3 / 3, y + 0.1 * x], axis=-1)


def test_plane_without_root(dtype):
    """What cannot be reached stalls at the fold, is finite, and spoils nothing beside it."""
    target = jnp.asarray([[0.5, 0.1], [0.7, 0.0], [5.0, 1.0], [-0.6, 0.2], [0.66, 0.0]], dtype)
    found, converged, at_fold = jax.jit(lambda target: newton.solve_points(fold, target, 0 * target))(target)
    assert converged.tolist() == [True, False, False, True, True]
    assert at_fold.tolist() == [False, True, True, False, False]
    assert bool(jnp.all(jnp.isfinite(found)))
    assert bool(jnp.all(jnp.abs(found[:, 0]) <= 1))
    np.testing.assert_allclose(fold(found)[np.asarray(converged)], target[np.asarray(converged)], atol=1e-6)


def test_giving_up_is_no_fold(dtype):
    """A target in the gap of a map that jumps: nothing folds, and nothing is found."""

    def jumping(points):
        return jnp.where(points > 0.5, points + 0.25, points)

    target = jnp.asarray([[0.6, 0.1], [0.4, 0.1], [0.9, 0.8]], dtype)
    found, converged, at_fold = jax.jit(lambda target: newton.solve_points(jumping, target, 0 * target))(target)
    assert converged.tolist() == [False, True, True]
    assert not bool(jnp.any(at_fold))
    assert bool(jnp.all(jnp.isfinite(found)))


def test_space_roots(x64):
    """Three dimensions, by the same iteration."""

    def twisted(points):
        x, y, z = (points[..., k] for k in range(3))
        return jnp.stack([x + 0.1 * y * z, y - 0.2 * x * z, z + 0.1 * x * x], axis=-1)

    ideal = np.random.default_rng(1).uniform(-0.8, 0.8, (50, 3))
    found, converged, _ = jax.jit(lambda target: newton.solve_points(twisted, target, target))(twisted(ideal))
    assert bool(jnp.all(converged))
    np.testing.assert_allclose(found, ideal, atol=1e-14)
    matrices = np.random.default_rng(2).normal(size=(20, 3, 3))
    np.testing.assert_allclose(newton.determinant(jnp.asarray(matrices)), np.linalg.det(matrices), rtol=1e-11)
    right = matrices[:, 0]
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    np.testing.assert_allclose(newton.solve_small(jnp.asarray(matrices), jnp.asarray(right)), expected, rtol=1e-10)


def square(x, parameter):
    return x * x - parameter


@jax.jit
def square_root(parameter):
    """With a loop on the way, that nothing is differentiated through."""
    positive = jax.lax.stop_gradient(parameter)
    root = newton.solve_bracketed(lambda x: x * x, positive, positive, jnp.zeros_like(positive), 1 + positive)
    return newton.implicit_root(square, root, parameter)


def test_implicit_derivatives_of_every_order(x64):
    p = jnp.asarray([0.3, 2.0, 50.0])
    np.testing.assert_allclose(square_root(p), np.sqrt(p), rtol=1e-15)
    for mode in (jax.grad, jax.jacfwd):
        once = mode(lambda p: square_root(p).sum())
        twice = mode(lambda p, once=once: once(p).sum())
        thrice = mode(lambda p, twice=twice: twice(p).sum())
        first, second, third = jax.jit(lambda p, fs=(once, twice, thrice): [f(p) for f in fs])(p)
        np.testing.assert_allclose(first, 0.5 * p**-0.5, rtol=1e-14)
        np.testing.assert_allclose(second, -0.25 * p**-1.5, rtol=1e-14)
        np.testing.assert_allclose(third, 0.375 * p**-2.5, rtol=1e-13)


def test_implicit_derivative_at_a_fold_is_zero():
    """Where it would be infinite; the elements beside it keep theirs."""
    gradient = jax.grad(lambda p: newton.implicit_root(square, jnp.sqrt(p), p).sum())(jnp.asarray([0.0, 4.0]))
    np.testing.assert_allclose(gradient, [0.0, 0.25], rtol=1e-6)


def swirl_residual(x, target):
    return swirl(x) - target


@jax.jit
def swirl_inverse(target):
    root, *_ = newton.solve_points(swirl, target, target)
    return newton.implicit_point_root(swirl_residual, root, target)


@pytest.mark.slow
def test_implicit_derivatives_in_the_plane(x64):
    ideal = jnp.asarray([[0.1, 0.2], [-0.4, 0.3], [0.0, 0.0]])
    target = swirl(ideal)
    expected = np.linalg.inv(jax.jit(lambda x: newton.value_and_jacobian(swirl, x)[1])(ideal))
    for mode in (jax.jacrev, jax.jacfwd):
        np.testing.assert_allclose(jax.jit(jax.vmap(mode(swirl_inverse)))(target), expected, rtol=1e-12, atol=1e-14)
    check_grads(swirl_inverse, (target,), order=2, rtol=1e-5, atol=1e-6)


def test_nothing_is_unrolled():
    """The linear part of the inverse's derivative holds no loop."""
    for function, at in ((square_root, jnp.ones(3)), (swirl_inverse, 0.1 * jnp.ones((3, 2)))):
        _, linear = jax.linearize(function, at)
        jaxpr = str(jax.make_jaxpr(linear)(at))
        assert "while" not in jaxpr
        assert "scan" not in jaxpr


def test_batches(x64):
    targets = jnp.linspace(0.1, 3, 12).reshape(3, 4)
    np.testing.assert_allclose(jax.vmap(solve_cubic)(targets), solve_cubic(targets), rtol=1e-15)
    points = swirl(jax.random.uniform(jax.random.key(1), (3, 4, 2), minval=-0.5, maxval=0.5))
    np.testing.assert_allclose(jax.vmap(solve_swirl)(points)[0], solve_swirl(points)[0], atol=1e-15)
    gradient = jax.vmap(jax.grad(lambda p: square_root(p).sum()))(targets)
    np.testing.assert_allclose(gradient, 0.5 / np.sqrt(targets), rtol=1e-14)
