import beartype.roar
import cv2
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

import jaxlens as jl

EPSILON = {"float32": 2.0**-23, "float64": 2.0**-52}
FOCAL, WIDTH, HEIGHT = 500.0, 640, 480


@pytest.fixture
def _untyped():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@jax.jit
def invert(coefficients, points):
    lens = jl.RadialPolynomial(coefficients)
    return lens.invert(points), lens.fold_radius(), lens.edge_radius()


@jax.jit
def invert_many(coefficients, points):
    return jax.vmap(invert)(coefficients, points)


def points_at(radius, angle):
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


# The reference: extended precision, and roots by numpy.roots.


def length(points):
    return np.hypot(*np.moveaxis(np.asarray(points, np.longdouble), -1, 0))


def observed_radius(coefficients, radius):
    total, squared = np.zeros_like(radius), radius * radius
    for coefficient in np.asarray(coefficients, np.longdouble)[::-1]:
        total = (total + coefficient) * squared
    return radius * (1 + total)


def reference_fold(coefficients):
    """The first positive root of odd order of 1 + 3 κ₁ s + 5 κ₂ s² + …, as a radius."""
    slopes = (2 * np.arange(1, len(coefficients) + 1) + 1) * np.asarray(coefficients, float)
    roots = np.roots(np.trim_zeros([*slopes[::-1], 1.0], "f"))
    real = np.sort(roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real)
    return np.sqrt(real[0]) if len(real) else np.inf


def check_inverse(coefficients, points, result):
    """Everything that `invert` promises of one lens, against the extended-precision lens itself.

    A preimage is right if a point within ten units in the last place of it is mapped to within ten units of the
    point that was asked for, units of the largest term of the polynomial: no arithmetic of this precision can do
    better by more than that factor.
    """
    inverse, fold, edge = jax.tree.map(np.asarray, result)
    epsilon = np.finfo(inverse.points.dtype).eps
    fold, few = np.longdouble(fold), 10 * np.longdouble(epsilon)
    asked, found = length(points), length(inverse.points)
    assert np.isfinite(inverse.points).all()

    # Valid exactly where the radius does not exceed that of the fold, seen through the lens.
    if np.isfinite(fold):
        limit = observed_radius(coefficients, fold)
        doubt = epsilon * observed_radius(np.abs(coefficients), fold)
        assert abs(edge - limit) <= doubt
    else:
        limit, doubt = np.inf, 0
        assert np.isinf(edge)
    decided = (asked < limit - doubt) | (asked > limit + doubt)
    np.testing.assert_array_equal(inverse.valid[decided], (asked <= limit)[decided])
    expected = np.where(inverse.valid, jl.InverseStatus.CONVERGED, jl.InverseStatus.NO_PREIMAGE)
    np.testing.assert_array_equal(inverse.status, expected)

    # Within the fold, on the ray of the point, and a preimage where it says so.
    assert np.all(found <= fold * (1 + 2 * epsilon))
    np.testing.assert_allclose(found[~inverse.valid], fold, rtol=2 * epsilon)
    across = inverse.points[..., 0] * points[..., 1].astype(float) - inverse.points[..., 1] * points[..., 0]
    assert np.all(np.abs(across) <= few * found * asked)
    at, r = found[inverse.valid], asked[inverse.valid]
    rounding = few * observed_radius(np.abs(coefficients), at)
    below = observed_radius(coefficients, at * (1 - few))
    above = np.maximum(observed_radius(coefficients, np.minimum(at * (1 + few), fold)), below)
    assert np.all(r >= below - rounding)
    assert np.all(r <= np.maximum(above, observed_radius(coefficients, at)) + rounding)

    # Farther points have farther preimages, to the same rounding.
    order = np.argsort(r)
    assert np.all(np.diff(at[order]) >= -few * at[order][1:] - 2 * _uncertainty(coefficients, at[order][1:], rounding))


def _uncertainty(coefficients, radius, rounding):
    """How far a radius may be off where the observed one is off by rounding: much, where the slope is nearly zero."""
    slopes = (2 * np.arange(1, len(coefficients) + 1) + 1) * np.asarray(coefficients, np.longdouble)
    slope = observed_radius(slopes, radius) / np.where(radius > 0, radius, 1)
    return np.where(slope > 0.1, rounding / np.maximum(slope, 0.1), np.inf)


# Closed forms.


