"""Pictures from camera to camera: beside OpenCV, labels, batches and derivatives."""

import cv2
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from pictures import smooth

import jaxlens as jl

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

MATRIX = np.array([[52.0, 0, 31.3], [0, 53.0, 24.1], [0, 0, 1]])
NEW = np.array([[40.0, 0, 30.0], [0, 41.0, 20.0], [0, 0, 1]])
BROWN = np.array([-0.28, 0.07, 0.001, -0.002, 0.01])
FISHEYE = np.array([0.05, -0.01, 0.002, -0.0005])
TURN = np.array([0.1, 0.2, 0.05])
RADIAL = jl.RadialPolynomial(np.array([-0.28, 0.07]))
PICTURE = smooth(np.float32, height=48, width=64)


def cameras(lens, size=(64, 48)):
    source = jl.Camera(lens, jl.Frame.from_camera_matrix(MATRIX), 64, 48)
    return source, jl.Camera(jl.Perspective(), jl.Frame.from_camera_matrix(NEW), *size)


@pytest.mark.parametrize("turned", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_maps_are_those_of_opencv(x64, turned):
    vector = TURN if turned else np.zeros(3)
    rotation = cv2.Rodrigues(vector)[0]
    for lens, function, numbers in (
        (jl.BrownConrady(BROWN), cv2.initUndistortRectifyMap, BROWN),
        (jl.KannalaBrandt(FISHEYE), cv2.fisheye.initUndistortRectifyMap, FISHEYE),
    ):
        source, target = cameras(lens, (70, 40))
        x, y = function(MATRIX, numbers, rotation, NEW, (70, 40), cv2.CV_32FC1)
        mapping = jl.cameras.sight(source.lens, target.lens, rotation.T if turned else None)
        found = jl.source_coordinates(mapping, 48, 64, frame=source.frame, output_frame=target.frame, shape=(40, 70))
        np.testing.assert_allclose(found, np.stack([x, y], axis=-1), rtol=0, atol=3e-5)  # CV_32FC1
    picture = jl.reproject(PICTURE, source, target, rotation.T if turned else None)
    np.testing.assert_allclose(picture, cv2.remap(PICTURE, x, y, cv2.INTER_LINEAR), rtol=0, atol=1e-3)


def test_points_go_where_the_picture_goes(x64):
    """A bright spot is found where `transfer` says."""
    source, target = cameras(jl.KannalaBrandt(FISHEYE))
    target = source.view(fov=100, size=(80, 60), projection="cylindrical")
    rotation = jaxlie.SO3.exp(jnp.asarray(TURN))
    spot = np.array([25.0, 30.0])
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    image = np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / 8)
    picture = np.asarray(jl.reproject(image, source, target, rotation, method="bicubic"))
    row, column = np.unravel_index(picture.argmax(), picture.shape)
    assert np.abs(np.asarray(source.transfer(spot, target, rotation)) - [column, row]).max() < 0.6


def test_labels_stay_labels():
    source, target = cameras(jl.KannalaBrandt(FISHEYE))
    labels = np.random.default_rng(0).choice(np.array([3, 7, 200], np.uint8), (48, 64))
    out = np.asarray(jl.reproject(labels, source, source.view(keep="same"), method="nearest", fill=255))
    assert out.dtype == np.uint8
    assert set(np.unique(out)) <= {3, 7, 200, 255}
    depth = np.random.default_rng(0).choice(np.array([0.1, 2.7], np.float32), (48, 64))
    out = np.asarray(jl.reproject(depth, source, target, method="nearest", fill=-1.0))
    assert set(np.unique(out)) <= {np.float32(0.1), np.float32(2.7), np.float32(-1)}


@pytest.mark.slow
def test_there_and_back(x64):
    source, _ = cameras(RADIAL)
    image = smooth(np.float64, height=48, width=64)
    wide = source.view(keep="all", size=(256, 192))
    again = jl.reproject(jl.reproject(image, source, wide, method="bicubic"), wide, source, method="bicubic")
    np.testing.assert_allclose(again[2:-2, 2:-2], image[2:-2, 2:-2], rtol=0, atol=2e-3)


def test_undistorting_is_a_view():
    source, _ = cameras(RADIAL)
    expected = jl.undistort_image(PICTURE, source.lens, frame=source.frame)
    np.testing.assert_array_equal(jl.reproject(PICTURE, source, source.view()), expected)


