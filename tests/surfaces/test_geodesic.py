"""Geodesic distances: planes and spheres in closed form, exact polyhedral geodesics, masks, derivatives, failures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens.surfaces import DepthMap, geodesic_distance

HEIGHT, WIDTH = 24, 31
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(float)


def _plane(p, q, spacing):
    dx, dy = spacing
    return DepthMap(3 + p * dx * COLUMNS + q * dy * ROWS, spacing=spacing)


def _straight(depth_map, source, p, q):
    """The distance on a plane."""
    dx, dy = np.asarray(depth_map.spacing)
    x, y = (COLUMNS - source[0]) * dx, (ROWS - source[1]) * dy
    return np.sqrt(x * x + y * y + (p * x + q * y) ** 2)


def _cap(size, source, reach=0.9):
    """A cap of a sphere that fills the picture, and the great circles' lengths; `source` from the middle, in radii."""
    middle = (size - 1) / 2
    radius = middle / reach
    y, x = np.mgrid[:size, :size] - middle
    mask = x * x + y * y <= middle**2
    z = np.sqrt(np.where(mask, radius**2 - x * x - y * y, 0))
    s = middle * np.array([*source, np.sqrt(reach**-2 - np.sum(np.square(source)))])
    points = np.stack([x, y, z], -1)
    angle = np.arctan2(np.linalg.norm(np.cross(points, s), axis=-1), points @ s)
    return DepthMap(z, mask=mask), (s[0] + middle, s[1] + middle), radius * angle


def _bumps(rows, columns):
    return 3 * np.sin(0.31 * columns + 0.2) * np.cos(0.23 * rows) + 0.2 * columns


@pytest.mark.parametrize(
    ("p", "q", "spacing", "source"),
    [
        (0.0, 0.0, (1.0, 1.0), (0.0, 0.0)),
        (0.7, -1.9, (1.3, 0.4), (17.3, 11.8)),
        (-6.0, 5.0, (0.02, 0.03), (28.6, 22.3)),
    ],
)
def test_planes_are_exact(x64, p, q, spacing, source):
    depth_map = _plane(p, q, spacing)
    expected = _straight(depth_map, source, p, q)
    np.testing.assert_allclose(
        geodesic_distance(depth_map, source=source), expected, rtol=1e-10, atol=1e-10 * max(spacing)
    )


def test_planes_in_single_precision():
    depth_map = _plane(np.float32(0.7), np.float32(-0.9), (1.3, 0.8))
    depth_map = DepthMap(np.asarray(depth_map.depth, np.float32), spacing=(1.3, 0.8))
    found = geodesic_distance(depth_map, source=(17.3, 11.8))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, _straight(depth_map, (17.3, 11.8), 0.7, -0.9), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("source", [(0.0, 0.0), (0.3, 0.17), (0.5, -0.4)])
def test_a_sphere_and_the_order(x64, source):
    """Slopes up to 2; halving the spacing halves the error."""
    errors = []
    for size in (32, 64):
        depth_map, pixel, expected = _cap(size, source)
        found = np.asarray(geodesic_distance(depth_map, source=pixel))
        mask = np.asarray(depth_map.mask)
        assert np.array_equal(np.isnan(found), ~mask)
        far = mask & (expected > 2)
        errors.append(np.max(np.abs(found - expected)[far] / expected[far]))
    assert errors[0] < 2.5e-3
    assert errors[1] < 0.6 * errors[0]


def test_several_sources(x64):
    depth_map, pixel, _ = _cap(32, (0.3, 0.17))
    sources = np.array([pixel, (9.0, 20.5), (16.0, 3.0)])
    nearest = np.min([geodesic_distance(depth_map, source=source) for source in sources], axis=0)
    np.testing.assert_allclose(geodesic_distance(depth_map, source=sources), nearest, rtol=1e-12)