def test_the_formula(dtype):
    """Eq. 9 at r = ½: Φ = 1 + κ1/4 + κ2/16 + κ3/64, all exact in binary."""
    lens = jl.RadialPolynomial([1.0, -2.0, 4.0])
    observed = lens.distort(jnp.asarray([[0.5, 0.0], [0.0, -0.5], [0.3, 0.4], [0.0, 0.0]], dtype))
    phi = 1 + 1 / 4 - 2 / 16 + 4 / 64
    np.testing.assert_allclose(observed, phi * np.array([[0.5, 0], [0, -0.5], [0.3, 0.4], [0, 0]]), rtol=1e-6)
    assert observed.dtype == dtype
    np.testing.assert_array_equal(observed[0], [0.5 * phi, 0])
    np.testing.assert_array_equal(lens(jnp.asarray([0.5, 0.0])), observed[0])


def test_the_sign_of_kappa():
    """κ > 0 is pincushion: points are seen farther out than they are; κ < 0 barrel."""
    corner = jnp.asarray([0.3, 0.4])
    assert jnp.linalg.norm(jl.RadialPolynomial([0.1]).distort(corner)) > 0.5
    assert jnp.linalg.norm(jl.RadialPolynomial([-0.1]).distort(corner)) < 0.5
    assert jnp.linalg.norm(jl.RadialPolynomial([0.1]).undistort(corner)) < 0.5
    assert jnp.linalg.norm(jl.RadialPolynomial([-0.1]).undistort(corner)) > 0.5


def test_no_coefficients_is_the_identity(dtype):
    lens = jl.RadialPolynomial(jnp.zeros(0, dtype))
    points = np.random.default_rng(0).normal(size=(20, 2)).astype(dtype) * 1e3
    np.testing.assert_array_equal(lens.distort(points), points)
    np.testing.assert_array_equal(lens.undistort(points), points)
    assert jnp.isinf(lens.fold_radius())
    assert jnp.isinf(lens.edge_radius())


@pytest.mark.parametrize("k", [0.3, 1.0, 5.0, 1e6, -1.0, -0.3, -1e-3])
def test_order_one_by_cardano(x64, k):
    """ρ + k ρ³ = r, hyperbolic for k > 0 and trigonometric for k < 0."""
    unit = np.longdouble(abs(k) * 3) ** -0.5  # where 3 |k| ρ² = 1: the fold, if k < 0
    if k > 0:
        r = np.geomspace(1e-3, 1e3, 100)
        expected = 2 * unit * np.sinh(np.arcsinh(r * np.longdouble(1.5) / unit) / 3)
    else:
        r = np.append(np.linspace(0, 0.98, 99), 0.999) * float(unit) * 2 / 3
        expected = 2 * unit * np.sin(np.arcsin(r * np.longdouble(1.5) / unit) / 3)
    inverse, fold, edge = invert(np.array([k]), points_at(r, 0 * r))
    assert bool(jnp.all(inverse.valid))
    np.testing.assert_allclose(inverse.points[:, 0], expected.astype(float), rtol=1e-14 if k > 0 else 1e-13)
    assert float(fold) == pytest.approx(np.inf if k > 0 else float(unit), rel=4e-16)
    assert float(edge) == pytest.approx(np.inf if k > 0 else float(unit) * 2 / 3, rel=4e-16)


# FACTS, section 2: how the peers invert a lens, in pixels at f = 500 on 640 × 480.


@pytest.mark.parametrize(("k", "opencv"), [(-0.3, 1.34), (0.5, 3.28), (1.0, 55.1), (-0.45, 16.7)])
def test_round_trip_in_pixels(dtype, k, opencv):
    coefficients = np.asarray([k], dtype)
    x, y = np.meshgrid(np.arange(0, WIDTH, 5), np.arange(0, HEIGHT, 5))
    ideal = np.stack([x - WIDTH / 2, y - HEIGHT / 2], -1).reshape(-1, 2) / FOCAL
    ideal = ideal[length(ideal) <= 0.98 * reference_fold(coefficients)].astype(dtype)
    observed = jl.RadialPolynomial(coefficients).distort(ideal)
    inverse, _, _ = invert(coefficients, observed)
    assert bool(jnp.all(inverse.valid))
    assert FOCAL * np.max(length(np.asarray(inverse.points) - ideal)) <= {"float32": 2e-3, "float64": 1e-9}[dtype]
    # OpenCV stops after a fixed number of steps, and says nothing: it is off by what the table says, about.
    theirs = cv2.undistortPoints(np.asarray(observed, float)[:, None], np.eye(3), np.array([k, 0, 0, 0]))[:, 0]
    assert FOCAL * np.max(length(theirs - ideal)) > max(1.0, 0.5 * opencv)


