"""Free-form deformation: identity, Eq. 4 by exact fractions and by scipy, freezing, inverses, derivatives, failures."""

from fractions import Fraction
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BPoly

import jaxlens as jl
from jaxlens.deformations import FreeForm

LOWER, UPPER = np.array([-1.0, 2.0]), np.array([3.0, 5.0])
UNIT = np.random.default_rng(0).uniform(0, 1, (100, 2))
POINTS = LOWER + UNIT * (UPPER - LOWER)
AROUND = LOWER + (1.6 * UNIT - 0.3) * (UPPER - LOWER)
# Lattices whose sums are written out, and ones that go by a product of matrices.
degrees = pytest.mark.parametrize("degree", [(3, 2), (6, 7), (20, 20)], ids=str)


def deformed(m, n, *, spread=0.08, weighted=True, seed=1):
    """A lattice moved by some of its spacing, of any degree about as strongly."""
    random = np.random.default_rng(seed)
    lattice = np.asarray(FreeForm.identity(m, n, lower=LOWER, upper=UPPER).control_points)
    moved = lattice + spread * random.normal(size=lattice.shape) / np.sqrt(max(m, n) / 3)
    weights = np.exp(0.5 * random.normal(size=(m + 1, n + 1))) if weighted else None
    return FreeForm(moved, weights=weights, lower=LOWER, upper=UPPER)


def exactly(mapping, point):
    """Eq. 4 in fractions, of the very numbers that the floats are."""
    control, weights = np.asarray(mapping.control_points), np.asarray(mapping.weights)
    m, n = (size - 1 for size in weights.shape)
    low, high = ([Fraction(float(v)) for v in corner] for corner in (mapping.lower, mapping.upper))
    s, t = ((Fraction(float(v)) - low[k]) / (high[k] - low[k]) for k, v in enumerate(point))
    across = [comb(m, i) * s**i * (1 - s) ** (m - i) for i in range(m + 1)]
    down = [comb(n, j) * t**j * (1 - t) ** (n - j) for j in range(n + 1)]
    total = [Fraction(0)] * 3
    for i in range(m + 1):
        for j in range(n + 1):
            share = across[i] * down[j] * Fraction(float(weights[i, j]))
            for k, value in enumerate(Fraction(float(v)) for v in control[i, j]):
                total[k] += share * value
            total[2] += share
    return [float(total[0] / total[2]), float(total[1] / total[2])]


@pytest.mark.parametrize("degree", range(1, 11))
def test_the_regular_lattice_is_the_identity(x64, degree):
    """Every degree up to 20, to the last bit, with equal weights of any value."""
    lattice = FreeForm.identity(degree, 21 - degree, lower=LOWER, upper=UPPER)
    evenly = FreeForm(lattice.control_points, weights=np.full((degree + 1, 22 - degree), 3.7), lower=LOWER, upper=UPPER)
    with jax.disable_jit():
        np.testing.assert_array_equal(lattice(AROUND), AROUND)
        np.testing.assert_array_equal(evenly(AROUND), AROUND)


def test_the_regular_lattice_as_numpy_makes_it(x64):
    axes = [np.linspace(LOWER[k], UPPER[k], size) for k, size in enumerate((21, 14))]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    np.testing.assert_allclose(FreeForm(lattice, lower=LOWER, upper=UPPER)(POINTS), POINTS, rtol=0, atol=4e-15)


@degrees
def test_equation_4_in_exact_arithmetic(x64, degree):
    mapping = deformed(*degree)
    expected = [exactly(mapping, point) for point in POINTS[:12]]
    np.testing.assert_allclose(mapping(POINTS)[:12], expected, rtol=0, atol=4e-15)


def test_weights_of_any_size(x64):
    """Across twelve orders of magnitude: where a small weight alone is near, the large ones must not drown it."""
    still = FreeForm.identity(4, 3, lower=LOWER, upper=UPPER)
    weights = 10.0 ** np.random.default_rng(3).uniform(-6, 6, (5, 4))
    mapping = FreeForm(still.control_points, weights=weights, lower=LOWER, upper=UPPER)
    corners = np.array([LOWER, UPPER, [LOWER[0], UPPER[1]], LOWER + 1e-6 * (UPPER - LOWER)])
    points = np.concatenate([corners, POINTS[:20]])
    expected = [exactly(mapping, point) for point in points]
    np.testing.assert_allclose(mapping(points), expected, rtol=0, atol=4e-15)
    assert np.max(np.abs(mapping(POINTS) - POINTS)) > 0.5, (
        "unequal weights are no identity, though the lattice is regular"
    )


