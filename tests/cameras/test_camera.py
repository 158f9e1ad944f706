"""Cameras: rays to pixels and back, pictures resized, cropped and turned, and what is marked in them."""

import cv2
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

import jaxlens as jl

PLAIN = [-0.28, 0.07, 0.001, -0.002, 0.01]


def camera(lens=None, width=64, height=48):
    lens = jl.RadialPolynomial([-0.28, 0.07], center=[0.01, -0.02]) if lens is None else lens
    return jl.Camera(lens, jl.Frame([30.3, 24.1], [52.0, 53.0]), width, height)


def fisheye(width=64, height=48):
    return jl.Camera(jl.KannalaBrandt([0.05, -0.01]), jl.Frame([31.0, 24.5], 20.0), width, height)


def pixels_of(one, count=9):
    return np.random.default_rng(0).uniform([0, 0], [one.width - 1, one.height - 1], (count, 2))


def test_pixels_are_those_of_opencv(x64):
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 1], [0.5, 0.4, 3], (20, 3))
    vector, translation = np.array([0.1, -0.2, 0.05]), np.array([0.1, 0.05, 0.3])
    one = camera(jl.BrownConrady(PLAIN))
    expected, _ = cv2.projectPoints(points, vector, translation, np.asarray(one.frame.camera_matrix()), np.array(PLAIN))
    pose = jaxlie.SE3.from_rotation_and_translation(jaxlie.SO3.exp(jnp.asarray(vector)), jnp.asarray(translation))
    np.testing.assert_allclose(one.project(points, pose), expected[:, 0], rtol=0, atol=1e-9)
    moved = points @ np.asarray(pose.rotation().as_matrix()).T + translation
    np.testing.assert_allclose(one.project(moved), expected[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("make", [camera, fisheye])
def test_rays_and_back(x64, make):
    one = make()
    rays = one.unproject(pixels_of(one))
    np.testing.assert_allclose(jnp.linalg.norm(rays, axis=-1), 1, rtol=1e-14)
    np.testing.assert_allclose(one.project(3 * rays), pixels_of(one), rtol=0, atol=1e-9)


def test_what_is_not_seen():
    seen = camera().project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [0.1, 0.0, 1.0]]))
    assert jnp.isnan(seen).any(-1).tolist() == [True, True, True, False]
    # A fisheye sees behind itself.
    assert bool(jnp.isfinite(fisheye().project(np.array([1.0, 0.0, -0.1]))).all())


def test_a_resized_picture_keeps_its_corners(x64):
    half = camera().resized(32, 12)
    assert (half.width, half.height) == (32, 12)
    ray = camera().unproject(np.array([[-0.5, -0.5], [63.5, 47.5], [20.0, 10.0]]))
    np.testing.assert_allclose(half.project(ray), [[-0.5, -0.5], [31.5, 11.5], [9.75, 2.125]], atol=1e-9)


def test_a_cropped_picture(x64):
    part = camera().cropped(5, 7, 20, 30)
    assert (part.width, part.height) == (30, 20)
    ray = camera().unproject(pixels_of(camera()))
    np.testing.assert_allclose(part.project(ray), pixels_of(camera()) - [7, 5], rtol=0, atol=1e-9)


class Slanted(jl.Lens):
    """A lens of one's own, with nothing but `distort`."""

    slant: jax.Array

    def distort(self, points):
        x, y = points[..., 0], points[..., 1]
        return jnp.stack([x + self.slant * y * y, y + 0.5 * self.slant * x * x * x], axis=-1)


LENSES = {
    "brown": lambda: jl.BrownConrady([-0.2, 0.05, 0.01, -0.02, 0.01, 0.02, 0.01, 0.0]),
    "tilted": lambda: jl.BrownConrady([-0.2, 0.05, 0.01, -0.02, 0, 0, 0, 0, 0.01, 0.02, -0.01, 0.03, 0.0, 0.05]),
    "twice tilted": lambda: jl.BrownConrady([-0.2, 0.05, 0.01, -0.02, *[0.0] * 8, 0.04, 0.05]),
    "radial": lambda: jl.RadialPolynomial([-0.2, 0.03], center=[0.1, -0.05]),
    "fisheye": lambda: jl.KannalaBrandt([0.05, -0.01]),
    "unified": lambda: jl.UnifiedCamera(0.9, [-0.1, 0.02, 0.01, -0.02]),
    "panorama": lambda: jl.Equirectangular(),
    "own": lambda: Slanted(jnp.asarray(0.1)),
}


QUICK = ["radial", "brown", "panorama"]


@pytest.mark.parametrize(
    "kind", [kind if kind in QUICK else pytest.param(kind, marks=pytest.mark.slow) for kind in LENSES]
)
def test_a_turned_picture(x64, kind):
    """A point that was seen at (x, y) is seen where `np.rot90` brings that pixel, of the ray turned likewise."""
    one, rows = camera(LENSES[kind]()), np.mgrid[:48, :64]
    rays = np.random.default_rng(0).uniform([-0.5, -0.5, 1], [0.5, 0.5, 1], (6, 3))
    for quarters in (1, 2, -1, 4):
        turned = one.rotated(quarters)
        y, x = (np.rot90(plane, quarters) for plane in rows)
        assert (turned.height, turned.width) == x.shape
        # Of turned pixels, to those before: affine, by three corners.
        matrix = np.array([[x[0, 1] - x[0, 0], x[1, 0] - x[0, 0]], [y[0, 1] - y[0, 0], y[1, 0] - y[0, 0]]], float)
        seen = turned.project(np.concatenate([rays[:, :2] @ matrix, rays[:, 2:]], axis=-1))
        np.testing.assert_allclose(
            seen @ matrix.T + np.array([[x[0, 0], y[0, 0]]]), one.project(rays), rtol=0, atol=1e-9
        )
    assert type(one.rotated(4).lens) is type(one.lens)