def test_the_paper_s_lens_where_opencv_diverges(x64):
    """κ = (1, 3), ideal points within 0.77: OpenCV's default is off by more than 1e-3 for most of them."""
    coefficients = np.array([1.0, 3.0])
    random = np.random.default_rng(0)
    ideal = points_at(0.77 * np.sqrt(random.uniform(0, 1, 2000)), random.uniform(0, 2 * np.pi, 2000))
    observed = jl.RadialPolynomial(coefficients).distort(ideal)
    assert np.max(np.abs(np.asarray(invert(coefficients, observed)[0].points) - ideal)) <= 1e-14
    theirs = cv2.undistortPoints(np.asarray(observed)[:, None], np.eye(3), np.array([*coefficients, 0, 0]))[:, 0]
    assert np.mean(length(theirs - ideal) > 1e-3) > 0.5


def test_points_without_preimage(dtype):
    """k = −0.3 shows nothing farther out than 0.7027…; there stands the fold, on the point's own ray."""
    coefficients = np.asarray([-0.3], dtype)
    points = np.asarray([[0.75, 0], [0.702, 0], [0, -0.703], [0, 0.7027], [-30, 40]], dtype)
    inverse, fold, edge = invert(coefficients, points)
    assert float(edge) == pytest.approx(2 / 3 / 0.9**0.5, rel=2 * EPSILON[dtype])
    assert float(fold) == pytest.approx(0.9**-0.5, rel=2 * EPSILON[dtype])
    assert inverse.valid.tolist() == [False, True, False, True, False]
    assert inverse.status.tolist() == [1, 0, 1, 0, 1]
    at_the_fold = float(fold) * np.array([[1, 0], [0, -1], [-0.6, 0.8]])
    np.testing.assert_allclose(np.asarray(inverse.points)[[0, 2, 4]], at_the_fold, rtol=4 * EPSILON[dtype])
    undistorted = jl.RadialPolynomial(coefficients).undistort(points)
    np.testing.assert_array_equal(jnp.isnan(undistorted).all(-1), ~inverse.valid)
    np.testing.assert_array_equal(undistorted[inverse.valid], inverse.points[inverse.valid])


# Every lens.


def uniform(random, order):
    return random.uniform(-5, 5, order)


def integers(random, order):
    """Many zeros, leading ones too, and slopes with multiple roots."""
    return random.integers(-5, 6, order) * random.integers(0, 2, order) / 1.0


def any_scale(random, order):
    return random.choice([-1, 1], order) * 10 ** random.uniform(-12, 6, order)


def nearly_inflected(random, order):
    """The slope has a nearly double root: a fold that has just appeared, or is about to."""
    place, offset = 10 ** random.uniform(-2, 2), random.choice([-1, 1]) * 10 ** random.uniform(-12, -1)
    slope = np.poly1d([1 / place**2, -2 / place, 1 + offset]) / (1 + offset)
    while slope.order < order:
        slope *= np.poly1d([random.choice([-1, 1]) / (place * 10 ** random.uniform(-0.3, 2)), 1])
    return slope.c[::-1][1:] / (2 * np.arange(1, order + 1) + 1)


def tough_radii(random, edge, epsilon):
    """Near and far, zero and subnormal, and around the edge: to a thousandth, to an ulp, exactly."""
    edge = edge if np.isfinite(edge) else 1.0
    return np.concatenate(
        [
            [0, 1e-40, 1e-20, 1e6],
            random.uniform(0, 3, 10),
            10 ** random.uniform(-6, 6, 10),
            edge * random.uniform(0.9, 1.01, 10),
            edge * (1 - 10.0 ** -np.arange(3, 9)),
            edge * (1 + epsilon * np.arange(-3, 4)),
        ]
    )


