"""What every exported map keeps to: it inverts, masks, batches and differentiates, in both precisions."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens import deformations


def exported_maps():
    """The concrete classes that map points and invert, by name, wherever the package exports them."""
    found = {}
    for module in (jl, *(getattr(jl, name) for name in jl.__all__ if inspect.ismodule(getattr(jl, name)))):
        for name in dir(module):
            value = getattr(module, name)
            public = inspect.isclass(value) and not name.startswith("_") and value.__module__.startswith("jaxlens.")
            if public and not inspect.isabstract(value) and callable(getattr(value, "invert", None)):
                found[name] = value
    return found


MAPS = exported_maps()


def lattice(shape, strength):
    return strength * np.random.default_rng(0).uniform(-1, 1, shape)


def polynomial(strength, dtype):
    return jl.RadialPolynomial(np.asarray([-strength, strength / 4], dtype))


def homography(strength, dtype):
    return deformations.Homography(np.asarray([[1, strength, 0.1], [0, 1 + strength, 0], [strength, 0, 1]], dtype))


def free_form(strength, dtype):
    still = deformations.FreeForm.identity(3, 2, lower=np.zeros(2, dtype), upper=np.ones(2, dtype))
    return deformations.FreeForm(still.control_points + jnp.asarray(lattice((4, 3, 2), strength / 4), dtype))


def free_form_3d(strength, dtype):
    still = deformations.FreeForm3D.identity(2, 1, 2, origin=np.zeros(3, dtype), axes=np.eye(3, dtype=dtype))
    return deformations.FreeForm3D(still.control_points + jnp.asarray(lattice((3, 2, 3, 3), strength / 4), dtype))


# Each from a strength and a dtype; near the identity, and one-to-one on POINTS.
EXAMPLES = {
    "Barrel": lambda strength, dtype: jl.Barrel(np.asarray(strength / 9, dtype), -strength / 2, strength / 5),
    "BarrelInverse": lambda strength, dtype: jl.BarrelInverse(np.asarray(strength / 9, dtype), strength / 2, 0.0),
    "BSplineField": lambda strength, dtype: deformations.BSplineField(
        lattice((6, 5, 2), strength / 8).astype(dtype), np.zeros(2, dtype), np.ones(2, dtype)
    ),
    "BrownConrady": lambda strength, dtype: jl.BrownConrady(
        np.asarray([-strength, strength / 4, strength / 50, strength / 70], dtype)
    ),
    "Chain": lambda strength, dtype: polynomial(strength, dtype).then(homography(strength, dtype)),
    "Cylindrical": lambda strength, dtype: jl.Cylindrical(),
    "Division": lambda strength, dtype: jl.Division(np.asarray(strength, dtype)),
    "DoubleSphere": lambda strength, dtype: jl.DoubleSphere(
        np.asarray(-strength, dtype), np.asarray(0.5 + strength, dtype)
    ),
    "Equidistant": lambda strength, dtype: jl.Equidistant(),
    "Equirectangular": lambda strength, dtype: jl.Equirectangular(),
    "Equisolid": lambda strength, dtype: jl.Equisolid(),
    "ExtendedUnifiedCamera": lambda strength, dtype: jl.ExtendedUnifiedCamera(
        np.asarray(0.5 + strength, dtype), np.asarray(1 + strength, dtype)
    ),
    "FieldOfView": lambda strength, dtype: jl.FieldOfView(np.asarray(10 * strength, dtype)),
    "FreeForm": free_form,
    "FreeForm3D": free_form_3d,
    "Homography": homography,
    "Inverted": lambda strength, dtype: polynomial(strength, dtype).inverse(),
    "KannalaBrandt": lambda strength, dtype: jl.KannalaBrandt(np.asarray([-strength, strength / 4], dtype)),
    "OneToOne": lambda strength, dtype: jl.OneToOne(polynomial(strength, dtype)),
    "Orthographic": lambda strength, dtype: jl.Orthographic(),
    "Perspective": lambda strength, dtype: jl.Perspective(),
    "Poly3": lambda strength, dtype: jl.Poly3(np.asarray(-strength, dtype)),
    "Poly5": lambda strength, dtype: jl.Poly5(np.asarray(-strength, dtype), strength / 4),
    "PtLens": lambda strength, dtype: jl.PtLens(np.asarray(strength / 9, dtype), -strength / 2, strength / 5),
    "RadialPolynomial": polynomial,
    "RadialPowers": lambda strength, dtype: jl.RadialPowers(np.asarray([1, strength / 5, -strength], dtype)),
    "RadialPowersInverse": lambda strength, dtype: jl.RadialPowersInverse(np.asarray([1, 0, strength], dtype)),
    "RadTanThinPrismFisheye": lambda strength, dtype: jl.RadTanThinPrismFisheye(
        np.asarray([-strength, strength / 4, 0, 0, 0, 0, *[strength / 50] * 6], dtype)
    ),
    "SplinedAngle": lambda strength, dtype: jl.SplinedAngle(
        np.asarray([0.4, 0.8], dtype), np.asarray([0.4, 0.8 - strength / 4], dtype)
    ),
    "SplinedRadial": lambda strength, dtype: jl.SplinedRadial(
        np.asarray([0.4, 0.8], dtype), np.asarray([0.4, 0.8 - strength / 4], dtype)
    ),
    "Stereographic": lambda strength, dtype: jl.Stereographic(),
    "ThinPrismFisheye": lambda strength, dtype: jl.ThinPrismFisheye(
        np.asarray([-strength, strength / 4, *[strength / 50] * 6], dtype)
    ),
    "UnifiedCamera": lambda strength, dtype: jl.UnifiedCamera(
        np.asarray(1 + strength, dtype), np.asarray([-strength, strength / 4, strength / 50, strength / 70], dtype)
    ),
}
STRENGTHS = 0.1, 0.15
TOLERANCE = {"float32": 2e-5, "float64": 1e-12}


def points_for(name, dtype):
    size = 3 if name.endswith("3D") else 2
    return np.random.default_rng(1).uniform(0.2, 0.6, (4, size)).astype(dtype)


def test_every_exported_map_has_an_example():
    missing, gone = set(MAPS) - set(EXAMPLES), set(EXAMPLES) - set(MAPS)
    assert not missing, f"exported maps without an example in EXAMPLES, so that nothing holds them: {sorted(missing)}"
    assert not gone, f"examples of maps that are not exported: {sorted(gone)}"


# Each program is compiled for each dtype: in single precision these are tried always, the others by pytest -m slow.
SINGLE = "BrownConrady", "FreeForm", "KannalaBrandt", "RadialPolynomial"
CASES = [
    pytest.param(name, dtype, marks=[] if dtype == "float64" or name in SINGLE else pytest.mark.slow)
    for name in sorted(EXAMPLES)
    for dtype in ("float32", "float64")
]


@pytest.mark.parametrize(("name", "dtype"), CASES, indirect=["dtype"])
def test_a_map_inverts_and_masks(name, dtype):
    mapping, points = EXAMPLES[name](STRENGTHS[0], dtype), points_for(name, dtype)
    assert isinstance(mapping, MAPS[name])
    image = mapping(points)
    assert image.dtype == dtype
    assert bool(mapping.one_to_one(points).all())
    assert bool((mapping.jacobian_determinant(points) > 0).all())
    inverse = mapping.invert(image)
    assert bool(inverse.valid.all())
    assert inverse.points.dtype == dtype
    np.testing.assert_allclose(inverse.points, points, rtol=0, atol=TOLERANCE[dtype])
    # A point that is none is masked, beside finite numbers, and spoils no other.
    spoiled = mapping.invert(image.at[0, 0].set(jnp.nan))
    np.testing.assert_array_equal(spoiled.valid, [False, True, True, True])
    assert int(spoiled.status[0]) == jl.InverseStatus.NOT_FINITE
    assert bool(jnp.isfinite(spoiled.points).all())
    np.testing.assert_array_equal(jnp.isnan(spoiled.masked()).all(-1), [True, False, False, False])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(name for name in EXAMPLES if jax.tree.leaves(EXAMPLES[name](0.1, np.float32))))
def test_maps_are_batched(name, dtype):
    each, points = [EXAMPLES[name](strength, dtype) for strength in STRENGTHS], points_for(name, dtype)
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    image = jax.vmap(lambda mapping: mapping(points))(together)
    found = jax.vmap(lambda mapping, image: mapping.invert(image))(together, image)
    assert bool(found.valid.all())
    for i, mapping in enumerate(each):
        np.testing.assert_allclose(image[i], mapping(points), rtol=0, atol=TOLERANCE[dtype])
        np.testing.assert_allclose(found.points[i], points, rtol=0, atol=TOLERANCE[dtype])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_a_map_is_differentiated(name, dtype):
    """By the implicit function theorem: dp = J⁻¹ (dq − ∂f/∂θ dθ), for p = f⁻¹(q; θ), and backwards the same."""
    mapping, points = EXAMPLES[name](STRENGTHS[0], dtype), points_for(name, dtype)
    image = mapping(points)
    parameters, rest = eqx.partition(mapping, eqx.is_inexact_array)
    change = jax.tree.map(lambda leaf: jnp.full_like(leaf, 0.1), parameters), jnp.full_like(image, 0.3)

    def inverted(parameters, image):
        return eqx.combine(parameters, rest).invert(image).points

    _, forward = jax.jvp(lambda parameters: eqx.combine(parameters, rest)(points), (parameters,), (change[0],))
    expected = np.linalg.solve(mapping.jacobian(points), (change[1] - forward)[..., None])[..., 0]
    _, found = jax.jvp(inverted, (parameters, image), change)
    np.testing.assert_allclose(found, expected, rtol=0, atol=20 * TOLERANCE[dtype])
    gradient = jax.grad(lambda *arguments: inverted(*arguments).sum(), argnums=(0, 1))(parameters, image)
    backward = sum(jnp.vdot(a, b) for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(change), strict=True))
    np.testing.assert_allclose(backward, expected.sum(), rtol=0, atol=100 * TOLERANCE[dtype])
