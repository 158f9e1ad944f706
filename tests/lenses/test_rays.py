"""Rays through lenses: projections against their equations and other software, folds against a search, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxlens as jl

ANGLES = np.linspace(0, np.pi, 20_001)[1:-1]

# The observed radius of each lens over the angle from its axis, as their authors write it.
RADII = {
    "perspective": (jl.Perspective, np.tan, np.pi / 2),
    "equidistant": (jl.Equidistant, lambda t: t, np.pi),
    "equisolid": (jl.Equisolid, lambda t: 2 * np.sin(t / 2), np.pi),
    "stereographic": (jl.Stereographic, lambda t: 2 * np.tan(t / 2), np.pi),
    "orthographic": (jl.Orthographic, np.sin, np.pi / 2),
}


def kannala_brandt(*k):
    return lambda: jl.KannalaBrandt(np.array(k)), lambda t: t * (1 + sum(c * t ** (2 * i + 2) for i, c in enumerate(k)))


def double_sphere(xi, alpha):
    def radius(t):
        return np.sin(t) / (alpha * np.hypot(np.sin(t), xi + np.cos(t)) + (1 - alpha) * (xi + np.cos(t)))

    return lambda: jl.DoubleSphere(xi, alpha), radius


def extended_unified(alpha, beta):
    def radius(t):
        return np.sin(t) / (alpha * np.sqrt(beta * np.sin(t) ** 2 + np.cos(t) ** 2) + (1 - alpha) * np.cos(t))

    return lambda: jl.ExtendedUnifiedCamera(alpha, beta), radius


def unified(xi):
    return lambda: jl.UnifiedCamera(xi), lambda t: np.sin(t) / (np.cos(t) + xi)


FAMILIES = [
    kannala_brandt(0.05, -0.01, 0.002, -0.0005),
    kannala_brandt(-0.1),
    double_sphere(-0.2, 0.6),
    double_sphere(0.5, 0.3),
    double_sphere(-0.9, 0.9),
    double_sphere(0.7, 0.9),
    extended_unified(0.6, 1.1),
    extended_unified(0.4, 2.0),
    extended_unified(0.9, 0.5),
    unified(0.5),
    unified(1.7),
]


def rays_at(angles, azimuth=0.7):
    return np.stack([np.sin(angles) * np.cos(azimuth), np.sin(angles) * np.sin(azimuth), np.cos(angles)], -1)


def first_fold(radius):
    """The angle before which the radius is finite, positive and grows, by looking."""
    with np.errstate(divide="ignore", invalid="ignore"):
        values = radius(ANGLES)
    grows = (np.diff(values) > 0) & (values[1:] > 0) & np.isfinite(values[1:])
    return ANGLES[np.argmin(grows)] if not grows.all() else np.pi


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", RADII)
def test_projections_without_parameters_keep_to_their_equations(name):
    make, radius, largest = RADII[name]
    lens, rays = make(), rays_at(ANGLES[::100])
    # The length of a ray does not count.
    seen = np.asarray(lens.project(rays * np.geomspace(1e-200, 1e200, len(rays))[:, None]))
    ahead = ANGLES[::100] < largest
    np.testing.assert_array_equal(np.isfinite(seen).all(-1), ahead)
    np.testing.assert_allclose(np.hypot(*seen[ahead].T), radius(ANGLES[::100][ahead]), rtol=1e-12)
    back = np.asarray(lens.unproject(seen))
    np.testing.assert_allclose(back[ahead], rays[ahead], rtol=0, atol=1e-7 if name == "orthographic" else 1e-10)
    assert float(lens.field_of_view()) == pytest.approx(largest)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: str(family[0]())[:40])
def test_a_wide_lens_sees_up_to_its_first_fold(family):
    make, radius = family
    lens, fold = make(), first_fold(radius)
    assert float(lens.field_of_view()) == pytest.approx(fold, abs=4 * ANGLES[0])
    clear = np.abs(ANGLES - fold) > 4 * ANGLES[0]
    observed = np.asarray(lens.project(rays_at(ANGLES)))[clear]
    ahead = ANGLES[clear] < fold
    np.testing.assert_array_equal(np.isfinite(observed).all(-1), ahead)
    np.testing.assert_allclose(np.hypot(*observed[ahead].T), radius(ANGLES[clear][ahead]), rtol=1e-12)
    found = lens.invert_projection(observed[ahead])
    assert bool(found.valid.all())
    # Next to a fold as much as half the digits are lost; a thousandth of it away all are there.
    near = ANGLES[clear][ahead] < 0.999 * fold
    np.testing.assert_allclose(found.points[near], rays_at(ANGLES)[clear][ahead][near], rtol=0, atol=2e-12)
    # Beyond the largest radius there is nothing, and that is said.
    if fold < np.pi and np.isfinite(largest := radius(np.array(fold - ANGLES[0]))) and largest < 100:
        beyond = lens.invert_projection(np.array([1.01 * largest, 0.0]))
        assert int(beyond.status) == jl.InverseStatus.NO_PREIMAGE
        assert bool(jnp.isfinite(beyond.points).all())


@pytest.mark.parametrize("make", [family[0] for family in FAMILIES[::3]])
def test_single_precision_keeps_its_digits(make):
    lens = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), make())
    angles = np.linspace(0, 0.97 * float(lens.field_of_view()), 500)
    rays = rays_at(angles).astype(np.float32)
    back = lens.unproject(lens.project(rays))
    assert back.dtype == jnp.float32
    np.testing.assert_allclose(back, rays, rtol=0, atol=1e-5)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("make", [FAMILIES[0][0], FAMILIES[2][0], FAMILIES[6][0], jl.Equirectangular, jl.Cylindrical])
def test_derivatives_are_finite_and_equal_to_differences(make):
    lens = make()
    rays = jnp.asarray([[0.0, 0.0, 1.0], [1e-3, 0.0, 1.0], [0.6, 0.8, 0.0], [0.5, -0.2, -0.05], [0.3, 0.1, 0.5]])
    forward = jax.vmap(jax.jacfwd(lens.project))(rays)
    np.testing.assert_allclose(jax.vmap(jax.jacrev(lens.project))(rays), forward, rtol=0, atol=1e-12)
    step = 1e-6 * np.eye(3)[:, None]
    before, after = (lens.project(np.asarray(rays) + sign * step) for sign in (-1, 1))
    differences = jnp.moveaxis((after - before) / 2e-6, 0, -1)
    np.testing.assert_allclose(forward, differences, rtol=0, atol=1e-8)
    # One way and back is the identity, up to the length of the ray.
    points = lens.project(rays)
    there_and_back = jax.vmap(lambda point: jax.jacfwd(lambda p: lens.project(lens.unproject(p)))(point))(points)
    np.testing.assert_allclose(there_and_back, np.broadcast_to(np.eye(2), (5, 2, 2)), rtol=0, atol=1e-9)
    assert bool(jnp.isfinite(jax.hessian(lens.project)(rays[0])).all())
    behind = jnp.asarray([0.0, 0.0, -1.0])
    gradient = jax.grad(lambda lens, ray: jnp.nansum(lens.project(jnp.stack([ray, behind]))), argnums=(0, 1))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(gradient(lens, rays[2])))


class Squeezed(jl.Lens):
    """A lens of one's own, not radial, that folds: nothing but `distort`."""

    strength: Float[Array, ""]

    def distort(self, points):
        x, y = points[..., 0], points[..., 1]
        squared = x * x + 1.5 * y * y
        return jnp.stack([x * (1 + self.strength * squared), y * (1 + 0.8 * self.strength * squared)], -1)