def test_exact_geodesics_of_the_polyhedron(x64):
    """Against the exact algorithm (Mitchell, Mount and Papadimitriou) on a triangulation of the same pixels."""
    geodesic = pytest.importorskip("pygeodesic.geodesic")
    depth = _bumps(ROWS, COLUMNS)
    index = np.arange(depth.size).reshape(depth.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    falling = (ROWS + COLUMNS)[:-1, :-1] % 2 == 0
    faces = np.concatenate(
        [
            np.stack(corners, -1)[where]
            for corners, where in (
                ((a, b, d), falling),
                ((a, d, c), falling),
                ((a, b, c), ~falling),
                ((b, d, c), ~falling),
            )
        ]
    )
    points = np.stack([COLUMNS, ROWS, depth], -1).reshape(-1, 3)
    exact = geodesic.PyGeodesicAlgorithmExact(points, faces.astype(np.int32))
    source = (8, 15)
    expected = exact.geodesicDistances(np.array([index[source[1], source[0]]]), None)[0].reshape(depth.shape)
    found = np.asarray(geodesic_distance(DepthMap(depth), source=source))
    far = expected > 0
    relative = np.abs(found - expected)[far] / expected[far]
    assert np.mean(relative) < 3e-3
    assert np.max(relative) < 2e-2


def test_around_a_wall(x64):
    """A wall with an end: behind it the shortest way is broken at the wall's corner."""
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[8:, 15] = False
    depth_map = DepthMap(0.5 * COLUMNS, mask=mask)
    found = np.asarray(geodesic_distance(depth_map, source=(5.0, 20.0)))
    length = lambda x, y: np.hypot(np.hypot(x, y), 0.5 * x)  # noqa: E731
    # Round the pixel (15, 7), the last that may be stepped on; ways along the wall go by whole pixels.
    expected = length(10, 13) + length(COLUMNS - 15, ROWS - 7)
    behind = (COLUMNS > 15) & (ROWS > 12)
    np.testing.assert_allclose(found[behind], expected[behind], rtol=2e-2)
    assert np.all(found[behind] > 0.999 * expected[behind])
    np.testing.assert_allclose(found[:, :15], length(COLUMNS - 5, ROWS - 20)[:, :15], rtol=1e-10)


def test_outside_and_out_of_reach(x64):
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:, 15] = False
    depth = np.where(mask, 0.0, np.nan)
    found = np.asarray(geodesic_distance(DepthMap(depth), source=(3.0, 4.0)))
    assert np.all(np.isfinite(found[:, :15]))
    assert np.all(np.isnan(found[:, 15]))
    assert np.all(np.isposinf(found[:, 16:]))


@pytest.mark.slow
def test_derivatives(x64):
    """Forward, reverse and central differences, by the depth, the spacing and the source."""
    random = np.random.default_rng(0)
    mask = jnp.asarray(np.hypot(ROWS - 12, COLUMNS - 15) < 11.3)
    arguments = jnp.asarray(0.5 * _bumps(ROWS, COLUMNS)), jnp.array([1.1, 0.9]), jnp.array([12.3, 10.2])
    weights, *direction = (jnp.asarray(random.normal(size=size)) for size in (mask.shape, mask.shape, 2, 2))

    def distance(depth, spacing, source):
        return jnp.where(mask, geodesic_distance(DepthMap(depth, mask=mask, spacing=spacing), source=source), 0)

    forward = jax.jit(lambda *dots: jax.jvp(distance, arguments, dots)[1])
    gradients = jax.jit(jax.grad(lambda *args: jnp.sum(weights * distance(*args)), argnums=(0, 1, 2)))(*arguments)
    assert all(bool(jnp.all(jnp.isfinite(gradient))) for gradient in gradients)
    assert bool(jnp.all(jnp.where(mask, 0, gradients[0]) == 0))
    for k in range(3):
        dots = [dot if i == k else jnp.zeros_like(dot) for i, dot in enumerate(direction)]
        derivative = forward(*dots)
        np.testing.assert_allclose(jnp.sum(gradients[k] * direction[k]), jnp.sum(weights * derivative), rtol=1e-9)
        step = 1e-6
        ahead, behind = (
            distance(*(argument + sign * step * dot for argument, dot in zip(arguments, dots, strict=True)))
            for sign in (1, -1)
        )
        error = (ahead - behind) / (2 * step) - derivative
        # The sweeps find the best place between two neighbours to O(h²) only.
        assert float(jnp.median(jnp.abs(error)[mask])) < 2e-4 * float(jnp.max(jnp.abs(derivative)))
        assert float(jnp.linalg.norm(error)) < 5e-3 * float(jnp.linalg.norm(derivative))