def test_a_turned_lens_is_inverted(x64):
    one = camera(jl.Equirectangular()).rotated(1)
    rays = np.array([[0.3, -0.2, 1.0], [0.5, 0.5, -0.2]])
    found = one.unproject(one.project(rays))
    np.testing.assert_allclose(found, rays / np.linalg.norm(rays, axis=-1, keepdims=True), rtol=0, atol=1e-12)
    assert float(one.lens.field_of_view()) == pytest.approx(np.pi)


def test_points_go_where_the_target_sees_them(x64):
    one, flat = camera(), camera().view(keep="valid")
    points = np.array([[30.0, 20.0], [10.0, 40.0]])
    sent = one.transfer(points, flat)
    np.testing.assert_allclose(sent, flat.project(one.unproject(points)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(flat.transfer(sent, one), points, rtol=0, atol=1e-9)
    # Beyond the edge of the target's picture.
    assert bool(jnp.isnan(one.transfer(np.array([0.0, 0.0]), flat)).all())
    rotation = jaxlie.SO3.exp(jnp.array([0.02, 0.05, 0.1]))
    turned = one.transfer(points, flat, rotation)
    back = np.asarray(one.unproject(points)) @ np.asarray(rotation.as_matrix())
    np.testing.assert_allclose(turned, flat.project(back), rtol=0, atol=1e-9)
    np.testing.assert_allclose(flat.transfer(turned, one, rotation.inverse()), points, rtol=0, atol=1e-9)


def dense_bound(one, target, box, count=20001):
    t = np.linspace(0, 1, count)
    x0, y0, x1, y1 = box
    edges = [(x0 + t * (x1 - x0), y0 + 0 * t), (x0 + t * (x1 - x0), y1 + 0 * t)]
    edges += [(x0 + 0 * t, y0 + t * (y1 - y0)), (x1 + 0 * t, y0 + t * (y1 - y0))]
    outline = np.concatenate([np.stack(edge, axis=-1) for edge in edges])
    sent = np.asarray(target.project(one.unproject(outline)))
    return np.concatenate([np.nanmin(sent, axis=0), np.nanmax(sent, axis=0)])


BOXES = np.array([[5.0, 6.0, 40.0, 30.0], [20.0, 1.0, 60.0, 46.0], [-3.0, 20.0, 20.0, 60.0]])


@pytest.mark.parametrize("make", [fisheye, pytest.param(camera, marks=pytest.mark.slow)])
def test_boxes_bound_their_bent_outline(x64, make):
    one = make()
    target = one.view(keep="all", projection="stereographic" if make is fisheye else "perspective")
    sent = np.asarray(one.transfer(BOXES, target))
    dense = np.stack([dense_bound(one, target, box) for box in BOXES])
    np.testing.assert_allclose(sent[:2], dense[:2], rtol=0, atol=1e-6)
    # Of the last, the fisheye does not see all: the bound is of what it sees.
    np.testing.assert_allclose(sent[2], dense[2], rtol=0, atol=0.5 if make is fisheye else 1e-6)
    assert (sent[2] * [-1, -1, 1, 1] >= dense[2] * [-1, -1, 1, 1] - 1e-6).all()
    # An edge bulges beyond the corners.
    corners = target.project(one.unproject(BOXES[1].reshape(2, 2)))
    assert np.abs(sent[1] - np.asarray(corners).ravel()).max() > 0.5
    assert bool(jnp.isnan(one.transfer(np.array([500.0, 0.0, 510.0, 9.0]), target)).all())
    assert one.transfer(np.zeros((0, 4)), target).shape == (0, 4)


@pytest.mark.slow
def test_a_bound_is_differentiated(x64):
    one, target = camera(), camera().view()
    box = jnp.asarray(BOXES[1])
    found = jax.jacfwd(lambda box: one.transfer(box, target))(box)
    step = 1e-5
    for k in range(4):
        change = step * jnp.eye(4)[k]
        expected = (one.transfer(box + change, target) - one.transfer(box - change, target)) / (2 * step)
        np.testing.assert_allclose(found[:, k], expected, rtol=0, atol=1e-5)


def test_misuse(untyped):
    with pytest.raises(ValueError, match=r"Frame.from_camera_matrix"):
        jl.Camera(jl.Perspective(), np.eye(3), 64, 48)
    with pytest.raises(ValueError, match="a camera has a lens, got list"):
        jl.Camera([0.1], jl.Frame([0.0, 0.0], 1.0), 64, 48)
    with pytest.raises(ValueError, match=r"width of pictures is a whole number of pixels, got 6\.5"):
        jl.Camera(jl.Perspective(), jl.Frame([0.0, 0.0], 1.0), 6.5, 48)
    with pytest.raises(ValueError, match="at least one pixel, got 0"):
        camera().resized(0, 5)
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\) or boxes of shape"):
        camera().transfer(np.zeros((5, 3)), camera())
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3\)"):
        camera().project(np.zeros(2))
    with pytest.raises(ValueError, match="is no rotation"):
        camera().transfer(np.zeros(2), camera(), 2 * np.eye(3))
    with pytest.raises(ValueError, match=r"got shape \(2, 2\)"):
        camera().transfer(np.zeros(2), camera(), np.eye(2))