@pytest.mark.usefixtures("x64")
def test_a_lens_on_the_plane_sees_rays():
    lens = Squeezed(jnp.asarray(-0.3))
    ideal = np.random.default_rng(0).uniform(-1.6, 1.6, (2000, 2))
    inside = np.asarray(lens.one_to_one(ideal))
    assert 0.1 < inside.mean() < 0.9
    rays = np.concatenate([ideal, np.ones((2000, 1))], -1)
    lengths = np.geomspace(1e-6, 1e6, 2000)[:, None]
    observed = np.asarray(lens.project(lengths * rays))
    np.testing.assert_array_equal(np.isfinite(observed).all(-1), inside)
    np.testing.assert_allclose(observed[inside], lens.distort(ideal[inside]), rtol=1e-12)
    back = np.asarray(lens.unproject(observed))
    expected = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    np.testing.assert_allclose(back[inside], expected[inside], rtol=0, atol=1e-9)
    others = np.array([[0.1, 0.2, -1.0], [0.1, 0.2, 0.0], [0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 1]])
    assert np.isnan(lens.project(others)).all()
    assert int(lens.invert_projection(np.array([5.0, 0.0])).status) == jl.InverseStatus.NO_PREIMAGE
    # All directions within the field of view are seen.
    field = float(lens.field_of_view())
    assert np.isfinite(lens.project(np.stack([rays_at(0.999 * field, a) for a in np.linspace(0, 6.28, 200)]))).all()