@pytest.mark.parametrize("family", [uniform, integers, any_scale, nearly_inflected])
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_every_lens_is_inverted(dtype, family, order):
    random = np.random.default_rng([order, len(family.__name__)])
    order = max(order, 2) if family is nearly_inflected else order
    lenses = np.stack([family(random, order) for _ in range(100)]).astype(dtype)
    _, folds, edges = invert_many(lenses, np.zeros((100, 47, 2), dtype))
    # A fold beyond this is out of sight: squares overflow before it.
    lenses = lenses[~((np.asarray(edges) > 1e18) & np.isfinite(folds)) | (dtype == "float64")]
    edges = np.asarray(edges)[~((np.asarray(edges) > 1e18) & np.isfinite(folds)) | (dtype == "float64")]
    radii = np.stack([tough_radii(random, edge, EPSILON[dtype]) for edge in edges.astype(float)])
    # Half of the points on an axis, where their radii are exact.
    angles = np.where(random.random(radii.shape) < 0.5, 0, random.uniform(0, 2 * np.pi, radii.shape))
    points = points_at(radii, angles).astype(dtype)
    results = jax.tree.map(np.asarray, invert_many(lenses, points))
    for i, coefficients in enumerate(lenses):
        check_inverse(coefficients, points[i], jax.tree.map(lambda leaf, i=i: leaf[i], results))


def test_folds_are_numpy_s_roots(x64):
    random = np.random.default_rng(0)
    for order in (1, 2, 3, 4):
        lenses = random.uniform(-5, 5, (100, order))
        _, folds, _ = invert_many(lenses, np.zeros((100, 1, 2)))
        expected = [reference_fold(coefficients) for coefficients in lenses]
        np.testing.assert_allclose(folds, expected, rtol=1e-9)


@given(
    coefficients=st.lists(st.floats(-5, 5, width=32), min_size=4, max_size=4),
    radii=st.lists(st.floats(0, 1e6, width=32), min_size=8, max_size=8),
    order=st.integers(0, 4),
    precision=st.sampled_from(["float32", "float64"]),
)
@settings(derandomize=True, deadline=None, max_examples=150)
def test_any_lens_any_point(coefficients, radii, order, precision):
    """What hypothesis can think of; coefficients past the order are zero, so that one shape serves all."""
    with jax.enable_x64(precision == "float64"):
        coefficients = np.where(np.arange(4) < order, coefficients, 0).astype(precision)
        points = points_at(np.array(radii), np.arange(8.0) * (np.arange(8) > 3)).astype(precision)
        check_inverse(coefficients, points, invert(coefficients, points))


@pytest.mark.parametrize(
    ("coefficients", "fold"),
    [
        ([0.0, 0.0, 0.0, 0.0], np.inf),
        ([1.0, 2.0, 0.0, 0.0], np.inf),
        ([-0.3, 0.0, 0.0, 0.0], 0.9**-0.5),
        ([0.0, -0.2], 1.0),
        ([-2 / 3, 1 / 5], np.inf),  # slope (1 − ρ²)²: touches zero, and goes on rising
        ([-1e6], 3e6**-0.5),
        ([-1e-12], 3e-12**-0.5),
        ([1e6, 1e-12], np.inf),
    ],
)
def test_fold_radius(x64, coefficients, fold):
    lens = jl.RadialPolynomial(coefficients)
    assert float(lens.fold_radius()) == pytest.approx(fold, rel=1e-15, abs=0)
    if np.isfinite(fold):
        np.testing.assert_array_equal(
            lens.one_to_one(jnp.asarray([[0.999 * fold, 0], [0, 1.001 * fold]])), [True, False]
        )
        assert float(lens.edge_radius()) == pytest.approx(float(observed_radius(coefficients, np.longdouble(fold))))


def test_an_inflection_is_no_fold(x64):
    """ρ − ⅔ρ³ + ⅕ρ⁵ stands still at one, and is invertible throughout; there to the cube root of rounding."""
    coefficients = np.array([-2 / 3, 1 / 5])
    ideal = np.concatenate([np.linspace(0, 3, 301), 1 + np.array([-1e-3, 1e-3, -1e-5, 1e-5])])
    observed = observed_radius(coefficients, ideal.astype(np.longdouble)).astype(float)
    inverse, _, _ = invert(coefficients, points_at(observed, 0 * observed))
    assert bool(jnp.all(inverse.valid))
    error = np.abs(np.asarray(inverse.points)[:, 0] - ideal)
    assert np.max(error) <= 3e-5
    assert np.max(error[np.abs(ideal - 1) >= 0.1]) <= 1e-13


