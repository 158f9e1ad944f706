"""Free-form deformation of space: identity, Sederberg and Parry's sum, freezing, inverses, failures."""

from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.deformations import FreeForm3D

ORIGIN = np.array([1.0, -2.0, 3.0])
AXES = np.array([[2.0, 0.1, 0.0], [0.3, 1.5, 0.2], [0.0, 0.4, 3.0]])
LOCAL = np.random.default_rng(0).uniform(0, 1, (60, 3))
POINTS = LOCAL @ AXES + ORIGIN
AROUND = (1.4 * LOCAL - 0.2) @ AXES + ORIGIN


def deformed(degrees, *, spread=0.05, seed=1):
    random = np.random.default_rng(seed)
    lattice = np.asarray(FreeForm3D.identity(*degrees, origin=ORIGIN, axes=AXES).control_points)
    moved = lattice + spread * random.normal(size=lattice.shape)
    return FreeForm3D(moved, weights=np.exp(0.4 * random.normal(size=lattice.shape[:3])), origin=ORIGIN, axes=AXES)


@pytest.mark.parametrize("degrees", [(1, 1, 1), (2, 3, 1), (20, 2, 5)], ids=str)
def test_the_regular_lattice_is_the_identity(x64, degrees):
    still = FreeForm3D.identity(*degrees, origin=ORIGIN, axes=AXES)
    np.testing.assert_array_equal(still(AROUND), AROUND)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [(2, 3, 1), (20, 2, 5)], ids=str)
def test_the_sum_and_its_inverse(x64, degrees):
    mapping = deformed(degrees)
    s, t, u = (
        np.stack([comb(n, i) * x**i * (1 - x) ** (n - i) for i in range(n + 1)])
        for n, x in zip(degrees, LOCAL.T, strict=True)
    )
    weights = np.asarray(mapping.weights)
    above = np.einsum("ip,jp,kp,ijk,ijkc->pc", s, t, u, weights, mapping.control_points)
    below = np.einsum("ip,jp,kp,ijk->p", s, t, u, weights)
    np.testing.assert_allclose(mapping(POINTS), above / below[:, None], rtol=0, atol=1e-13)
    assert float(mapping.jacobian_determinant(POINTS).min()) > 0.1
    inverse = mapping.invert(mapping(POINTS))
    assert bool(inverse.valid.all())
    np.testing.assert_allclose(inverse.points, POINTS, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_outside_nothing_moves(x64):
    mapping = deformed((1, 2, 1))
    inside = np.asarray(mapping.contains(AROUND))
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(mapping(AROUND)[~inside], AROUND[~inside])
    far = np.array([[99.0, 0, 0], [np.nan, 0, 0]])
    inverse = mapping.invert(far)
    assert inverse.valid.tolist() == [True, False]
    assert inverse.status.tolist() == [0, jl.InverseStatus.NOT_FINITE]
    np.testing.assert_array_equal(inverse.points[0], far[0])
    assert np.isnan(inverse.masked()[1]).all()


def test_a_box_along_the_axes_owns_its_faces(x64):
    box = FreeForm3D.identity(1, 2, 1, origin=ORIGIN, axes=np.diag([0.1, 0.7, 3.3]))
    moved = FreeForm3D(box.control_points + 1.0, origin=box.origin, axes=box.axes)
    corners = np.array(list(np.ndindex(2, 2, 2))) * np.array([0.1, 0.7, 3.3]) + ORIGIN
    np.testing.assert_allclose(moved(corners), corners + 1, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_freezing(x64):
    """Value and slope vanish at the frozen faces, the second derivative does not."""
    mapping = deformed((4, 4, 1), spread=0.3).freeze(1, sides=["s=0", "t=1"])
    assert mapping.frozen(1, sides=["s=0", "t=1"]).sum() == 2 * (25 - 9)
    mapping = FreeForm3D(mapping.control_points, weights=mapping.weights)  # in the unit cube, so that normals are axes
    unit = FreeForm3D.identity(4, 4, 1)
    still = FreeForm3D.identity(4, 4, 1, origin=ORIGIN, axes=AXES).control_points
    mapping = FreeForm3D(unit.control_points + mapping.control_points - still, weights=mapping.weights)
    start, inward = jnp.array([0.0, 0.5, 0.4]), jnp.array([1.0, 0.0, 0.0])

    def along(distance):
        return mapping(start + distance * inward) - start - distance * inward

    first = jax.jacfwd(along)
    sizes = [float(jnp.max(jnp.abs(f(0.0)))) for f in (along, first, jax.jacfwd(first))]
    assert max(sizes[:2]) <= 1e-12
    assert sizes[2] > 1e-2


@pytest.mark.slow
def test_derivatives(x64):
    mapping = deformed((1, 2, 1))
    points = jnp.asarray(POINTS[:4])
    forward = mapping.jacobian(points)
    steps = 1e-6 * np.eye(3)[:, None]
    beyond, before = mapping(points[None, None] + np.stack([steps, -steps]))
    np.testing.assert_allclose(forward, np.moveaxis(beyond - before, 0, -1) / 2e-6, rtol=0, atol=1e-8)
    np.testing.assert_allclose(mapping.jacobian_determinant(points), np.linalg.det(forward), rtol=1e-12)
    target = mapping(points)
    found = jax.jit(jax.vmap(jax.jacrev(lambda point: mapping.invert(point).points)))(target)
    np.testing.assert_allclose(found, np.linalg.inv(forward), rtol=0, atol=1e-10)


def test_batches(x64):
    lattices = np.stack([np.asarray(deformed((1, 1, 1), seed=seed).control_points) for seed in range(2)])
    maps = jax.vmap(lambda control: FreeForm3D(control, origin=ORIGIN, axes=AXES))(lattices)
    found = jax.vmap(lambda mapping: mapping(POINTS))(maps)
    for one, lattice in zip(found, lattices, strict=True):
        np.testing.assert_allclose(one, FreeForm3D(lattice, origin=ORIGIN, axes=AXES)(POINTS), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"control_points": np.zeros((2, 2, 3))}, r"got \(2, 2, 3\)"),
        ({"control_points": np.zeros((2, 2, 1, 3))}, "of one or more"),
        ({"weights": -np.ones((2, 2, 2))}, "positive and finite, got -1.0"),
        ({"axes": np.ones((3, 3))}, "do not lie in a plane"),
        ({"origin": (0, 0)}, r"origin must have shape \(3,\).*got \(2,\)"),
    ],
)
def test_misuse(arguments, message):
    with pytest.raises(ValueError, match=message):
        FreeForm3D(**({"control_points": np.zeros((2, 2, 2, 3))} | arguments))


@pytest.mark.usefixtures("untyped")
def test_misuse_of_points_and_faces():
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3\), got \(4, 2\)"):
        FreeForm3D.identity(1, 1, 1)(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="freezes all"):
        FreeForm3D.identity(1, 1, 1).freeze(0)
