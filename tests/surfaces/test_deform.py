"""Surfaces through maps: depth maps as pictures are, meshes vertex by vertex, and where both fold."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.surfaces import DepthMap, Mesh, deform_depth_map, deform_mesh, from_mesh

ROWS, COLUMNS = np.mgrid[0:15, 0:20].astype(float)
MASK = (ROWS - 7) ** 2 + (COLUMNS - 9) ** 2 < 36


class _Affine(jl.CoordinateMap):
    matrix: jax.Array
    shift: jax.Array

    def __call__(self, points):
        return points @ self.matrix.T + self.shift.reshape((1,) * (points.ndim - 1) + (2,))


def _affine(matrix, shift):
    return _Affine(jnp.asarray(matrix, float), jnp.asarray(shift, float))


def _surface():
    return DepthMap(3 + 0.5 * COLUMNS - 0.25 * ROWS, mask=MASK, spacing=(0.5, 2.0))


@pytest.mark.parametrize("method", ["nearest", "bilinear", "bicubic"])
def test_the_identity_changes_nothing(x64, method):
    found = deform_depth_map(_surface(), jl.RadialPolynomial([0.0]), method=method)
    np.testing.assert_array_equal(found.depth_map.mask, MASK)
    np.testing.assert_allclose(found.depth_map.depth, np.where(MASK, _surface().depth, 0), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found.depth_map.spacing, [0.5, 2.0])
    assert not bool(found.folded.any())


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_a_plane_moved_by_half_a_pixel(x64, method):
    """Exact where the kernel lies inside the mask; outside it, wild depths leave no trace."""
    wild = DepthMap(jnp.where(MASK, _surface().depth, 1e8), mask=MASK, spacing=(0.5, 2.0))
    frame = jl.Frame([0.0, 0.0], 1.0)
    found = deform_depth_map(wild, _affine(np.eye(2), [0.5, 0.0]), frame=frame, method=method)
    expected = MASK & np.roll(MASK, -1, axis=1)
    if method == "bicubic":
        expected &= np.roll(MASK, 1, axis=1) & np.roll(MASK, -2, axis=1)
    mask = np.asarray(found.depth_map.mask)
    np.testing.assert_array_equal(mask, expected)
    exact = 3 + 0.5 * (COLUMNS + 0.5) - 0.25 * ROWS
    np.testing.assert_allclose(np.asarray(found.depth_map.depth)[mask], exact[mask], rtol=1e-14)
    assert np.all(np.asarray(found.depth_map.depth)[~mask] == 0)


def test_the_mask_follows_the_lens(x64):
    """A disk about the frame's centre stays one: its radius goes where the lens sends it."""
    rows, columns = np.mgrid[0:101, 0:101] - 50.0
    radius = np.hypot(rows, columns) / 50
    surface = DepthMap(jnp.ones((101, 101)), mask=radius < 0.6)
    found = deform_depth_map(surface, jl.Inverted(jl.RadialPolynomial([0.4])), frame=jl.Frame([50.0, 50.0], 50.0))
    edge = 0.6 * (1 + 0.4 * 0.36)
    mask = np.asarray(found.depth_map.mask)
    assert mask[radius < edge - 0.05].all()
    assert not mask[radius > edge].any()


def test_a_fold_is_reported(x64):
    """`x (1 − r²)` turns back at r = 1/√3; beyond, pixels see the inside again unless the map is restricted."""
    rows, columns = np.mgrid[0:81, 0:81] - 40.0
    radius = np.hypot(rows, columns) / 40
    surface, frame = DepthMap(jnp.ones((81, 81))), jl.Frame([40.0, 40.0], 40.0)
    found = deform_depth_map(surface, jl.RadialPolynomial([-1.0]), frame=frame)
    folded = np.asarray(found.folded)
    assert folded[radius > 0.578].all()
    assert not folded[radius < 0.577].any()
    assert bool(found.depth_map.mask[40, 75])
    safe = deform_depth_map(surface, jl.OneToOne(jl.RadialPolynomial([-1.0])), frame=frame)
    assert not bool(safe.folded.any())
    np.testing.assert_array_equal(np.asarray(safe.depth_map.mask), radius < 1 / np.sqrt(3))


def test_derivatives_of_a_deformed_depth_map(x64):
    weights = np.random.default_rng(0).normal(size=MASK.shape)
    depth = jnp.asarray(3 + np.sin(COLUMNS / 3) * np.cos(ROWS / 4))

    @jax.jit
    def value(depth, kappa):
        mapping = jl.Inverted(jl.RadialPolynomial(kappa))
        found = deform_depth_map(DepthMap(depth, mask=MASK), mapping).depth_map
        return jnp.sum(weights * found.depth)

    arguments = (depth, jnp.asarray([0.11, -0.02]))
    reverse = jax.jit(jax.grad(value, argnums=(0, 1)))(*arguments)
    assert all(np.isfinite(part).all() for part in reverse)
    assert np.all(np.asarray(reverse[0])[~MASK] == 0)
    tangents = (jnp.asarray(weights[::-1]), jnp.asarray([0.3, -0.2]))
    expected = sum(float(jnp.sum(part * tangent)) for part, tangent in zip(reverse, tangents, strict=True))
    step = 1e-7
    ahead, behind = (
        value(*(part + sign * step * tangent for part, tangent in zip(arguments, tangents, strict=True)))
        for sign in (1, -1)
    )
    np.testing.assert_allclose((ahead - behind) / (2 * step), expected, rtol=1e-5)