@pytest.mark.usefixtures("x64")
def test_the_plane_and_the_rays_are_one_lens():
    lens = jl.DoubleSphere(-0.2, 0.6)
    ideal = np.random.default_rng(1).uniform(-2, 2, (300, 2))
    observed = lens.distort(ideal)
    rays = np.concatenate([ideal, np.ones((300, 1))], -1)
    np.testing.assert_allclose(observed, lens.project(rays), rtol=0, atol=1e-15)
    np.testing.assert_allclose(lens.undistort(observed), ideal, rtol=0, atol=1e-11)
    # Seen, but past a right angle: there is a ray, and no point of the plane.
    past = lens.project(np.array([1.0, 0.2, -0.1]))
    assert int(lens.invert(past).status) == jl.InverseStatus.NO_PREIMAGE
    assert bool(lens.invert_projection(past).valid)


@pytest.mark.usefixtures("x64")
def test_fisheyes_agree_with_opencv_and_colmap():
    cv2, random = pytest.importorskip("cv2"), np.random.default_rng(2)
    angles, azimuths = random.uniform(0, 1.5, 10_000), random.uniform(0, 2 * np.pi, 10_000)
    rays = np.stack([np.sin(angles) * np.cos(azimuths), np.sin(angles) * np.sin(azimuths), np.cos(angles)], -1)
    pycolmap = pytest.importorskip("pycolmap")
    for _ in range(20):
        k, (alpha, beta) = random.uniform(-0.01, 0.02, 4), random.uniform([0.3, 0.5], [0.7, 2.0])
        fisheye, eucm = jl.KannalaBrandt(k).project(rays), jl.ExtendedUnifiedCamera(alpha, beta).project(rays)
        expected = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), np.eye(3), k)[0][:, 0]
        # Where the polynomial no longer grows, OpenCV and COLMAP go on.
        seen = np.isfinite(fisheye)
        assert seen.mean() > 0.9
        np.testing.assert_allclose(fisheye[seen], expected[seen], rtol=1e-10, atol=1e-14)
        for observed, model, parameters in ((fisheye, "OPENCV_FISHEYE", k), (eucm, "EUCM", (alpha, beta))):
            camera = pycolmap.Camera(model=model, width=100, height=100, params=[1, 1, 0, 0, *parameters])
            seen = np.isfinite(observed)
            np.testing.assert_allclose(observed[seen], camera.img_from_cam(rays)[seen], rtol=1e-10, atol=1e-14)


@pytest.mark.usefixtures("x64")
def test_a_camera_whose_corners_nobody_sees():
    """A lens of 3840 × 2160 pixels that folds inside its picture: OpenCV invents its corners."""
    lens = jl.BrownConrady([-0.2535, 0.0924, -0.0006, 0.0007, -0.0191])
    frame = jl.Frame([1920.0, 1080.0], 1917.36)
    pixels = np.array([[0.0, 1080.0], [0.0, 0.0], [3839.0, 0.0], [0.0, 2159.0], [3839.0, 2159.0]])
    middle, *corners = frame.denormalize(lens.undistort(frame.normalize(pixels)))
    assert np.isnan(corners).all()
    np.testing.assert_allclose(middle, [-805.357, 1083.295], rtol=0, atol=1e-3)
