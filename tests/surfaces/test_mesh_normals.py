"""Normals of meshes as they are seen: those of the smooth surface that a mesh approximates; edges stay edges."""

import numpy as np
import pytest

from jaxlens.surfaces import Mesh, from_mesh, normals_from_mesh, shade


def _ball(rings: int = 12) -> Mesh:
    """A sphere of radius one, faceted by 15°, its seam and poles made of vertices at one place."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1))
    vertices = np.stack([np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], axis=-1)
    number = np.arange(polar.size).reshape(polar.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    vertices = np.round(vertices, 9).reshape(-1, 3)
    return Mesh(vertices, faces)


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_faceted_ball_has_the_normals_of_a_ball(x64, projection, turned):
    ball = _ball()
    if turned:  # the other side of each face is its front
        ball = Mesh(ball.vertices, ball.faces[:, ::-1])
    view = {"projection": projection, "field_of_view": 40.0}
    depth_map, found = from_mesh(ball, 101, 101, **view), np.asarray(normals_from_mesh(ball, 101, 101, **view))
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, rtol=1e-12)
    scale = 1.0 if projection == "orthographic" else None
    rows, columns = np.nonzero(np.asarray(depth_map.mask))
    middle, step = 50.0, float(depth_map.spacing[0])
    if scale is None:  # along the ray through the pixel
        distance = step * 0.5 * 101 / np.tan(np.radians(20.0))
        scale = (distance - np.asarray(depth_map.depth)[rows, columns]) / distance
    x, y = (columns - middle) * step * scale, (rows - middle) * step * scale
    place = np.stack([x, y, np.asarray(depth_map.depth)[rows, columns]], axis=-1)
    truth = place / np.linalg.norm(place, axis=-1, keepdims=True)
    inner = np.hypot(x, y) < 0.9
    angle = np.degrees(np.arccos(np.clip(np.sum(found[rows, columns] * truth, axis=-1), -1, 1)))[inner]
    # The facets' own normals are off by up to 7.5° and more.
    assert angle.max() < 2.0
    outside = ~np.asarray(depth_map.mask)
    assert (found[outside] == [0, 0, 1]).all()


def test_a_picture_lit_by_them_has_no_facets(x64):
    ball = _ball()
    depth_map = from_mesh(ball, 101, 101)
    smooth = np.asarray(shade(depth_map, normals=normals_from_mesh(ball, 101, 101)))
    faceted = np.asarray(shade(depth_map))
    inner = slice(25, 76)
    bends = [np.abs(np.diff(picture[inner, inner], n=2)).max() for picture in (smooth, faceted)]
    assert bends[0] < 0.2 * bends[1]


def test_edges_stay_edges(x64):
    """Two walls that meet at a right angle, seen from between."""
    corner = Mesh(
        [[-1.0, -1.0, 0.0], [0.0, -1.0, 1.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 1.0, 0.0]],
        [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
    )
    found = np.asarray(normals_from_mesh(corner, 21, 21))
    half = np.sqrt(0.5)
    np.testing.assert_allclose(found[10, 4], [-half, 0, half], atol=1e-12)
    np.testing.assert_allclose(found[10, 9], [-half, 0, half], atol=1e-12)
    np.testing.assert_allclose(found[10, 16], [half, 0, half], atol=1e-12)


def test_normals_of_another_shape_are_refused():
    ball = _ball(4)
    with pytest.raises(ValueError, match=r"normals must have the shape \(8, 9, 3\), got \(9, 8, 3\)"):
        shade(from_mesh(ball, 8, 9), normals=normals_from_mesh(ball, 9, 8))
