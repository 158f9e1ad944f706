"""The radial lenses of other programs: their formulas, their programs, where they end, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxlens as jl

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

STATUS = jl.InverseStatus
# Ideal radii for a brute-force search.
DENSE = np.concatenate([np.linspace(0, 4, 40_001), np.geomspace(4, 1e9, 12_000)[1:]])


def powers(coefficients, r):
    return np.sum([c * r**i for i, c in enumerate(coefficients)], axis=0)


def random_nodes(random):
    return np.cumsum(random.uniform(0.1, 0.5, 5)), np.cumsum(random.uniform(0.05, 0.5, 5))


# Each from a random generator: a lens, and its formula in radii. Of a lens that is given backwards, that formula.
def field_of_view(random):
    # More would compress the outer radii so much that single precision cannot tell them apart.
    omega = random.choice([-1, 1]) * random.uniform(0.01, 2.4)
    return jl.FieldOfView(omega), lambda r: np.arctan(2 * r * np.tan(omega / 2)) / omega


def poly3(random):
    k1 = random.uniform(-0.4, 0.4)
    return jl.Poly3(k1), lambda r: r * (1 - k1 + k1 * r**2)


def poly5(random):
    k1, k2 = random.uniform(-0.5, 0.5, 2)
    return jl.Poly5(k1, k2), lambda r: r * (1 + k1 * r**2 + k2 * r**4)


def pt_lens(random):
    a, b, c = random.uniform(-0.25, 0.25, 3)
    return jl.PtLens(a, b, c), lambda r: r * (a * r**3 + b * r**2 + c * r + 1 - a - b - c)


def barrel(random):
    a, b, c, d = [*random.uniform(-0.3, 0.3, 3), random.uniform(0.7, 1.3)]
    return jl.Barrel(a, b, c, d=d), lambda r: r * (a * r**3 + b * r**2 + c * r + d)


def barrel_inverse(random):
    a, b, c, d = [*random.uniform(-0.3, 0.3, 3), random.uniform(0.7, 1.3)]
    return jl.BarrelInverse(a, b, c, d=d), lambda r: r / np.maximum(a * r**3 + b * r**2 + c * r + d, 0)


def radial_powers(random):
    k = [random.uniform(0.7, 1.3), *random.uniform(-0.2, 0.2, 4)]
    return jl.RadialPowers(k), lambda r: r * powers(k, r)


def radial_powers_inverse(random):
    k = [random.uniform(0.7, 1.3), *random.uniform(-0.2, 0.2, 4)]
    return jl.RadialPowersInverse(k), lambda r: r * powers(k, r)


def splined(random):
    nodes, values = random_nodes(random)
    return jl.SplinedRadial(nodes, values), lambda r: pieces(nodes, values, r)


def pieces(nodes, values, r):
    """SciPy's PCHIP inside, and both ends without curvature."""
    interpolate = pytest.importorskip("scipy.interpolate")
    x, y = np.append(0, nodes), np.append(0, values)
    slopes = interpolate.PchipInterpolator(x, y).derivative()(x)
    secants = np.diff(y) / np.diff(x)
    slopes[0], slopes[-1] = (3 * secants[0] - slopes[1]) / 2, (3 * secants[-1] - slopes[-2]) / 2
    inside = interpolate.CubicHermiteSpline(x, y, slopes)(np.minimum(r, x[-1]))
    return inside + slopes[-1] * np.maximum(r - x[-1], 0)


MODELS = [
    field_of_view,
    poly3,
    poly5,
    pt_lens,
    barrel,
    barrel_inverse,
    radial_powers,
    radial_powers_inverse,
    splined,
]
BACKWARDS = [radial_powers_inverse]


def end_of(radius):
    """The radius at which a function of radii stops rising, by looking, and its value there."""
    with np.errstate(divide="ignore", invalid="ignore"):
        values = radius(DENSE)
        falls = ~(np.diff(values) >= 0)  # true, too, beyond a pole
    if not falls.any():
        return np.inf, values[-1]
    first = int(np.argmax(falls))
    return DENSE[first], values[first]


def on_rays(radii, random):
    angle = random.uniform(0, 2 * np.pi, len(radii))
    return np.stack([radii * np.cos(angle), radii * np.sin(angle)], -1)


def norm(points):
    return np.linalg.norm(np.asarray(points, float), axis=-1)


