"""The radial distance, paths, and the nose tip."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from jaxlens.surfaces import (
    DepthMap,
    FaceShape,
    face,
    geodesic_distance,
    geodesic_path,
    nose_tip,
    radial_geodesic_distance,
)

HEIGHT, WIDTH = 24, 31
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(float)
SOURCE = (12.3, 10.2)
SPACING = (1.3, 0.4)


def _plane():
    return DepthMap(0.7 * SPACING[0] * COLUMNS - 1.9 * SPACING[1] * ROWS, spacing=SPACING)


def _distance_on_the_plane():
    x, y = (COLUMNS - SOURCE[0]) * SPACING[0], (ROWS - SOURCE[1]) * SPACING[1]
    return np.sqrt(x * x + y * y + (0.7 * x - 1.9 * y) ** 2)


def test_radial_is_exact_on_planes(x64):
    np.testing.assert_allclose(radial_geodesic_distance(_plane(), SOURCE), _distance_on_the_plane(), rtol=1e-12)


def test_radial_on_a_sphere(x64):
    """R asin(ρ/R) from the pole; second order: 1.3e-4 at 64² pixels, 2.4e-6 at 512²."""
    size = 64
    middle = (size - 1) / 2
    radius = middle / 0.9
    rho = np.hypot(*(np.mgrid[:size, :size] - middle))
    mask = rho <= middle
    depth = np.sqrt(np.where(mask, radius**2 - rho**2, 0))
    found = np.asarray(radial_geodesic_distance(DepthMap(depth, mask=mask), (middle, middle)))
    expected = radius * np.arcsin(rho[mask] / radius)
    np.testing.assert_allclose(found[mask], expected, rtol=1.5e-4)
    assert np.all(np.isnan(found[~mask]))


def test_radial_is_the_integral(x64):
    """Eq. 2 by adaptive quadrature, above single rays."""
    height = lambda x, y: 1.5 * np.sin(0.21 * x + 0.3) * np.cos(0.17 * y)  # noqa: E731
    found = np.asarray(radial_geodesic_distance(DepthMap(height(COLUMNS, ROWS)), SOURCE))
    for x, y in [(30, 23), (0, 0), (12, 23), (30, 10), (2, 19)]:
        dx, dy = x - SOURCE[0], y - SOURCE[1]

        def speed(t, dx=dx, dy=dy):
            u, v = 0.21 * (SOURCE[0] + t * dx) + 0.3, 0.17 * (SOURCE[1] + t * dy)
            slope = 1.5 * (0.21 * dx * np.cos(u) * np.cos(v) - 0.17 * dy * np.sin(u) * np.sin(v))
            return np.sqrt(dx * dx + dy * dy + slope * slope)

        np.testing.assert_allclose(found[y, x], quad(speed, 0, 1)[0], rtol=2e-4)


def test_radial_stops_at_the_mask(x64):
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[5:16, 20] = False
    found = np.asarray(radial_geodesic_distance(DepthMap(np.zeros((HEIGHT, WIDTH)), mask=mask), SOURCE))
    assert np.isnan(found[10, 20])
    assert np.isposinf(found[10, 25])
    np.testing.assert_allclose(found[:, :20], np.hypot(COLUMNS - SOURCE[0], ROWS - SOURCE[1])[:, :20], rtol=1e-12)
    assert np.isfinite(found[0, 22])


def test_radial_derivatives(x64):
    depth = jnp.asarray(1.5 * np.sin(0.3 * COLUMNS) * np.cos(0.2 * ROWS))
    random = np.random.default_rng(0)
    weights, direction = (jnp.asarray(random.normal(size=depth.shape)) for _ in range(2))
    mask = jnp.asarray(np.hypot(ROWS - 12, COLUMNS - 15) < 11.3)

    @jax.jit
    def total(depth):
        distance = radial_geodesic_distance(DepthMap(depth, mask=mask), SOURCE)
        return jnp.sum(jnp.where(jnp.isfinite(distance), weights * distance, 0))

    gradient = jax.jit(jax.grad(total))(depth)
    forward = jax.jit(lambda dot: jax.jvp(total, (depth,), (dot,))[1])(direction)
    np.testing.assert_allclose(jnp.sum(gradient * direction), forward, rtol=1e-10)
    differences = (total(depth + 1e-6 * direction) - total(depth - 1e-6 * direction)) / 2e-6
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
    assert bool(jnp.all(jnp.isfinite(gradient)))


def test_paths_on_planes_are_straight(x64):
    depth_map = _plane()
    start = np.array([29.0, 1.5])
    path = geodesic_path(depth_map, geodesic_distance(depth_map, source=SOURCE), start)
    assert bool(path.reached)
    points = np.asarray(path.points)
    np.testing.assert_allclose(points[0], start)
    np.testing.assert_allclose(
        points[int(path.count) - 1 :], np.broadcast_to(SOURCE, (len(points) - int(path.count) + 1, 2)), atol=1e-7
    )
    along = (start - SOURCE) / np.linalg.norm(start - SOURCE)
    assert np.max(np.abs((points - SOURCE) @ [-along[1], along[0]])) < 1e-6


def test_a_path_has_the_length_of_the_distance(x64):
    """Around a wall too, where it must not cross."""
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[8:, 15] = False
    depth_map = DepthMap(2 * np.sin(0.2 * COLUMNS) * np.cos(0.2 * ROWS), mask=mask)
    distance = geodesic_distance(depth_map, source=(5.0, 20.0))
    path = geodesic_path(depth_map, distance, (25.0, 21.0))
    assert bool(path.reached)
    x, y = np.asarray(path.points).T
    assert np.all(mask[np.round(y).astype(int), np.round(x).astype(int)])
    length = np.sum(np.sqrt(np.diff(x) ** 2 + np.diff(y) ** 2 + np.diff(2 * np.sin(0.2 * x) * np.cos(0.2 * y)) ** 2))
    np.testing.assert_allclose(length, distance[21, 25], rtol=3e-2)


def test_a_path_that_is_cut_short(x64):
    depth_map = _plane()
    path = geodesic_path(depth_map, geodesic_distance(depth_map, source=SOURCE), (29.0, 1.5), max_points=5)
    assert (int(path.count), bool(path.reached), path.points.shape) == (5, False, (5, 2))


def test_starts_that_do_not_fit(x64):
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:, 15] = False
    depth_map = DepthMap(np.zeros((HEIGHT, WIDTH)), mask=mask)
    distance = geodesic_distance(depth_map, source=(3.0, 4.0))
    with pytest.raises(ValueError, match=r"start \(15, 3\) lies outside the mask"):
        geodesic_path(depth_map, distance, (15.0, 3.0))
    with pytest.raises(ValueError, match="no way leads from there"):
        geodesic_path(depth_map, distance, (20.0, 3.0))
    with pytest.raises(ValueError, match="depth map's shape"):
        geodesic_path(depth_map, distance[1:], (3.0, 3.0))
    with pytest.raises(ValueError, match="max_points"):
        geodesic_path(depth_map, distance, (3.0, 3.0), max_points=1)


def test_the_nose_tip_of_a_face(x64):
    """Within a third of a pixel; and the distance starts there by default."""
    size = 96
    depth_map = face(size, size)
    tip = np.asarray(nose_tip(depth_map))
    np.testing.assert_allclose(tip, FaceShape().nose_tip_pixel(size, size), atol=0.35)
    distance = np.asarray(geodesic_distance(depth_map))
    row, column = np.unravel_index(np.nanargmin(distance), distance.shape)
    assert np.hypot(column - tip[0], row - tip[1]) < 1
    # A head that nods is, to first order, one with a slope.
    nodding = DepthMap(
        depth_map.depth + 0.2 * depth_map.points()[..., 1], mask=depth_map.mask, spacing=depth_map.spacing
    )
    np.testing.assert_allclose(nose_tip(nodding), tip, atol=0.5)