def test_continuity_at_the_edge(dtype):
    """The points of `invert` cross the edge without a jump: ρ − fold ∝ √(edge − r) from within, zero from without."""
    coefficients = np.asarray([-0.3, 0.02], dtype)
    _, fold, edge = invert(coefficients, np.zeros((1, 2), dtype))
    offsets = np.concatenate(
        [-np.geomspace(1e-1, 10 * EPSILON[dtype], 40), [0], np.geomspace(10 * EPSILON[dtype], 1, 40)]
    )
    points = points_at(float(edge) * (1 + offsets), 0.7 + 0 * offsets).astype(dtype)
    found = length(invert(coefficients, points)[0].points)
    np.testing.assert_array_less(-1e-3 * float(fold), np.diff(found))
    gap = np.sqrt(np.maximum(-offsets, 0) + 10 * EPSILON[dtype])
    assert np.all(np.abs(found - float(fold)) <= 1.0 * float(fold) * gap)


def test_what_is_not_finite_is_not_valid(dtype):
    limit = np.finfo(dtype).max
    points = np.asarray(
        [[np.nan, 0], [0, np.nan], [np.inf, 0], [-np.inf, np.nan], [limit, 0], [0.3, 0.2], [0, 0]], dtype
    )
    for coefficients in ([-0.3], [0.3, 0.1], []):
        lens = jl.RadialPolynomial(np.asarray(coefficients, dtype), center=np.asarray([0.1, 0.2], dtype))
        inverse = lens.invert(points)
        assert inverse.valid.tolist() == [False] * 5 + [True] * 2
        assert inverse.status.tolist() == [jl.InverseStatus.NOT_FINITE] * 5 + [0, 0]
        np.testing.assert_allclose(inverse.points[:5], np.tile(lens.center, (5, 1)))
        assert bool(jnp.all(jnp.isfinite(inverse.points)))
        assert bool(jnp.all(jnp.isnan(lens.undistort(points)[:5])))


def test_own_center(dtype):
    """A lens about c is the lens about the origin, moved."""
    center = np.asarray([0.25, -0.125], dtype)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 2)).astype(dtype)
    for coefficients in ([0.5, -0.1], [-0.4]):
        moved, plain = jl.RadialPolynomial(coefficients, center=center), jl.RadialPolynomial(coefficients)
        few = 4 * EPSILON[dtype]
        np.testing.assert_allclose(moved.distort(points), plain.distort(points - center) + center, atol=few)
        np.testing.assert_allclose(moved.undistort(points), plain.undistort(points - center) + center, atol=20 * few)
        np.testing.assert_array_equal(moved.one_to_one(points), plain.one_to_one(points - center))
        np.testing.assert_array_equal(moved.undistort(center), center)


@pytest.mark.parametrize("shape", [(2,), (7, 2), (5, 3, 2), (0, 2), (3, 0, 2)])
def test_shapes(shape):
    lens = jl.RadialPolynomial([-0.1, 0.02])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, shape).astype(np.float32)
    inverse = lens.invert(points)
    assert lens.distort(points).shape == lens.undistort(points).shape == inverse.points.shape == shape
    assert inverse.valid.shape == inverse.status.shape == lens.one_to_one(points).shape == shape[:-1]
    one_by_one = np.array([lens.undistort(point) for point in points.reshape(-1, 2)]).reshape(shape)
    np.testing.assert_allclose(lens.undistort(points), one_by_one, rtol=1e-6)


# Derivatives.

FOLDING, RISING = [-0.4, 0.1, -0.05], [0.3, 1.0]


@jax.jit
def preimages(coefficients, center, points):
    return jl.RadialPolynomial(coefficients, center=center).invert(points).points


@jax.jit
def derivatives(coefficients, center, points):
    arguments = (coefficients, center, points)
    return jax.jacfwd(preimages, (0, 1, 2))(*arguments), jax.jacrev(preimages, (0, 1, 2))(*arguments)


