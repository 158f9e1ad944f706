"""The face: its nose tip and proportions, smoothness, the same at every resolution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens.surfaces import FaceShape, face, face_albedo, shade

HEIGHT, WIDTH = 92, 70

slopes_at = jax.jit(jax.vmap(jax.grad(lambda shape, x, y: shape.depth_at(x, y), argnums=(1, 2)), (None, 0, 0)))


def _slopes_at_the_tip(shape):
    """Computed among others, so that all tests share one program."""
    tip = shape.nose_tip()
    x, y = jnp.linspace(-0.6, 0.6, 101).at[0].set(tip[0]), jnp.linspace(-0.7, 0.7, 101).at[0].set(tip[1])
    slopes = slopes_at(shape, x, y)
    assert all(bool(jnp.all(jnp.isfinite(slope))) for slope in slopes)  # to the outline and beyond
    return max(abs(float(slope[0])) for slope in slopes)


@pytest.fixture(scope="module")
def picture():
    with jax.enable_x64(True):
        return face(HEIGHT, WIDTH), face_albedo(HEIGHT, WIDTH)


def test_the_nose_tip_is_the_highest_point(x64):
    """The slope vanishes there, the curvature is negative both ways, and no other point of a fine grid is higher."""
    shape = FaceShape()
    x, y, z = (float(value) for value in shape.nose_tip())
    assert (x, y) == (0.0, 0.155)
    np.testing.assert_allclose(shape.depth_at(x, y), z, rtol=1e-15)
    assert _slopes_at_the_tip(shape) <= 1e-14
    angles = np.arange(16) * np.pi / 8
    around = shape.depth_at(x + 1e-3 * np.cos(angles), y + 1e-3 * np.sin(angles))
    assert float(jnp.max(around)) <= z - 0.5 * 5 * 1e-6  # a radius of curvature below 1/5 in every direction
    grid = np.stack(np.meshgrid(np.linspace(-0.32, 0.32, 401), np.linspace(-0.5, 0.5, 601)), axis=-1)
    assert float(jnp.max(shape.depth_at(grid[..., 0], grid[..., 1]))) <= z


@pytest.mark.parametrize(("name", "value"), [("nose_height", 0.09), ("nose_y", 0.17), ("eye_distance", 0.3)])
def test_the_tip_is_exact_for_other_faces(x64, name, value):
    shape = FaceShape(**{name: value})
    tip = shape.nose_tip()
    assert _slopes_at_the_tip(shape) <= 1e-14
    if name == "nose_height":
        np.testing.assert_allclose(tip[2], FaceShape().nose_tip()[2] - 0.025, rtol=1e-14)


def test_where_the_tip_is_in_pixels(x64, picture):
    depth_map = picture[0]
    tip = FaceShape().nose_tip_pixel(HEIGHT, WIDTH)
    # The middle of the picture is between the pupils; a pixel is 1.15 / 92 = 0.0125 head heights.
    np.testing.assert_allclose(tip, [34.5, 45.5 + 0.155 / 0.0125], rtol=1e-14)
    np.testing.assert_allclose(depth_map.spacing, 0.0125, rtol=1e-15)
    row, column = np.unravel_index(np.argmax(np.where(depth_map.mask, depth_map.depth, -1)), depth_map.shape)
    assert abs(column - float(tip[0])) <= 0.5
    assert abs(row - float(tip[1])) <= 0.5


def test_proportions(x64, picture):
    """Crown and chin a head height apart, the eyes midway; breadth about two thirds."""
    mask = np.asarray(picture[0].mask)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    assert 0.97 <= len(rows) * 0.0125 <= 1.0
    assert abs(rows.mean() - (HEIGHT - 1) / 2) <= 1
    assert 0.60 <= len(columns) * 0.0125 <= 0.66


def test_symmetric(x64, picture):
    depth_map, albedo = picture
    np.testing.assert_allclose(depth_map.depth, depth_map.depth[:, ::-1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(albedo, albedo[:, ::-1], rtol=0, atol=1e-13)
    assert bool(jnp.all(depth_map.mask == depth_map.mask[:, ::-1]))


def test_the_albedo_is_darker_where_it_should_be(x64, picture):
    albedo = np.asarray(picture[1])
    assert albedo.min() >= 0
    assert albedo.max() <= 1

    def at(x, y):
        return albedo[round(y / 0.0125 + 45.5), round(x / 0.0125 + 34.5)]

    skin = at(0.0, -0.2)
    assert skin > 0.75
    for x, y in [(0.13, -0.105), (0.0, 0.31), (0.0, -0.45), (0.135, 0.0)]:  # brow, lower lip, hair, pupil
        assert at(x, y) < 0.8 * skin
    assert at(0.135 - 0.04, 0.0) > skin - 0.1  # the white of the eye


def test_every_measure_is_differentiable(x64):
    """Against central differences, at scattered points; and forward against reverse."""
    points = np.random.default_rng(0).uniform(-0.3, 0.45, (40, 2))
    weights = np.random.default_rng(1).normal(size=40)
    leaves, structure = jax.tree.flatten(FaceShape())
    start = jnp.stack(leaves)

    @jax.jit
    def value(vector):
        shape = jax.tree.unflatten(structure, list(vector))
        return jnp.sum(weights * shape.depth_at(points[:, 0], points[:, 1]))

    reverse = jax.jit(jax.grad(value))(start)
    assert np.count_nonzero(np.asarray(reverse)) == len(leaves)
    direction = jnp.asarray(np.random.default_rng(2).normal(size=len(leaves)))
    forward = jax.jit(lambda vector: jax.jvp(value, (vector,), (direction,))[1])(start)
    np.testing.assert_allclose(forward, jnp.sum(reverse * direction), rtol=1e-11)
    step = 1e-5
    numeric = [(value(start.at[i].add(step)) - value(start.at[i].add(-step))) / (2 * step) for i in range(len(leaves))]
    np.testing.assert_allclose(reverse, numeric, rtol=1e-4, atol=1e-6)


def test_single_precision_and_batches():
    shapes = jax.vmap(lambda height: FaceShape(nose_height=height))(jnp.asarray([0.1, 0.12]))
    depths = jax.vmap(lambda shape: face(HEIGHT, WIDTH, shape=shape).depth)(shapes)
    assert depths.dtype == np.float32
    alone = face(HEIGHT, WIDTH, shape=FaceShape(nose_height=0.12))
    np.testing.assert_allclose(depths[1], alone.depth, rtol=0, atol=1e-5)


def test_the_shaded_face_is_a_picture(x64, picture):
    shaded = np.asarray(shade(picture[0], albedo=picture[1]))
    assert shaded.min() >= 0
    assert shaded.max() <= 1
    assert 0.15 < shaded[np.asarray(picture[0].mask)].std() < 0.4


@pytest.mark.parametrize("size", [(0, 4), (4, 0), (-1, 4)])
def test_a_picture_without_pixels(size):
    with pytest.raises(ValueError, match="at least one pixel"):
        face(*size)
