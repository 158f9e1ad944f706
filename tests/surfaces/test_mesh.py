"""Meshes: coverage without gaps, depth in closed form."""

import jax
import jaxtyping
import numpy as np
import pytest
from scipy.spatial import Delaunay

from jaxlens.surfaces import Mesh, from_mesh
from jaxlens.surfaces._rasterize import rasterize

trimesh = pytest.importorskip("trimesh", reason="the extra `meshes` is not installed")

TRIANGLE = ([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]], [[0, 1, 2]])
SQUARE = ([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]])


def _mesh(vertices, faces):
    return Mesh(np.asarray(vertices, float), np.asarray(faces))


def test_a_triangle_by_hand(dtype):
    """Edges and corners on pixel centres count; y is turned over."""
    depth_map = from_mesh(Mesh(np.asarray(TRIANGLE[0], dtype), TRIANGLE[1]), 3, 3, spacing=1.0)
    assert depth_map.mask.astype(int).tolist() == [[1, 0, 0], [1, 1, 0], [1, 1, 1]]
    assert depth_map.depth.dtype == dtype
    np.testing.assert_array_equal(depth_map.depth, np.tril(np.ones((3, 3))))


@pytest.mark.parametrize("turned", [False, True])
def test_a_tilted_plane_is_exact(x64, turned):
    """z = 2 + 0.3 x − 0.7 y, in triangles of any shape and either sense of rotation."""
    random = np.random.default_rng(0)
    flat = np.concatenate([[[-9, -9], [9, -9], [9, 9], [-9, 9]], random.uniform(-9, 9, (60, 2))])
    faces = Delaunay(flat).simplices
    vertices = np.column_stack([flat, 2 + flat @ [0.3, -0.7]])
    depth_map = from_mesh(_mesh(vertices, faces[:, ::-1] if turned else faces), 37, 53, spacing=0.25)
    assert bool(depth_map.mask.all())
    x, y = (np.arange(53) - 26) * 0.25, (18 - np.arange(37)) * 0.25
    expected = 2 + 0.3 * x[None, :] - 0.7 * y[:, None]
    np.testing.assert_allclose(depth_map.depth, expected, rtol=0, atol=1e-13)