@pytest.mark.parametrize("coefficients", [FOLDING, RISING, [0.0, 0.0]])
def test_derivatives_by_the_implicit_theorem(x64, coefficients):
    """∂ρ/∂r = 1/f′, ∂ρ/∂κᵢ = −ρ²ⁱ⁺¹/f′, across the ray ρ/r; forward and reverse; from the centre to near the fold."""
    center = np.array([0.2, -0.1])
    fold = min(reference_fold(coefficients), 2.0)
    rho = np.array([0, 1e-9, 1e-3, 0.3, 0.9, 0.98, 0.9999]) * fold
    angle = np.arange(7.0)
    ray, across = points_at(1.0, angle), points_at(1.0, angle + np.pi / 2)
    observed = observed_radius(coefficients, rho.astype(np.longdouble)).astype(float)
    powers = 2 * np.arange(1, len(coefficients) + 1) + 1
    slope = 1 + (powers * coefficients * rho[:, None] ** (powers - 1)).sum(-1)
    ratio = 1 / (1 + (coefficients * rho[:, None] ** (powers - 1)).sum(-1))
    by_points = np.einsum("n,ni,nj->nij", 1 / slope, ray, ray) + np.einsum("n,ni,nj->nij", ratio, across, across)
    by_center = np.eye(2) - by_points
    by_coefficients = np.einsum("nk,ni->nik", -(rho[:, None] ** powers) / slope[:, None], ray)
    # The slope itself is uncertain where it nearly vanishes, as is ρ.
    tolerance = 1e-13 * (1 + 1 / slope**2)
    for k, c, p in derivatives(np.array(coefficients), center, center + points_at(observed, angle)):
        own = np.asarray(p)[np.arange(7), :, np.arange(7)]
        assert np.all(np.abs(own - by_points) <= tolerance[:, None, None])
        assert np.all(np.abs(np.asarray(c) - by_center) <= tolerance[:, None, None])
        assert np.all(np.abs(np.asarray(k) - by_coefficients) <= tolerance[:, None, None])
        assert np.count_nonzero(p) == np.count_nonzero(own)


@pytest.mark.parametrize("coefficients", [FOLDING, RISING])
def test_second_derivatives(x64, coefficients):
    points = jnp.asarray([[0.0, 0.0], [0.3, 0.2], [-0.5, 0.4], [1e-3, 0.0]])
    arguments = (jnp.asarray(coefficients), jnp.asarray([0.02, -0.01]), points)
    check_grads(preimages, arguments, order=2, rtol=1e-5, atol=1e-5)


def test_second_derivative_near_the_fold(x64):
    """d²ρ/dr² = −f″/f′³ at 98 % of the fold."""
    fold = reference_fold([-0.3])
    rho = 0.98 * fold
    slope, curvature = 1 - 0.9 * rho**2, -1.8 * rho

    def along(r):
        return jl.RadialPolynomial(np.array([-0.3])).invert(jnp.stack([r, 0 * r])).points[0]

    second = jax.jit(jax.grad(jax.grad(along)))(rho - 0.3 * rho**3)
    assert float(second) == pytest.approx(-curvature / slope**3, rel=1e-10)


def test_hessian_at_the_center(x64):
    """ρ = r − k r³ + …: no second derivative at the centre, and no NaN."""
    center = jnp.asarray([0.2, -0.1])
    lens = jl.RadialPolynomial([0.3, 1.0], center=center)
    hessian = jax.jit(jax.hessian(lambda p: lens.undistort(p)))(center)
    np.testing.assert_allclose(hessian, np.zeros((2, 2, 2)), atol=1e-14)


@pytest.mark.parametrize("coefficients", [[-0.3, 0.0], [-0.1, 0.5]])
def test_derivatives_in_masked_places(dtype, coefficients):
    """Neither points without preimage nor NaN nor ∞ poison the gradient of the others."""
    good = np.asarray([[0.0, 0.0], [0.3, 0.2], [-0.1, 0.5]], dtype)
    bad = np.asarray([[5.0, 5.0], [np.nan, 0.1], [np.inf, 0.0], [np.nan, np.inf]], dtype)
    bad = bad[1:] if coefficients[1] > 0 else bad

    def total(coefficients, points):
        lens = jl.RadialPolynomial(coefficients)
        inverse = lens.invert(points)
        kept = jnp.where(inverse.valid[:, None], inverse.points, 0)
        return jnp.nansum(lens.undistort(points) ** 2) + jnp.sum(jnp.sin(kept))

    gradient, curvature = jax.jit(jax.grad(total, (0, 1))), jax.jit(jax.hessian(total))
    coefficients = np.asarray(coefficients, dtype)
    alone, together = gradient(coefficients, good), gradient(coefficients, np.concatenate([bad, good]))
    few = 20 * EPSILON[dtype]
    np.testing.assert_allclose(together[0], alone[0], rtol=few)
    np.testing.assert_allclose(together[1][len(bad) :], alone[1], rtol=few, atol=few)
    np.testing.assert_array_equal(together[1][: len(bad)], 0)
    np.testing.assert_allclose(
        curvature(coefficients, np.concatenate([bad, good])), curvature(coefficients, good), rtol=4 * few
    )
    # The points that `invert` puts there have finite derivatives too, whatever is done with them.
    everywhere = jax.jit(jax.jacfwd(lambda k, p: jl.RadialPolynomial(k).invert(p).points, (0, 1)))
    for leaf in everywhere(coefficients, np.concatenate([bad, good])):
        assert bool(jnp.all(jnp.isfinite(leaf)))