def check(model, random, dtype, count):
    """A lens against its formula, its own inverse, and a search for its end that knows nothing but the formula."""
    lens, radius = model(random)
    end, value = end_of(radius)
    backwards = model in BACKWARDS
    lens = jax.tree.map(lambda leaf: leaf.astype(dtype), lens)
    forth, back = (lens.undistort, lens.distort) if backwards else (lens.distort, lens.undistort)
    given = on_rays(random.uniform(0, min(1.5, 0.95 * end), count), random).astype(dtype)
    made = forth(given)
    if dtype == "float64":
        np.testing.assert_allclose(norm(made), radius(norm(given)), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(back(made), given, rtol=0, atol={"float32": 5e-6, "float64": 1e-12}[dtype])
    ideal, observed = (made, given) if backwards else (given, made)
    assert bool(lens.one_to_one(ideal).all())
    found = lens.invert(observed)
    assert bool(found.valid.all())
    np.testing.assert_allclose(found.points, ideal, rtol=0, atol={"float32": 5e-6, "float64": 1e-12}[dtype])
    # Where it ends: to the width of the search, in the argument, and to its square in the value.
    fold, edge = (value, end) if backwards else (end, value)
    tested = random.uniform(0, 2.5, count)
    tested = tested[np.abs(tested / edge - 1) > 2e-3]
    found = lens.invert(on_rays(tested, random).astype(dtype))
    np.testing.assert_array_equal(found.valid, tested < edge)
    assert set(np.unique(found.status)) <= {STATUS.CONVERGED, STATUS.NO_PREIMAGE}
    assert bool(jnp.isfinite(found.points).all())
    tested = random.uniform(0, 2.5, count)
    tested = tested[np.abs(tested / fold - 1) > 2e-3]
    points = on_rays(tested, random).astype(dtype)
    np.testing.assert_array_equal(lens.one_to_one(points), tested < fold)
    if backwards:
        np.testing.assert_array_equal(np.isfinite(lens.distort(points)).all(-1), tested < fold)


@pytest.mark.parametrize("model", [field_of_view, splined])
def test_a_lens_is_its_formula_and_ends_where_it_does(x64, model):
    """All of them are below."""
    random = np.random.default_rng(0)
    for _ in range(4):
        check(model, random, "float64", 500)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_ten_thousand_points_of_twenty_lenses(dtype, model):
    random = np.random.default_rng(1)
    with jax.enable_x64(True):
        for _ in range(20):
            check(model, random, dtype, 10_000)


def splined_angle(random):
    return jl.SplinedAngle(*random_nodes(random)), None


def division(random):
    return jl.Division(random.uniform(-0.3, 0.3, 3)), None


@pytest.mark.slow
@pytest.mark.parametrize("model", [*MODELS, division, splined_angle])
def test_first_and_second_derivatives(x64, model):
    """By points and by parameters, against differences."""
    lens, _ = model(np.random.default_rng(5))
    points = jnp.asarray([[0.11, 0.2], [-0.31, 0.14], [1e-3, 2e-3]])
    check_grads(lambda lens, points: lens.distort(points), (lens, points), 2, rtol=2e-5, atol=2e-5)
    observed = lens.distort(points)
    check_grads(lambda lens, points: lens.invert(points).points, (lens, observed), 2, rtol=2e-5, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("model", [*MODELS, division, splined_angle])
def test_derivatives_are_finite_everywhere(x64, model):
    """At the centre, beyond the edge, and where a point is none; of pictures' sums as well."""
    lens, _ = model(np.random.default_rng(5))
    points = jnp.asarray([[0.0, 0.0], [0.3, 0.2], [30.0, 50.0], [jnp.nan, 1.0], [jnp.inf, 0.0]])

    def total(lens, points):
        found = lens.invert(points)
        return jnp.sum(found.points * found.valid[:, None]) + jnp.nansum(lens.undistort(points))

    for derivative in (jax.grad(total, (0, 1)), jax.jacfwd(total, (0, 1)), jax.hessian(total, (0, 1))):
        for leaf in jax.tree.leaves(derivative(lens, points)):
            assert bool(jnp.all(jnp.isfinite(leaf)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lens", "scale"),
    [(jl.PtLens(0.1, -0.05, 0.2), 0.75), (jl.RadialPowersInverse([0.8, 0.3, -0.1]), 1.25), (jl.FieldOfView(0.0), 1.0)],
)
def test_the_centre_of_odd_powers(x64, lens, scale):
    lens, centre = jax.tree.map(lambda leaf: leaf.astype(float), lens), jnp.zeros(2)
    np.testing.assert_allclose(lens.jacobian(centre), scale * np.eye(2), rtol=1e-7, atol=0)
    inverse = jax.jacfwd(lambda points: lens.invert(points).points)(centre)
    np.testing.assert_allclose(inverse, np.eye(2) / scale, rtol=1e-7, atol=0)
    second = jax.hessian(lambda points: lens.invert(points).points)(centre)
    np.testing.assert_array_equal(second, 0)


@pytest.mark.slow
def test_a_field_of_view_of_nothing_is_the_identity(x64):
    points = np.random.default_rng(2).uniform(-1, 1, (50, 2))
    np.testing.assert_array_equal(jl.FieldOfView(0.0).distort(points), points)
    np.testing.assert_array_equal(jl.FieldOfView(0.0).undistort(points), points)
    # The derivative by ω vanishes there, and the second one is that of 1 + ω² / 12 − ω² r² / 3.
    by_omega = jax.jacfwd(lambda omega: jl.FieldOfView(omega).distort(points))
    np.testing.assert_array_equal(by_omega(0.0), 0)
    squared = (points**2).sum(-1, keepdims=True)
    np.testing.assert_allclose(jax.jacfwd(by_omega)(0.0), points * (1 / 6 - 2 * squared / 3), rtol=1e-13, atol=1e-16)
    assert float(jl.FieldOfView(2.0).edge_radius()) == pytest.approx(np.pi / 4)
    lost = jl.FieldOfView(3.5).invert(points)
    assert not bool(lost.valid.any())
    assert bool(jnp.isfinite(lost.points).all())


@pytest.mark.slow
def test_a_spline_may_stop_rising_in_the_course_of_a_fit(x64):
    lens = jl.SplinedRadial([0.3, 0.6, 0.9], [0.3, 0.5, 0.8])
    assert float(lens.fold_radius()) == np.inf
    folded = jax.tree.map(lambda leaf: jnp.where(leaf == 0.8, 0.4, leaf), lens)
    assert float(folded.fold_radius()) == 0.6
    assert float(folded.edge_radius()) == pytest.approx(0.5)
    assert folded.invert(jnp.asarray([[0.49, 0.0], [0.51, 0.0]])).valid.tolist() == [True, False]
    assert lens.adjustable().nodes is False
    assert lens.adjustable().values is True


def test_the_identities(x64):
    points = np.random.default_rng(3).uniform(-0.7, 0.7, (20, 2))
    kinds = (jl.Poly3, jl.Poly5, jl.PtLens, jl.Barrel, jl.BarrelInverse, jl.RadialPowers, jl.RadialPowersInverse)
    for kind in (*kinds, jl.SplinedRadial, jl.Division):
        np.testing.assert_allclose(kind.identity().distort(points), points, rtol=1e-15)
    assert jl.Division.identity().k.shape == ()
    assert jl.Division.identity(terms=3).k.shape == (3,)


def test_one_program_serves_all_lenses_of_a_family(x64):
    traces = []

    @jax.jit
    def undistort(lens, points):
        traces.append(type(lens))
        return lens.undistort(points)

    points = np.random.default_rng(4).uniform(-0.3, 0.3, (10, 2))
    for lens in (jl.PtLens(0.1, 0.0, 0.0), jl.PtLens(0.0, 0.1, -0.2), jl.FieldOfView(0.0), jl.FieldOfView(1.0)):
        undistort(lens, points)
    assert traces == [jl.PtLens, jl.FieldOfView]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jl.PtLens(0.5, 0.5, 0.1), r"scales by 1 − a − b − c at its centre.*positive, got -0\.1"),
        (lambda: jl.Poly3(1.5), "scales by 1 − k1"),
        (lambda: jl.Barrel(0.0, 0.0, 0.0, d=0.0), "scales by d"),
        (lambda: jl.RadialPowers([-1.0, 0.1]), "scales by k0"),
        (lambda: jl.RadialPowers([]), "at least the first of them"),
        (lambda: jl.Poly5(np.zeros(2), 0.0), r"k1 must be a number, got shape \(2,\)"),
        (lambda: jl.SplinedRadial([0.5, 0.4], [0.1, 0.2]), "nodes of SplinedRadial rise from above zero"),
        (lambda: jl.SplinedAngle([0.5, 0.6], [0.0, 0.2]), "values of SplinedAngle rise from above zero"),
        (lambda: jl.SplinedRadial([0.5], [0.1, 0.2]), "two lists of the same length"),
    ],
)
def test_what_is_no_lens(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.slow
@pytest.mark.parametrize(
    "ks",
    [
        ([0.3], [-0.2]),
        ([0.3, 0.1], [0.3, -0.1], [0.0, 0.0]),
        ([0.6, 0.0, -0.01], [-0.05, 0.05, -0.02]),
    ],
)
def test_division_of_any_order_is_its_formula(x64, ks):
    """And passes through a right angle, up to where two points would have one ray."""
    random = np.random.default_rng(6)
    for k in ks:
        lens = jl.Division(k, center=[0.05, -0.1])
        radii = np.linspace(0, 3, 30_001)
        depth = 1 - radii**2 * powers(k, radii**2)
        angles = np.arctan2(radii, depth)
        turns_back = np.diff(angles) <= 0
        last = radii[np.argmax(turns_back)] if turns_back.any() else np.inf
        given = random.uniform(0, 2.5, 400)
        given = given[np.abs(given / last - 1) > 2e-3]
        offsets = on_rays(given, random)
        z = 1 - given**2 * powers(k, given**2)
        expected = np.concatenate([offsets + np.outer(z, [0.05, -0.1]), z[:, None]], -1)
        expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
        observed = offsets + np.array([0.05, -0.1])
        found = lens.invert_projection(observed)
        np.testing.assert_array_equal(found.valid, given < last)
        np.testing.assert_allclose(found.points[given < last], expected[given < last], rtol=0, atol=1e-13)
        seen = lens.project(7 * expected)
        inside = given < 0.98 * last
        np.testing.assert_allclose(seen[inside], observed[inside], rtol=0, atol=1e-12)
        # The plane has those with z > 0.
        flat = lens.invert(observed)
        np.testing.assert_array_equal(flat.valid, (given < last) & (z > 0))
        near = flat.valid & (z > 0.1)
        np.testing.assert_allclose(flat.points[near], (expected[:, :2] / expected[:, 2:])[near], rtol=1e-12)
        np.testing.assert_allclose(lens.distort(flat.points[near & inside]), observed[near & inside], atol=1e-12)


@pytest.mark.slow
def test_division_by_a_list_of_one_is_that_by_the_number(x64):
    random = np.random.default_rng(7)
    rays = random.normal(size=(100, 3))
    for k in (0.3, -0.2):
        number, one = jl.Division(k), jl.Division([k])
        np.testing.assert_allclose(one.project(rays), number.project(rays), rtol=1e-12)
        assert float(one.fold_radius()) == pytest.approx(float(number.fold_radius()), rel=1e-15)
        assert float(one.edge_radius()) == pytest.approx(float(number.edge_radius()), rel=1e-15)
        assert float(one.field_of_view()) == pytest.approx(float(number.field_of_view()), rel=1e-15)


@pytest.mark.parametrize("k", [0.3, pytest.param([0.2, 0.05], marks=pytest.mark.slow)])
def test_division_is_smooth_through_a_right_angle(x64, k):
    lens = jl.Division(k)
    rays = jnp.asarray([[1.0, 0.5, 0.0], [1.0, 0.5, 1e-9], [1.0, 0.5, -1e-9], [0.8, -0.6, -0.5], [0.0, 0.0, 1.0]])
    check_grads(lambda lens, rays: lens.project(rays), (lens, rays), 1, eps=1e-6, rtol=1e-6, atol=1e-6)
    forward, reverse = (derive(lens.project)(rays) for derive in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, atol=1e-13)
    assert bool(jnp.isfinite(jax.hessian(lens.project)(rays[0])).all())
    assert float(lens.field_of_view()) == np.pi
    assert float(jl.Division(-0.25).field_of_view()) == pytest.approx(np.pi / 4)
    assert float(jl.Division(0.0).field_of_view()) == float(jl.Division([0.0]).field_of_view()) == np.pi / 2