@degrees
def test_scipy_s_bernstein_polynomials(x64, degree):
    """Row by row: a BPoly in s for each j, whose values are the coefficients of one in t."""
    mapping = deformed(*degree)
    weights = np.asarray(mapping.weights)[..., None]
    homogeneous = np.concatenate([weights * mapping.control_points, weights], axis=-1)
    rows = BPoly(homogeneous[:, None], [0, 1])(UNIT[:, 0])
    values = np.stack([BPoly(row[:, None], [0, 1])(t) for row, t in zip(rows, UNIT[:, 1], strict=True)])
    np.testing.assert_allclose(mapping(POINTS), values[:, :2] / values[:, 2:], rtol=0, atol=1e-12)


def test_points_outside_stay_and_the_border_belongs_to_the_rectangle(x64):
    mapping = deformed(3, 2)
    inside = np.asarray(mapping.contains(AROUND))
    assert 0.3 < inside.mean() < 0.6
    np.testing.assert_array_equal(mapping(AROUND)[~inside], AROUND[~inside])
    corners = np.array([LOWER, [UPPER[0], LOWER[1]], UPPER, [LOWER[0], UPPER[1]]])
    control = np.asarray(mapping.control_points)
    np.testing.assert_allclose(mapping(corners), control[[0, -1, -1, 0], [0, 0, -1, -1]], rtol=0, atol=2e-15)
    np.testing.assert_array_equal(mapping(np.nextafter(corners[::2], [-9, -9])[:1]), np.nextafter(LOWER, -9)[None])
    assert np.isnan(mapping(np.array([[np.nan, 3.0]]))).any()


def test_single_precision(dtype):
    """Errors are those of the displacement, not of the position."""
    still = FreeForm.identity(3, 3, lower=np.asarray([1000, 2000], dtype), upper=np.asarray([1512, 2512], dtype))
    points = (1000 * np.array([1.0, 2.0]) + 512 * UNIT).astype(dtype)
    np.testing.assert_array_equal(still(points), points)
    moved = FreeForm(
        still.control_points.at[1, 2].add(8.0), weights=still.weights, lower=still.lower, upper=still.upper
    )
    assert moved(points).dtype == dtype
    s, t = (np.float64(points) - [1000, 2000]).T / 512
    expected = 8 * 9 * s * (1 - s) ** 2 * t**2 * (1 - t)
    np.testing.assert_allclose(moved(points)[:, 0] - points[:, 0], expected, rtol=0, atol=2 * np.spacing(points.max()))


@jax.jit
def series(mapping, start, inward):
    """The displacement at a point of the border, and its first three derivatives along a normal."""

    def along(distance):
        return mapping(start + distance * inward) - start - distance * inward

    first = jax.jacfwd(along)
    second = jax.jacfwd(first)
    return [order(0.0) for order in (along, first, second, jax.jacfwd(second))]


@pytest.mark.slow
@pytest.mark.parametrize(("continuity", "sides"), [(0, None), (1, None), (2, ("left", "top")), (2, None)])
def test_freezing_joins_derivatives_across_the_border(x64, continuity, sides):
    """Along a normal of each side, Taylor's series of the displacement begins after the order that is frozen."""
    names = ("left", "right", "top", "bottom")
    mapping = deformed(7, 8, spread=0.3)
    frozen = mapping.freeze(continuity) if sides is None else mapping.freeze(continuity, sides=sides)
    middle = 0.4 * LOWER + 0.6 * UPPER

    def normal(side):
        axis, corner = divmod(names.index(side), 2)
        inward = np.zeros(2)
        inward[axis] = 1 - 2 * corner
        start = middle.copy()
        start[axis] = (LOWER, UPPER)[corner][axis]
        return jnp.asarray(start), jnp.asarray(inward)

    for side in names:
        sizes = [float(jnp.max(jnp.abs(order))) for order in series(frozen, *normal(side))]
        joined = continuity + 1 if sides is None or side in sides else 0
        assert max(sizes[:joined], default=0) <= 1e-10, (side, sizes)
        assert min(sizes[joined:]) > 1e-3, (side, sizes)
    assert np.asarray(frozen.frozen(continuity, sides=sides or names)).sum() < 72


def test_freezing_puts_weights_back(x64):
    mapping = deformed(4, 5)
    frozen = mapping.freeze(0, sides=["right"])
    rows = mapping.frozen(0, sides=["right"])
    assert rows.sum() == 6
    assert rows[-1].all()
    np.testing.assert_array_equal(frozen.weights, np.where(rows, 1, mapping.weights))
    still = FreeForm.identity(4, 5, lower=LOWER, upper=UPPER)
    np.testing.assert_array_equal(
        frozen.control_points, np.where(rows[..., None], still.control_points, mapping.control_points)
    )