def test_gradient_of_the_fold(x64):
    """fold = (−3k)^−½, edge = ⅔ fold; zero where there is none."""
    gradients = jax.jit(
        lambda k: [jax.grad(lambda k: getattr(jl.RadialPolynomial(k), f)())(k) for f in ("fold_radius", "edge_radius")]
    )
    fold, edge = gradients(np.array([-0.3]))
    np.testing.assert_allclose(fold, [1.5 * 0.9**-1.5], rtol=1e-14)
    np.testing.assert_allclose(edge, [0.9**-1.5], rtol=1e-14)
    np.testing.assert_array_equal(gradients(np.array([0.3]))[0], [0])
    check_grads(lambda k: jl.RadialPolynomial(k).fold_radius(), (jnp.asarray([-0.4, 0.1, -0.05]),), order=2)


def test_beyond_the_edge_the_derivative_follows_the_fold(x64):
    """There the point is fold · p/|p|, differentiable in both."""
    k, p = np.array([-0.3]), np.array([0.0, 2.0])
    by_k, by_p = jax.jit(jax.jacrev(lambda k, p: jl.RadialPolynomial(k).invert(p).points, (0, 1)))(k, p)
    np.testing.assert_allclose(by_k, [[0], [1.5 * 0.9**-1.5]], rtol=1e-13)
    np.testing.assert_allclose(by_p, [[0.9**-0.5 / 2, 0], [0, 0]], rtol=1e-13, atol=1e-15)


def test_nothing_is_unrolled():
    """The linear part of the derivative holds no loop."""
    arguments = (jnp.asarray([-0.3, 0.1]), jnp.zeros(2), 0.1 * jnp.ones((3, 2)))
    _, linear = jax.linearize(preimages, *arguments)
    jaxpr = str(jax.make_jaxpr(linear)(*arguments))
    assert "while" not in jaxpr
    assert "scan" not in jaxpr


# Transformations.


def batch(dtype):
    random = np.random.default_rng(0)
    coefficients = np.asarray([[0.3, 0.1], [-0.5, 0.0], [1.0, 3.0]], dtype)
    return coefficients, random.uniform(-1, 1, (3, 40, 2)).astype(dtype)


def test_jit_and_eager_agree(dtype):
    coefficients, points = batch(dtype)
    with jax.disable_jit():
        eager = jl.RadialPolynomial(coefficients[1]).invert(points[1, :5])
    jitted, _, _ = invert(coefficients[1], points[1, :5])
    np.testing.assert_allclose(eager.points, jitted.points, rtol=20 * EPSILON[dtype])
    np.testing.assert_array_equal(eager.status, jitted.status)


@pytest.mark.parametrize("axes", [(0, 0), (0, None), (None, 0)])
def test_vmap_is_a_loop(dtype, axes):
    coefficients, points = batch(dtype)
    lenses = jax.vmap(jl.RadialPolynomial)(coefficients)
    lens_of = [jax.tree.map(lambda leaf, i=i: leaf[i], lenses) for i in range(3)]
    arguments = (lenses if axes[0] == 0 else lens_of[1], points if axes[1] == 0 else points[1])
    together = jax.jit(jax.vmap(lambda lens, points: lens.invert(points), in_axes=axes))(*arguments)
    for i in range(3):
        lens, own = lens_of[i if axes[0] == 0 else 1], points[i if axes[1] == 0 else 1]
        alone = lens.invert(own)
        np.testing.assert_allclose(together.points[i], alone.points, rtol=20 * EPSILON[dtype])
        np.testing.assert_array_equal(together.status[i], alone.status)


def test_large_batches_are_loops_too(x64):
    """From some size on pictures are solved one by one: same results, same gradients, nested too."""
    points = np.random.default_rng(1).uniform(-0.6, 0.6, (1 << 15, 2))
    coefficients = np.asarray([[[0.3], [-0.5]], [[0.1], [-0.2]]])

    def total(k):
        return jnp.sum(jnp.sin(jl.RadialPolynomial(k).invert(points).points))

    gradients = jax.jit(jax.vmap(jax.vmap(jax.value_and_grad(total))))(coefficients)
    alone = jax.jit(jax.value_and_grad(total))
    for i in np.ndindex(2, 2):
        value, gradient = alone(coefficients[i])
        np.testing.assert_allclose(gradients[0][i], value, rtol=1e-10)
        np.testing.assert_allclose(gradients[1][i], gradient, rtol=1e-10)