# Meshes.


def _grid_mesh(count=9):
    """A height field over a square, y upwards."""
    y, x = np.mgrid[0:count, 0:count] / (count - 1) * 4 - 2
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    vertices = np.stack([x, y, 0.3 * x - 0.2 * y + 0.1 * x * y], axis=-1).reshape(-1, 3)
    return Mesh(vertices, faces, texture_coordinates=vertices[:, :2])


def test_a_planar_map_sees_y_downwards(x64):
    """A shift by (+1, +1) of the picture moves a vertex right and down."""
    mesh = _grid_mesh()
    moved = deform_mesh(mesh, _affine(np.eye(2), [1.0, 1.0]), frame=jl.Frame([0.0, 0.0], 1.0)).mesh
    np.testing.assert_allclose(moved.vertices, np.asarray(mesh.vertices) + np.array([1, -1, 0]), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(moved.texture_coordinates, mesh.texture_coordinates)
    np.testing.assert_array_equal(moved.faces, mesh.faces)


def test_a_lens_in_its_default_frame(x64):
    """The corner of the bounding box has radius one."""
    found = deform_mesh(_grid_mesh(), jl.RadialPolynomial([0.2]))
    np.testing.assert_allclose(found.mesh.vertices[-1, :2], [2.4, 2.4], rtol=1e-15)
    np.testing.assert_array_equal(found.mesh.vertices[:, 2], _grid_mesh().vertices[:, 2])
    assert not bool(found.folded.any())


def test_the_mesh_and_its_picture_agree(x64):
    """A tangential lens, for its sense of up and down: deform, then look; or look, then deform."""
    mesh = _grid_mesh(65)
    lens = jl.BrownConrady([0.05, 0.0, 0.04, -0.03])
    camera = {"center": (0.0, 0.0, 0.0), "spacing": 5 / 80}
    frame = jl.Frame([0.0, 0.0], 2.5)
    one = from_mesh(deform_mesh(mesh, lens, frame=frame).mesh, 81, 81, **camera)
    other = deform_depth_map(
        from_mesh(mesh, 81, 81, **camera), jl.Inverted(lens), frame=jl.Frame([40.0, 40.0], 2.5 * 16)
    ).depth_map
    both = np.asarray(one.mask & other.mask)
    assert both.sum() > 0.9 * np.asarray(one.mask).sum()
    assert np.abs(np.asarray(one.depth) - np.asarray(other.depth))[both].max() < 2e-3


def test_normals_follow_the_inverse_transpose(x64):
    """Of a linear map of space: n ∝ A⁻ᵀ n, exactly, for each face; a reflection turns every triangle over."""
    matrix = np.array([[1.2, 0.3, 0.1], [-0.2, 0.9, 0.4], [0.1, 0.2, 1.5]])
    mesh = _grid_mesh()
    found = deform_mesh(mesh, lambda points: points @ matrix.T)
    expected = np.asarray(mesh.face_normals()) @ np.linalg.inv(matrix)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(found.mesh.face_normals(), expected, rtol=0, atol=1e-14)
    assert not bool(found.folded.any())
    assert bool(deform_mesh(mesh, lambda points: points * jnp.asarray([[1, -1, 1]])).folded.all())


def test_folded_triangles(x64):
    """`x (1 − r²)` in the default frame: triangles wholly beyond 1/√3 are turned over, those within are not."""
    mesh = _grid_mesh(33)
    radius = np.hypot(*np.asarray(mesh.vertices)[:, :2].T)[np.asarray(mesh.faces)] / np.sqrt(8)
    folded = np.asarray(deform_mesh(mesh, jl.RadialPolynomial([-1.0])).folded)
    assert folded[(radius > 0.65).all(axis=1)].all()
    assert not folded[(radius < 0.53).all(axis=1)].any()


def test_the_mesh_is_differentiable(x64):
    mesh = _grid_mesh(3)

    @jax.jit
    def value(kappa):
        normals = deform_mesh(mesh, jl.RadialPolynomial(kappa)).mesh.vertex_normals()
        return jnp.sum(normals[:, 0] * mesh.vertices[:, 2])

    kappa = jnp.asarray([0.2])
    step = jnp.asarray([1e-6])
    numeric = (value(kappa + step) - value(kappa - step)) / 2e-6
    np.testing.assert_allclose(jax.grad(value)(kappa)[0], numeric, rtol=1e-8)


def test_misuse(x64):
    mesh = _grid_mesh(3)
    with pytest.raises(ValueError, match=r"points of shape \(9, 3\), got \(9, 2\)"):
        deform_mesh(mesh, lambda points: points[:, :2])
    with pytest.raises(ValueError, match="frame belongs to maps of the plane"):
        deform_mesh(mesh, lambda points: points, frame=jl.Frame([0.0, 0.0], 1.0))
    with pytest.raises(ValueError, match=r"vertices must be finite.*8 such vertices"):
        deform_mesh(mesh, jl.Inverted(jl.RadialPolynomial([-0.3])))
