import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens import pyramid

footprint = jax.jit(pyramid.footprint)


@jax.jit
def build_pyramid(image):
    return pyramid.build_pyramid(image, lambda level: level.reshape(-1, level.shape[-1]))


def levels_of(built):
    sizes = np.stack([built.offsets, built.heights, built.widths], axis=-1)
    pixels = np.asarray(built.pixels)
    return [pixels[offset : offset + height * width].reshape(height, width, -1) for offset, height, width in sizes]


def grid_of(matrix, shape=(5, 6), dtype="float64"):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return (np.stack([x, y], axis=-1) @ np.transpose(matrix) + [3, -2]).astype(dtype)


@pytest.mark.parametrize(
    ("shape", "sizes"),
    [
        ((1, 1), [(1, 1)]),
        ((1, 9), [(1, 9)]),
        ((2, 2), [(2, 2), (1, 1)]),
        ((5, 8), [(5, 8), (3, 4), (2, 2), (1, 1)]),
        ((8, 40), [(8, 40), (4, 20), (2, 10), (1, 5)]),
    ],
)
def test_levels_halve_rounding_up(shape, sizes):
    image = np.random.default_rng(0).uniform(size=(*shape, 2)).astype(np.float32)
    built = build_pyramid(image)
    levels = levels_of(built)
    assert [level.shape for level in levels] == [(*size, 2) for size in sizes]
    assert len(built.pixels) == sum(height * width for height, width in sizes)
    np.testing.assert_array_equal(levels[0], image)


def test_each_level_is_the_mean_of_the_one_before():
    image = np.random.default_rng(1).uniform(size=(16, 8, 3)).astype(np.float32)
    for level, finer in enumerate(levels_of(build_pyramid(image))):
        count = 2**level
        means = image.reshape(16 // count, count, 8 // count, count, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(finer, means, rtol=1e-6)


def test_odd_sides_repeat_their_last_line():
    image = np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9]], np.float32)[..., None]
    half = levels_of(build_pyramid(image))[1][..., 0]
    np.testing.assert_allclose(half, [[3, 4.5], [7.5, 9]])


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "matrix",
    [
        [[1, 0], [0, 1]],
        [[3, 0], [0, 2]],
        [[0.5, 0], [0, 4]],
        [[0, -2], [2, 0]],
        [[1.5, 2.0], [-0.7, 0.3]],
        [[2, 4], [1, 2]],
        [[0, 0], [0, 0]],
    ],
)
def test_the_footprint_has_the_singular_values_of_the_jacobian(matrix):
    direction, longer, shorter = (np.asarray(values) for values in footprint(grid_of(matrix)))
    left, values, _ = np.linalg.svd(matrix)
    np.testing.assert_allclose(longer, np.full((5, 6), values[0]), atol=1e-14)
    # The shorter axis is a difference of squares: where it vanishes, rounding is all that is left.
    np.testing.assert_allclose(shorter, np.full((5, 6), values[1]), atol=1e-12 if values[1] else 1e-7)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), np.ones((5, 6)), atol=1e-14)
    if values[0] > values[1] + 1e-9:
        along = np.abs(np.sum(direction * left[:, 0], axis=-1))  # up to its sign
        np.testing.assert_allclose(along, np.ones((5, 6)), atol=1e-14)


@pytest.mark.usefixtures("x64")
def test_differences_are_central_inside_and_one_sided_at_the_edge():
    x = np.arange(6.0) ** 2
    coordinates = np.stack(np.broadcast_arrays(x, np.zeros((4, 1))), axis=-1)
    _, longer, shorter = footprint(coordinates)
    np.testing.assert_allclose(longer, np.broadcast_to([1, 2, 4, 6, 8, 9], (4, 6)), atol=1e-14)
    np.testing.assert_allclose(shorter, np.zeros((4, 6)), atol=1e-7)


@pytest.mark.usefixtures("x64")
def test_coordinates_that_are_not_finite_are_left_out():
    coordinates = grid_of([[3, 0], [0, 2]])
    coordinates[2, 2] = np.nan
    coordinates[0, 5, 1] = np.inf
    direction, longer, shorter = footprint(coordinates)
    known = np.isfinite(coordinates).all(axis=-1)
    np.testing.assert_allclose(longer[known], np.full(28, 3), atol=1e-14)
    np.testing.assert_allclose(shorter[known], np.full(28, 2), atol=1e-14)
    assert all(np.all(np.isfinite(values)) for values in (direction, longer, shorter))


def test_huge_steps_do_not_overflow(dtype):
    coordinates = grid_of([[1, 0], [0, 1]], dtype=dtype)
    coordinates[2, 2] = np.finfo(dtype).max
    coordinates[3, 3] = -np.finfo(dtype).max / 2
    direction, longer, shorter = footprint(coordinates)
    assert all(np.all(np.isfinite(values)) for values in (direction, longer, shorter))
    assert np.all(longer[2, np.array([1, 3])] > 1e6)
    np.testing.assert_allclose(longer[0], np.ones(6), rtol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (4, 1), (0, 3), (3, 0)])
def test_small_grids(shape):
    direction, longer, shorter = footprint(grid_of([[3, 0], [0, 2]], shape, "float32"))
    height, width = shape
    assert direction.shape == (*shape, 2)
    # Along an axis of length one there is nothing to compare.
    axes = sorted([3.0 * (width > 1), 2.0 * (height > 1)])
    np.testing.assert_allclose(longer, np.full(shape, axes[1]), atol=1e-6)
    np.testing.assert_allclose(shorter, np.full(shape, axes[0]), atol=1e-6)


def test_the_footprint_carries_no_derivatives():
    coordinates = jnp.asarray(grid_of([[3, 0], [1, 2]], dtype="float32"))
    slopes = jax.grad(lambda c: sum(jnp.sum(values) for values in footprint(c)))(coordinates)
    np.testing.assert_array_equal(slopes, np.zeros((5, 6, 2)))