def test_a_tilted_plane_in_perspective(x64):
    """The ray through pixel (u, v) meets z = 1 + 0.3 x − 0.7 y where the line of sight says."""
    vertices = [[x, y, 1 + 0.3 * x - 0.7 * y] for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))]
    depth_map = from_mesh(
        _mesh(vertices, SQUARE[1]),
        30,
        40,
        projection="perspective",
        field_of_view=40.0,
        center=(0.0, 0.0, 0.0),
        spacing=0.25,
    )
    distance = 0.25 * 15 / np.tan(np.radians(20))
    u, v = (np.arange(40) - 19.5)[None, :] * 0.25, (14.5 - np.arange(30))[:, None] * 0.25
    # x = u (D − z)/D and y = v (D − z)/D in the plane's equation
    a = (0.3 * u - 0.7 * v) / distance
    expected = (1 + a * distance) / (1 + a)
    seen = np.asarray(depth_map.mask)
    assert seen.mean() > 0.99
    np.testing.assert_allclose(np.asarray(depth_map.depth)[seen], expected[seen], rtol=0, atol=1e-12)


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
def test_an_icosphere(x64, projection):
    """Its faces lie below the sphere by at most the sagitta; its outline is a circle, or the cone of sight's."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    mesh = _mesh(ball.vertices, ball.faces)
    depth_map = from_mesh(mesh, 101, 101, projection=projection, field_of_view=50.0, margin=0.1)
    spacing = float(depth_map.spacing[0])
    radius = np.hypot(*np.mgrid[-50:51, -50:51]) * spacing
    seen, depth = np.asarray(depth_map.mask), np.asarray(depth_map.depth)
    if projection == "orthographic":
        np.testing.assert_allclose(spacing, 2 / (101 * 0.8), rtol=1e-3)
        expected, outline = np.sqrt(np.maximum(1 - radius**2, 0)), 1.0
        error, ok = expected - depth, radius < 0.9
    else:
        distance = spacing * 50.5 / np.tan(np.radians(25))
        outline = distance / np.sqrt(distance**2 - 1)
        slope = (radius / distance) ** 2
        # (slope + 1) t² − 2 D t + D² − 1 = 0 for the distance t along z
        ahead = (distance - np.sqrt(np.maximum(1 - slope * (distance**2 - 1), 0))) / (1 + slope)
        error, ok = distance - ahead - depth, radius < 0.8
    sagitta = 1 - np.linalg.norm(ball.vertices[ball.faces].mean(axis=1), axis=1).min()
    assert error[ok].min() >= -1e-12
    assert error[ok].max() <= 2.5 * sagitta
    assert seen[radius < 0.995 * outline].all()
    assert not seen[radius > 1.0001 * outline].any()


def test_watertight(x64):
    """Fans, slivers and shared corners: each pixel inside is covered, and by a partition exactly once but on edges."""
    random = np.random.default_rng(1)
    for trial in range(20):
        count = int(random.integers(3, 200))
        inner = random.uniform(0, 40, (count, 2))
        if trial % 2:
            inner = np.round(inner * 2) / 2  # corners and edges on pixel centres
        if trial % 5 == 0:
            inner[:, 0] = 20 + 1e-7 * inner[:, 0]  # slivers
            points = np.unique(np.concatenate([[[-1.0, -1], [41, -1], [41, 41], [-1, 41]], inner]), axis=0)
        faces = Delaunay(points).simplices
        depth = rasterize(points, points[:, 0], faces, 41, 41)
        assert np.isfinite(depth).all()
        np.testing.assert_allclose(depth, np.broadcast_to(np.arange(41.0), (41, 41)), rtol=0, atol=1e-4)


def test_coverage_against_exact_fractions(x64):
    """Random triangles with vertices on 1/16 of a pixel: inside or on an edge, decided in whole numbers."""
    random = np.random.default_rng(2)
    rows, columns = np.mgrid[0:12, 0:12] * 16
    for _ in range(200):
        a, b, c = random.integers(-100, 300, (3, 2))

        def side(p, q):
            return (q[0] - p[0]) * (rows - p[1]) - (q[1] - p[1]) * (columns - p[0])

        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        sides = np.stack([side(a, b), side(b, c), side(c, a)]) * np.sign(area)
        expected = (sides >= 0).all(axis=0) & (area != 0)
        found = rasterize(np.array([a, b, c]) / 16, np.zeros(3), np.array([[0, 1, 2]]), 12, 12)
        np.testing.assert_array_equal(np.isfinite(found), expected)


def test_the_nearest_surface_wins_and_holes_stay_open(x64):
    low, high = np.asarray(SQUARE[0]), np.asarray(SQUARE[0]) * [0.5, 0.5, 1] + [0, 0, 3]
    both = _mesh(np.concatenate([high, low]), np.concatenate([SQUARE[1], np.asarray(SQUARE[1]) + 4]))
    depth = np.asarray(from_mesh(both, 5, 5, spacing=1.0, center=(2, 2, 0)).depth)
    assert depth.tolist() == [[0] * 5, [0] * 5, [3] * 3 + [0] * 2, [3] * 3 + [0] * 2, [3] * 3 + [0] * 2]
    ring = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    hole = _mesh(np.concatenate([SQUARE[0], np.asarray(SQUARE[0]) * 0.5 + [1, 1, 0]]), ring)
    mask = np.asarray(from_mesh(hole, 9, 9, spacing=0.5, center=(2, 2, 0)).mask)
    assert not mask[3:6, 3:6].any()
    assert mask.sum() == 81 - 9


def test_triangles_without_area_are_ignored(x64):
    faces = [[0, 1, 2], [0, 0, 1], [1, 2, 1], [3, 4, 5]]
    vertices = [*TRIANGLE[0], [0, 0, 9.0], [1, 1, 9.0], [2, 2, 9.0]]
    depth_map = from_mesh(_mesh(vertices, faces), 3, 3, spacing=1.0)
    assert float(depth_map.depth.max()) == 1.0


def test_normals(x64):
    """Weighted by area: at the corner of two faces at right angles, one twice the other."""
    mesh = _mesh([[0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 2], [9, 9, 9]], [[0, 1, 2], [0, 1, 3]])
    np.testing.assert_allclose(mesh.face_normals(), [[0, 0, 1], [0, -1, 0]], atol=1e-15)
    found = np.asarray(mesh.vertex_normals())
    np.testing.assert_allclose(found[0], np.array([0, -2, 1]) / np.sqrt(5), rtol=1e-15)
    np.testing.assert_array_equal(found[4], 0)
    tiny = _mesh(1e-120 * np.asarray(mesh.vertices), mesh.faces)
    np.testing.assert_allclose(tiny.vertex_normals(), found, atol=1e-15)
    gradient = jax.grad(lambda v: Mesh(v, mesh.faces).vertex_normals()[:, 2].sum())(mesh.vertices)
    assert np.isfinite(gradient).all()


@pytest.fixture
def _untyped(monkeypatch):
    """Without the type checks of the tests: what a user meets."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.usefixtures("_untyped")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"projection": "fisheye"}, "orthographic, perspective, got 'fisheye'"),
        ({"margin": 0.5}, "margin"),
        ({"field_of_view": 180.0}, "between 0 and 180"),
        ({"spacing": 0.0}, "positive and finite"),
        ({"center": (0.0, 0.0)}, "three finite numbers"),
        ({"projection": "perspective", "spacing": 1e-3, "center": (0, 0, 0)}, "in front of the centre"),
    ],
)
def test_arguments_out_of_range(options, message):
    with pytest.raises(ValueError, match=message):
        from_mesh(Mesh(*TRIANGLE), 8, 8, **options)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ([[0.0, 0, 0]], np.zeros((0, 3), int), "no faces"),
        ([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]], [[0, 1, 2]], "no extent"),
        ([[0.0, 0, np.nan]], [[0, 0, 0]], "finite"),
        ([[0.0, 0, 0]], [[0, 0, 1]], "must index the 1 vertices, from 0, got .0, 0, 1. at face 0"),
        ([[0.0, 0, 0]], [[0, 0, -1]], "must index"),
        ([[0.0, 0]], [[0, 0, 0]], r"shape \(V, 3\)"),
        ([[0.0, 0, 0]], [[0.5, 0, 0]], "integers"),
    ],
)
def test_bad_meshes(vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        from_mesh(Mesh(np.asarray(vertices, np.float32), np.asarray(faces)), 8, 8)


def test_too_much_work_is_refused():
    points = np.array([[-1.0, -1], [5000, -1], [-1, 5000]])
    with pytest.raises(ValueError, match="times over"):
        rasterize(points, np.zeros(3), np.tile([[0, 1, 2]], (300, 1)), 4000, 4000)
    with pytest.raises(ValueError, match="use a larger spacing"):
        rasterize(points * 1e9, np.zeros(3), np.array([[0, 1, 2]]), 8, 8)