def test_jit_and_vmap(x64):
    depths = jnp.stack([jnp.asarray(_bumps(ROWS, COLUMNS)), jnp.asarray(0.3 * COLUMNS)])
    sources = jnp.array([[3.0, 4.0], [20.0, 11.5]])
    together = jax.jit(jax.vmap(lambda depth, source: geodesic_distance(DepthMap(depth), source=source)))(
        depths, sources
    )
    for depth, source, found in zip(depths, sources, together, strict=True):
        np.testing.assert_allclose(found, geodesic_distance(DepthMap(depth), source=source), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ((np.nan, 2.0), "must be finite"),
        ((-0.6, 2.0), r"source \(-0.6, 2\) lies outside the picture of 31×24 pixels"),
        ((10.0, 10.0), r"outside the mask: there is no surface at pixel \(10, 10\)"),
        ((1.0, 2.0, 3.0), "last axis"),
        ((1.0,), r"\(x, y\)"),
        (np.zeros((2, 2, 2)), r"\(K, 2\)"),
    ],
)
def test_sources_that_do_not_fit(x64, source, message):
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[10, 10] = False
    with pytest.raises(ValueError, match=message.replace("last axis", "shape")):
        geodesic_distance(DepthMap(np.zeros((HEIGHT, WIDTH)), mask=mask), source=source)


@pytest.mark.parametrize(
    ("depth", "options", "message"),
    [
        (np.zeros(3), {}, r"shape \(H, W\)"),
        (np.zeros((2, 3)), {"mask": np.ones((3, 2), bool)}, "booleans of the depth's shape"),
        (
            np.array([[0.0, np.nan]]),
            {"mask": np.ones((1, 2), bool)},
            "finite inside the mask, got nan at row 0, column 1",
        ),
        (np.zeros((2, 3)), {"spacing": -1.0}, "spacing must be positive"),
        (np.zeros((2, 3)), {"spacing": np.ones(3)}, r"\(dx, dy\)"),
    ],
)
def test_depth_maps_that_do_not_fit(x64, depth, options, message):
    with pytest.raises(ValueError, match=message):
        DepthMap(depth, **options)


def test_a_depth_map_is_finite_and_knows_its_points(x64):
    depth_map = DepthMap(np.array([[1.0, np.nan], [2.0, 3.0]]), spacing=(0.5, 2.0))
    assert depth_map.mask.tolist() == [[True, False], [True, True]]
    assert depth_map.points().tolist() == [[[0, 0, 1], [0.5, 0, 0]], [[0, 2, 2], [0.5, 2, 3]]]


def test_an_edge_of_sources(dtype):
    """From all of a plane's first row the distance is the row's number."""
    sources = np.stack([np.arange(64), np.zeros(64)], axis=-1).astype(dtype)
    distance = geodesic_distance(DepthMap(jnp.zeros((48, 64), dtype)), source=sources)
    rows = np.broadcast_to(np.arange(48)[:, None], (48, 64))
    np.testing.assert_allclose(distance, rows, rtol=0, atol=64 * np.finfo(dtype).eps)


@pytest.mark.slow
def test_many_sources_are_as_one_by_one(x64):
    """On a curved surface with a hole, sources between pixels: against the least of separate solutions."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[:40, :50] / 10
    depth = np.sin(x) * np.cos(y)
    mask = (x - 2.5) ** 2 + (y - 2) ** 2 > 0.3
    surface = DepthMap(jnp.asarray(depth), mask=jnp.asarray(mask), spacing=jnp.asarray([0.1, 0.1]))
    sources = random.uniform(0, [49, 39], (40, 2))
    sources = sources[np.hypot(sources[:, 0] / 10 - 2.5, sources[:, 1] / 10 - 2) > 0.8][:12]
    found = np.asarray(geodesic_distance(surface, source=sources))
    alone = jax.jit(lambda source: geodesic_distance(surface, source=source))
    expected = np.min([np.asarray(alone(jnp.asarray(source))) for source in sources], axis=0)
    error = np.abs(found - expected)[mask]
    assert error.max() < 0.005  # a twentieth of a pixel
    assert np.mean(error > 1e-9) < 0.05
    assert np.isnan(found[~mask]).all()


@pytest.mark.parametrize("count", [1, 2, 9])
def test_progress_is_told_round_by_round(count):
    sources = np.stack([np.linspace(2, 30, count), np.linspace(3, 20, count)], axis=-1)
    surface = DepthMap(0.1 * jnp.asarray(np.random.default_rng(5).random((HEIGHT, WIDTH))))
    told = []
    found = geodesic_distance(surface, source=sources, progress=lambda done, total: told.append((done, total)))
    jax.effects_barrier()
    np.testing.assert_allclose(found, geodesic_distance(surface, source=sources), rtol=1e-6)
    assert {total for _, total in told} == {HEIGHT * WIDTH}
    assert told[0][0] < HEIGHT * WIDTH
    assert told[-1][0] == HEIGHT * WIDTH
    assert [done for done, _ in told].count(HEIGHT * WIDTH) == (count if count <= 8 else 1)
