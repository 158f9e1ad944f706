import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import jaxlens as jl

EPSILON = {"float32": 2.0**-23, "float64": 2.0**-52}


@pytest.fixture
def _untyped():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def test_half_diagonal(dtype):
    """Eq. 10 on a 3-4-5 picture: the centre is (w/2, h/2), the corner of the picture lies at radius one."""
    frame = jl.Frame.half_diagonal(480, 640)
    assert frame.center.dtype == frame.scale.dtype == dtype
    np.testing.assert_array_equal(frame.center, [320, 240])
    np.testing.assert_array_equal(frame.scale, [400, 400])
    pixels = jnp.asarray([[320, 240], [0, 0], [640, 480], [0, 480], [720, 240]], dtype)
    np.testing.assert_allclose(
        frame.normalize(pixels), [[0, 0], [-0.8, -0.6], [0.8, 0.6], [-0.8, 0.6], [1, 0]], atol=EPSILON[dtype]
    )


def test_smallest_picture(dtype):
    frame = jl.Frame.half_diagonal(1, 1)
    np.testing.assert_array_equal(frame.center, [0.5, 0.5])
    np.testing.assert_allclose(frame.scale, 0.5**0.5, rtol=EPSILON[dtype])


def test_camera_matrix(dtype):
    matrix = np.asarray([[500, 0, 320.5], [0, 510, 239.25], [0, 0, 1]], dtype)
    frame = jl.Frame.from_camera_matrix(matrix)
    np.testing.assert_array_equal(frame.center, matrix[:2, 2])
    np.testing.assert_array_equal(frame.scale, [500, 510])
    np.testing.assert_array_equal(frame.camera_matrix(), matrix)
    assert frame.camera_matrix().dtype == dtype
    points = np.asarray([[0.1, -0.2], [0, 0]], dtype)
    homogeneous = np.concatenate([points, np.ones((2, 1), dtype)], -1) @ matrix.T
    np.testing.assert_allclose(frame.denormalize(points), homogeneous[:, :2], rtol=2 * EPSILON[dtype])


def test_one_scale_serves_both_axes():
    frame = jl.Frame([1.0, 2.0], 4.0)
    np.testing.assert_array_equal(frame.scale, [4, 4])
    np.testing.assert_array_equal(frame.denormalize(jnp.ones((1, 2))), [[5, 6]])


def test_zoom_enlarges_about_the_center():
    frame = jl.Frame([10.0, 20.0], [3.0, 4.0]).zoomed(2.0)
    np.testing.assert_array_equal(frame.center, [10, 20])
    np.testing.assert_array_equal(frame.denormalize(jnp.ones((1, 2))), [[16, 28]])


@pytest.mark.parametrize("shape", [(2,), (7, 2), (5, 3, 2), (0, 2)])
def test_round_trip(dtype, shape):
    frame = jl.Frame([311.7, 250.2], [480.3, 517.9])
    pixels = np.random.default_rng(0).uniform(-100, 800, shape).astype(dtype)
    back = frame.denormalize(frame.normalize(pixels))
    assert back.shape == shape
    assert back.dtype == dtype
    np.testing.assert_allclose(back, pixels, atol=4 * EPSILON[dtype] * 1000)


def test_jit_vmap_and_gradients(x64):
    frames = jax.vmap(jl.Frame)(jnp.asarray([[1.0, 2.0], [3.0, 4.0]]), jnp.asarray([[5.0, 6.0], [7.0, 8.0]]))
    points = jax.random.normal(jax.random.key(0), (2, 5, 2))
    together = jax.jit(jax.vmap(lambda frame, points: frame.normalize(points)))(frames, points)
    for i in range(2):
        alone = jax.tree.map(lambda leaf, i=i: leaf[i], frames)
        np.testing.assert_allclose(together[i], alone.normalize(points[i]), rtol=4e-16)
        gradient = jax.grad(lambda frame, i=i: frame.normalize(points[i]).sum())(alone)
        np.testing.assert_allclose(gradient.center, -5 / alone.scale, rtol=1e-14)
        moments = points[i].sum(0) - 5 * alone.center
        np.testing.assert_allclose(gradient.scale, -moments / alone.scale**2, rtol=1e-13)


def test_dtype_rule(x64):
    """Typed input keeps its type; nothing is promoted behind one's back, nor cut down."""
    single = jl.Frame(np.float32([1, 2]), np.float32([3, 4]))
    assert single.normalize(np.ones((1, 2), np.float32)).dtype == np.float32
    assert single.normalize(np.ones((1, 2))).dtype == np.float64
    assert jl.Frame([1, 2], 3).center.dtype == np.float64


@pytest.mark.usefixtures("_untyped")
def test_misuse():
    frame = jl.Frame.half_diagonal(4, 3)
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\) in \(x, y\) order, got \(5, 3\)"):
        frame.normalize(jnp.ones((5, 3)))
    with pytest.raises(ValueError, match=r"got \(\)"):
        frame.denormalize(1.0)
    with pytest.raises(ValueError, match="complex64"):
        frame.normalize(jnp.ones((5, 2), jnp.complex64))
    with pytest.raises(ValueError, match=r"camera matrix has shape \(3, 3\), got \(2, 3\)"):
        jl.Frame.from_camera_matrix(jnp.ones((2, 3)))
    with pytest.raises(ValueError, match="2"):
        jl.Frame([1.0, 2.0, 3.0], 1.0)


@pytest.mark.usefixtures("_untyped")
def test_lists_and_integers_are_welcome():
    frame = jl.Frame.half_diagonal(480, 640)
    expected = frame.normalize(jnp.asarray([[1.0, 2.0]]))
    np.testing.assert_array_equal(frame.normalize([[1, 2]]), expected)
    np.testing.assert_array_equal(frame.normalize(np.asarray([[1, 2]])), expected)
    np.testing.assert_array_equal(jl.Frame.from_camera_matrix([[2, 0, 1], [0, 3, 4], [0, 0, 1]]).scale, [2, 3])