@degrees
@pytest.mark.slow
def test_round_trip(x64, degree):
    """Inside, outside, and on the border: the inverse of a lattice with a border that stays."""
    mapping = deformed(*degree, spread=0.1)
    smooth = mapping.freeze(0)
    inside, around = POINTS.copy(), AROUND.copy()
    inside[:4] = around[:4] = [LOWER, UPPER, [LOWER[0], UPPER[1]], [LOWER[0], 3.5]]
    for lattice, points in ((mapping, inside), (smooth, around)):
        assert float(lattice.jacobian_determinant(POINTS).min()) > 0.1
        inverse = lattice.invert(lattice(points))
        assert bool(inverse.valid.all())
        np.testing.assert_allclose(inverse.points, points, rtol=0, atol=1e-12)


def test_round_trip_of_strong_deformations(x64):
    """A rectangle turned, stretched and carried away; unequal weights."""
    still = FreeForm.identity(3, 2, lower=LOWER, upper=UPPER)
    turn = np.array([[0.1, -1.0], [1.2, 0.3]])
    moved = np.asarray(deformed(3, 2).control_points) @ turn.T + np.array([40.0, -7.0])
    mapping = FreeForm(
        moved, weights=10.0 ** np.random.default_rng(4).uniform(-1, 1, (4, 3)), lower=still.lower, upper=still.upper
    )
    inverse = mapping.invert(mapping(POINTS))
    assert bool(inverse.valid.all())
    np.testing.assert_allclose(inverse.points, POINTS, rtol=0, atol=1e-10)


def test_what_has_no_preimage(x64):
    """A lattice drawn in by half about the middle: a gap at the border, and nothing else changes outside."""
    still = FreeForm.identity(3, 2, lower=LOWER, upper=UPPER)
    lattice, middle = np.asarray(still.control_points), 0.5 * (LOWER + UPPER)
    shrunk = FreeForm(middle + 0.5 * (lattice - middle), weights=np.ones((4, 3)), lower=LOWER, upper=UPPER)
    shares = np.array([0.2, 0.499, 0.501, 0.9, 1.01, 1.5])
    targets = middle + shares[:, None] * (UPPER - middle)
    targets = np.concatenate([targets, [[np.nan, 0.0]]])
    targets = np.concatenate([targets, np.zeros((93, 2))])
    inverse = jax.tree.map(lambda leaf: leaf[:7], shrunk.invert(targets))
    status = jl.InverseStatus
    assert inverse.valid.tolist() == [True, True, False, False, True, True, False]
    assert inverse.status.tolist() == [0, 0, status.NO_PREIMAGE, status.NO_PREIMAGE, 0, 0, status.NOT_FINITE]
    expected = middle + np.array([0.4, 0.998, 1, 1, 1.01, 1.5])[:, None] * (UPPER - middle)
    np.testing.assert_allclose(inverse.points[:6], expected, rtol=0, atol=1e-12)
    assert bool(jnp.isfinite(inverse.points).all())
    # Drawn out, it covers points that stay: the preimage is the one in the rectangle.
    grown = FreeForm(middle + 2 * (lattice - middle), weights=np.ones((4, 3)), lower=LOWER, upper=UPPER)
    inverse = jax.tree.map(lambda leaf: leaf[:7], grown.invert(targets))
    assert inverse.valid.tolist() == [True] * 6 + [False]
    np.testing.assert_allclose(inverse.points[:6], 0.5 * (middle + targets[:6]), rtol=0, atol=1e-12)
    assert bool(grown.one_to_one(POINTS).all())
    mirrored = FreeForm(lattice[::-1], weights=np.ones((4, 3)), lower=LOWER, upper=UPPER)
    assert not bool(mirrored.one_to_one(POINTS).any())


