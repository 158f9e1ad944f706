"""The radial lenses of other programs: their formulas, their programs, where they end, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl

STATUS = jl.InverseStatus
# Ideal radii for a brute-force search.
DENSE = np.concatenate([np.linspace(0, 4, 40_001), np.geomspace(4, 1e9, 12_000)[1:]])


def powers(coefficients, r):
    return sum(c * r**i for i, c in enumerate(coefficients))


def random_nodes(random):
    return np.cumsum(random.uniform(0.1, 0.5, 5)), np.cumsum(random.uniform(0.05, 0.5, 5))


# Each from a random generator: a lens, and its formula in radii. Of a lens that is given backwards, that formula.
def field_of_view(random):
    omega = random.choice([-1, 1]) * random.uniform(0.01, 2.8)
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


@pytest.mark.parametrize("model", MODELS)
def test_a_lens_is_its_formula_and_ends_where_it_does(x64, model):
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