def test_a_target_that_looks_past_the_source():
    """Of what a camera sees that is turned by a right angle, a fisheye sees a part, and a flat camera nothing."""
    source, target = cameras(jl.KannalaBrandt(FISHEYE))
    side = jaxlie.SO3.exp(jnp.array([0.0, np.pi / 2, 0.0]))
    flat = jl.Camera(RADIAL, source.frame, 64, 48)
    ones = np.ones((48, 64), np.float32)
    assert float(jl.reproject(ones, flat, target, side).max()) == 0
    there = jl.reproject(ones, jl.Camera(source.lens, jl.Frame([31.5, 23.5], 15.0), 64, 48), target, side)
    assert 0.1 < float(there.mean()) < 0.9
    assert float(there[:, 0].mean()) > float(there[:, -1].mean())


class Slanted(jl.Lens):
    """A lens of one's own, with nothing but `distort`."""

    slant: jax.Array

    def distort(self, points):
        x, y = points[..., 0], points[..., 1]
        return jnp.stack([x + self.slant * y * y, y + 0.5 * self.slant * x * x * x], axis=-1)


def test_a_lens_of_ones_own(x64):
    source, target = cameras(Slanted(jnp.asarray(0.1)))
    rays = target.unproject(np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), axis=-1))
    expected = jl.remap(PICTURE, source.project(rays))
    np.testing.assert_allclose(jl.reproject(PICTURE, source, target), expected, rtol=0, atol=1e-5)
    panorama = source.view(projection="equirectangular")
    rays = panorama.unproject(np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), axis=-1))
    expected = jl.remap(PICTURE, source.project(rays))
    np.testing.assert_allclose(jl.reproject(PICTURE, source, panorama), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("lens", [pytest.param(jl.BrownConrady, marks=pytest.mark.slow), jl.KannalaBrandt])
def test_a_batch_of_cameras(x64, lens):
    numbers = np.stack([BROWN[:4], 0.5 * BROWN[:4]])
    matrices = jnp.stack([jnp.eye(3), jaxlie.SO3.exp(jnp.asarray(TURN)).as_matrix()])
    make = lambda numbers: cameras(lens(numbers))[0]  # noqa: E731
    together = jax.vmap(make)(numbers)
    target = cameras(lens(numbers[0]))[1]
    found = jax.vmap(lambda camera, matrix: jl.reproject(PICTURE, camera, target, matrix))(together, matrices)
    for one, matrix, picture in zip(numbers, matrices, found, strict=True):
        np.testing.assert_allclose(picture, jl.reproject(PICTURE, make(one), target, matrix), rtol=0, atol=1e-5)


@pytest.mark.parametrize("lens", [pytest.param(jl.BrownConrady, marks=pytest.mark.slow), jl.KannalaBrandt])
def test_derivatives(x64, lens):
    source, target = cameras(lens(BROWN[:4]))
    image = jnp.asarray(smooth(np.float64, 1, height=48, width=64))
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(48, 64)))

    def total(source, vector):
        # The border's pixels come and go with the coordinates: no place to differentiate.
        picture = jl.reproject(image, source, target, jaxlie.SO3.exp(vector), method="bicubic", border="edge")
        return jnp.sum(weights * picture)

    vector = jnp.asarray(TURN)
    gradient = jax.grad(total, argnums=(0, 1))(source, vector)
    key = np.random.default_rng(1)
    change = jax.tree.map(lambda leaf: jnp.asarray(key.normal(size=leaf.shape)), (source, vector))
    _, forward = jax.jvp(total, (source, vector), change)
    backward = sum(jnp.vdot(a, b) for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(change), strict=True))
    step = 1e-6
    ahead, behind = (
        total(*jax.tree.map(lambda leaf, d: leaf + sign * step * d, (source, vector), change))  # noqa: B023
        for sign in (1, -1)
    )
    np.testing.assert_allclose(backward, forward, rtol=1e-10)
    np.testing.assert_allclose(forward, (ahead - behind) / (2 * step), rtol=1e-5)


def test_misuse(untyped):
    source, target = cameras(RADIAL)
    with pytest.raises(ValueError, match="the image is 48 × 64 pixels, and the source camera's are 64 × 48"):
        jl.reproject(PICTURE.transpose(1, 0, 2), source, target)
    with pytest.raises(ValueError, match="at least one pixel"):
        jl.reproject(np.zeros(5), source, target)
    with pytest.raises(ValueError, match="is no rotation"):
        jl.reproject(PICTURE, source, target, np.ones((3, 3)))