@pytest.mark.slow
@pytest.mark.parametrize("degree", [(3, 2), (20, 20)], ids=str)
def test_derivatives(x64, degree):
    """By point, control points and weights: forward, reverse, and differences; of the inverse what they imply."""
    mapping = deformed(*degree)
    points = jnp.asarray(POINTS[:3])
    random = np.random.default_rng(5)
    leaves = (mapping.control_points, mapping.weights, points)
    direction = tuple(jnp.asarray(random.normal(size=leaf.shape)) for leaf in leaves)
    cotangent = random.normal(size=points.shape)

    def evaluate(control_points, weights, points):
        return FreeForm(control_points, weights=weights, lower=LOWER, upper=UPPER)(points)

    value, forward = jax.jvp(evaluate, leaves, direction)
    _, pull = jax.vjp(evaluate, *leaves)
    reverse = sum(np.sum(a * b) for a, b in zip(pull(jnp.asarray(cotangent)), direction, strict=True))
    np.testing.assert_allclose(reverse, np.sum(cotangent * forward), rtol=1e-12)
    step = 1e-6
    moved = [
        evaluate(*(leaf + sign * step * change for leaf, change in zip(leaves, direction, strict=True)))
        for sign in (1, -1)
    ]
    np.testing.assert_allclose(forward, (moved[0] - moved[1]) / (2 * step), rtol=0, atol=1e-8)

    if degree != (3, 2):
        return

    def inverse(control_points, weights, points):
        return FreeForm(control_points, weights=weights, lower=LOWER, upper=UPPER).invert(points).points

    _, found = jax.jvp(inverse, (*leaves[:2], value), direction)
    _, change = jax.jvp(lambda *lattice: evaluate(*lattice, points), leaves[:2], direction[:2])
    implied = np.linalg.solve(mapping.jacobian(points), np.asarray(direction[2] - change)[..., None])[..., 0]
    np.testing.assert_allclose(found, implied, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_gradients_where_nothing_counts_are_finite(x64):
    mapping = deformed(3, 2)
    points = jnp.array([[np.nan, 1.0], [1e300, 3.0], LOWER, UPPER, [99.0, 99.0]])

    def total(mapping, points):
        return jnp.nansum(mapping(points)) + jnp.sum(mapping.invert(points).points)

    by_lattice, by_points = jax.jit(jax.grad(total, argnums=(0, 1)))(mapping, points)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(by_lattice))
    assert bool(jnp.isfinite(by_points).all())


@pytest.mark.slow
def test_batches(x64):
    lattices = np.stack([np.asarray(deformed(3, 2, seed=seed).control_points) for seed in range(3)])
    weights = np.stack([np.asarray(deformed(3, 2, seed=seed).weights) for seed in range(3)])
    maps = jax.vmap(lambda control, weights: FreeForm(control, weights=weights, lower=LOWER, upper=UPPER))(
        lattices, weights
    )
    found = jax.jit(jax.vmap(lambda mapping: mapping.invert(mapping(POINTS)).points))(maps)
    np.testing.assert_allclose(found, np.broadcast_to(POINTS, found.shape), rtol=0, atol=1e-12)
    one = deformed(3, 2)
    assert one(jnp.zeros((0, 2))).shape == (0, 2)
    assert one(jnp.zeros((2, 1, 2))).shape == (2, 1, 2)
    assert one(jnp.zeros(2)).shape == (2,)


def test_what_a_fit_adjusts():
    mask = FreeForm(np.zeros((3, 4, 2)), weights=np.ones((3, 4))).adjustable()
    assert (mask.control_points, mask.weights, mask.lower, mask.upper) == (True, False, False, False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"control_points": np.zeros((3, 2))}, r"shape \(m \+ 1, n \+ 1, 2\).*got \(3, 2\)"),
        ({"control_points": np.zeros((1, 4, 2))}, "degrees m and n of one or more"),
        ({"weights": np.ones((3, 4))}, r"weights must have shape \(3, 3\).*got \(3, 4\)"),
        ({"weights": np.eye(3)}, r"weights must be positive and finite, got 0.0 at \[0, 1\]"),
        ({"weights": np.full((3, 3), np.inf)}, "positive and finite, got inf"),
        ({"lower": (0, 2)}, "is empty"),
        ({"upper": (1, 2, 3)}, r"upper must be one corner.*got shape \(3,\)"),
    ],
)
def test_misuse(arguments, message):
    with pytest.raises(ValueError, match=message):
        FreeForm(**({"control_points": np.zeros((3, 3, 2))} | arguments))


@pytest.mark.parametrize(
    ("continuity", "sides", "message"),
    [
        (1, ("left", "right"), r"freezes all.*degrees \(3, 4\).*at least 4"),
        (2, ("left", "right", "top", "bottom"), "freezes all"),
        (4, ("top",), "freezes all"),
        (-1, ("top",), "0 or more, got -1"),
        (0, ("front",), "left, right, top, bottom; got 'front'"),
    ],
)
@pytest.mark.usefixtures("untyped")
def test_freezing_too_much(continuity, sides, message):
    with pytest.raises(ValueError, match=message):
        FreeForm.identity(3, 4).freeze(continuity, sides=sides)