def test_gradients_under_vmap(x64):
    coefficients, points = batch("float64")

    def total(k, points):
        return jnp.nansum(jl.RadialPolynomial(k).undistort(points) ** 2)

    together = jax.jit(jax.vmap(jax.grad(total)))(coefficients, points)
    alone = jax.jit(jax.grad(total))
    for i in range(3):
        np.testing.assert_allclose(together[i], alone(coefficients[i], points[i]), rtol=1e-12)


# Dtypes and misuse.


@pytest.mark.parametrize("lens_dtype", ["float32", "float64"])
@pytest.mark.parametrize("points_dtype", ["float32", "float64"])
def test_dtype_rule(x64, lens_dtype, points_dtype):
    """The wider of the two, also where double precision is on; and as exact as that."""
    coefficients = np.asarray([-0.3, 0.05], lens_dtype)
    for center in (None, [0.1, -0.2], np.asarray([0.1, -0.2], lens_dtype)):
        lens = jl.RadialPolynomial(coefficients, center=center)
        points = np.asarray([[0.3, 0.2], [5.0, 5.0]], points_dtype)
        expected = np.promote_types(lens_dtype, points_dtype)
        inverse = lens.invert(points)
        assert lens.fold_radius().dtype == lens.center.dtype == lens_dtype
        assert lens.distort(points).dtype == lens.undistort(points).dtype == inverse.points.dtype == expected
        back = lens.distort(inverse.points)[0]
        np.testing.assert_allclose(back, points[0], rtol=20 * EPSILON[str(expected)])
        gradient = jax.grad(lambda lens, points=points: lens.invert(points).points.sum())(lens)
        assert gradient.coefficients.dtype == lens_dtype
        # A radius half way between the float32 neighbours of the edge is judged in the precision of the points.
        exact = jl.RadialPolynomial(coefficients.astype(points_dtype)).edge_radius()
        np.testing.assert_allclose(
            jl.RadialPolynomial(coefficients).invert(np.asarray([[9.0, 0]], points_dtype)).points[0, 0],
            jl.RadialPolynomial(coefficients.astype(expected)).fold_radius(),
            rtol=2 * EPSILON[str(expected)],
        )
        assert exact.dtype == points_dtype


@pytest.mark.usefixtures("_untyped")
def test_lists_and_integers_are_welcome():
    lens = jl.RadialPolynomial([1, 0], center=(0, 0))
    np.testing.assert_array_equal(lens.distort([[1, 0]]), [[2, 0]])
    np.testing.assert_allclose(lens.undistort(np.asarray([[2, 0]])), [[1, 0]], rtol=1e-6)
    np.testing.assert_array_equal(lens.distort(np.asarray([1, 0], np.int8)), [2, 0])


@pytest.mark.usefixtures("_untyped")
def test_misuse():
    lens = jl.RadialPolynomial([0.1])
    for method in (lens.distort, lens.undistort, lens.invert, lens.one_to_one, lens.jacobian):
        with pytest.raises(ValueError, match=r"points must have shape \(\.\.\., 2\) in \(x, y\) order, got \(5, 3\)"):
            method(jnp.ones((5, 3)))
    with pytest.raises(ValueError, match=r"must be a vector κ1, κ2, …, got shape \(3, 2\); .*vmap"):
        jl.RadialPolynomial(jnp.ones((3, 2)))
    with pytest.raises(ValueError, match=r"must be a vector κ1, κ2, …, got shape \(\)"):
        jl.RadialPolynomial(0.1)
    with pytest.raises(ValueError, match=r"centre of distortion has shape \(2,\), \(x, y\), got \(3,\)"):
        jl.RadialPolynomial([0.1], center=[0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="real numbers, got dtype complex64"):
        jl.RadialPolynomial(jnp.ones(2, jnp.complex64))
    with pytest.raises(ValueError, match="real numbers, got dtype complex64"):
        lens.distort(jnp.ones((3, 2), jnp.complex64))


def test_shapes_are_checked_here():
    """The tests run under jaxtyping's hook: a wrong shape inside the library would not pass unseen."""
    with pytest.raises((jaxtyping.TypeCheckError, beartype.roar.BeartypeException)):
        jl.RadialPolynomial([0.1]).offset(jnp.ones((5, 3)))
