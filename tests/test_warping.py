from functools import partial

import cv2
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy import ndimage, optimize

import jaxlens as jl

WARPS = {"distort": jl.distort_image, "undistort": jl.undistort_image}
MAPS = {"distort": jl.distortion_map, "undistort": jl.undistortion_map}

# Folding inside the picture, folding beyond it, and not at all; barrel and pincushion. In groups of one compilation.
LENSES = {
    "first order": [partial(jl.RadialPolynomial, [k]) for k in (0.4, -0.2, -0.3, -3.0)],
    "second order": [
        partial(jl.RadialPolynomial, kappas) for kappas in ([0.0, 1.0], [1.0, 3.0], [-2.0, 0.5], [-0.45, 0.6])
    ],
    "fourth order": [partial(jl.RadialPolynomial, [0.3, -0.8, 0.5, -0.1])],
    "division": [partial(jl.Division, k) for k in (0.4, -0.3)],
    "off centre": [partial(jl.RadialPolynomial, [-0.3], center=[0.1, -0.2])],
}


@pytest.fixture
def _untyped():
    """Leave misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def noise(shape, dtype="float32", seed=0):
    return np.random.default_rng(seed).uniform(0, 1, shape).astype(dtype)


def scene(height, width, dtype="float64"):
    """Waves about 40 pixels long."""
    y, x = np.mgrid[:height, :width]
    return (0.5 + 0.2 * np.sin(0.15 * x + 0.05 * y) + 0.25 * np.cos(0.14 * y - 0.07 * x)).astype(dtype)


def pixel_centers(height, width, dtype="float64"):
    y, x = np.mgrid[:height, :width].astype(dtype)
    return np.stack([x, y], axis=-1)


# A lens, once more: scalar functions in double precision, with nothing of the library in them.


def reference_radius(lens):
    """The observed radius as a function of the ideal one, and the radius at which it stops rising."""
    if isinstance(lens, jl.Division):
        k = float(lens.k)
        fold = np.inf if k >= 0 else np.sqrt(-1 / (4 * k))
        return lambda r: r if k == 0 or r == 0 else (np.sqrt(max(1 + 4 * k * r * r, 0)) - 1) / (2 * k * r), fold
    coefficients = np.asarray(lens.coefficients, np.float64)
    powers = np.arange(1, len(coefficients) + 1)
    slopes = np.polynomial.Polynomial([1.0, *((2 * powers + 1) * coefficients)])
    roots = slopes.roots()
    roots = np.sort(roots[(abs(roots.imag) < 1e-9) & (roots.real > 0)].real)
    fold = np.sqrt(roots[0]) if len(roots) else np.inf
    return lambda r: r * (1 + np.sum(coefficients * r ** (2 * powers))), fold


def reference_frame(height, width):
    return np.array([width, height]) / 2, np.hypot(width, height) / 2


def reference_sources(lens, height, width, direction):
    """Where each output pixel comes from, one after another by bisection; NaN where from nowhere."""
    radius_of, fold = reference_radius(lens)
    middle, scale = reference_frame(height, width)
    center = np.asarray(lens.center, np.float64)
    sources = np.full((height, width, 2), np.nan)
    for row, column in np.ndindex(height, width):
        offset = (np.array([column, row]) - middle) / scale - center
        radius = np.hypot(*offset)
        if direction == "undistort":
            factor = radius_of(radius) / radius if radius <= fold and radius > 0 else (1.0 if radius == 0 else np.nan)
        elif radius == 0:
            factor = 1.0
        else:
            upper = fold
            if not np.isfinite(fold):
                upper = 1.0
                while radius_of(upper) < radius and upper < 1e6:
                    upper *= 2
            if radius_of(upper) < radius:
                continue
            factor = optimize.brentq(lambda r, goal=radius: radius_of(r) - goal, 0, upper, xtol=1e-15) / radius
        sources[row, column] = (center + offset * factor) * scale + middle
    return sources


def reference_samples(image, sources, fill):
    missing = np.isnan(sources).any(axis=-1)
    places = np.where(missing[..., None], -99, sources)
    samples = ndimage.map_coordinates(
        image.astype(np.float64), places[..., ::-1].transpose(2, 0, 1), order=1, mode="grid-constant", cval=fill
    )
    return np.where(missing, fill, samples)


# Against brute force.


@pytest.mark.parametrize("group", LENSES)
@pytest.mark.parametrize("direction", WARPS)
@pytest.mark.usefixtures("x64")
def test_warping_agrees_with_brute_force(group, direction):
    image = noise((14, 17), "float64")
    for make in LENSES[group]:
        lens = make()
        sources = reference_sources(lens, 14, 17, direction)
        coordinates = MAPS[direction](lens, 14, 17)
        np.testing.assert_array_equal(np.isnan(coordinates), np.isnan(sources), err_msg=str(make))
        # Beside a fold the inverse is a square root, and magnifies rounding.
        np.testing.assert_allclose(coordinates, sources, rtol=0, atol=1e-10, err_msg=str(make))
        warped = WARPS[direction](image, lens, fill=-0.3)
        expected = reference_samples(image, sources, -0.3)
        np.testing.assert_allclose(warped, expected, rtol=0, atol=1e-10, err_msg=str(make))


@pytest.mark.parametrize(
    ("direction", "shape"),
    [("distort", (1, 1)), ("distort", (1, 8)), ("distort", (9, 6)), ("undistort", (1, 1)), ("undistort", (10, 7))],
)
def test_sizes(direction, shape):
    lens, image = jl.RadialPolynomial([-0.4, 0.1]), noise(shape)
    expected = reference_samples(image, reference_sources(lens, *shape, direction), 0.25)
    warped = WARPS[direction](image, lens, fill=0.25)
    assert warped.shape == shape
    np.testing.assert_allclose(warped, expected, rtol=0, atol=1e-5)


@pytest.mark.usefixtures("x64")
def test_the_unseen_takes_the_fill_value():
    # 1 − 0.3 r² turns back at r = 1.054, seen at 0.703; the corners of Eq. 10's frame lie at one.
    lens, image = jl.RadialPolynomial([-0.3]), np.full((30, 40, 3), 100, np.uint8)
    fill = np.array([1, 2, 3])
    picture = np.asarray(jl.distort_image(image, lens, border="edge", fill=fill))
    radius = np.hypot(*(pixel_centers(30, 40) - [20, 15]).transpose(2, 0, 1)) / 25
    seen = radius < np.sqrt(1 / 0.9) * 2 / 3
    assert 0 < seen.sum() < 1200
    np.testing.assert_array_equal(picture[seen], 100)
    np.testing.assert_array_equal(picture[~seen], np.broadcast_to(fill, (np.sum(~seen), 3)))

    # 1 − 2 r² turns back at r = 0.408: further ideal points would be seen twice.
    back = np.asarray(jl.undistort_image(image, jl.RadialPolynomial([-2.0]), fill=fill))
    within = radius <= np.sqrt(1 / 6)
    np.testing.assert_array_equal(back[within], 100)
    np.testing.assert_array_equal(back[~within], np.broadcast_to(fill, (np.sum(~within), 3)))


# Against OpenCV.


@pytest.mark.parametrize("coefficients", [[0.2, 0.1], [-0.25, 0.05]])
@pytest.mark.usefixtures("x64")
def test_undistort_agrees_with_opencv(coefficients):
    height, width = 48, 64
    matrix = np.array([[70.0, 0, 30.5], [0, 74.0, 25.0], [0, 0, 1]])
    x, y = cv2.initUndistortRectifyMap(
        matrix, np.array([*coefficients, 0, 0]), None, matrix, (width, height), cv2.CV_32FC1
    )
    lens, frame = jl.RadialPolynomial(coefficients), jl.Frame.from_camera_matrix(matrix)
    coordinates = jl.undistortion_map(lens, height, width, frame=frame)
    # OpenCV's map is in single precision.
    np.testing.assert_allclose(coordinates, np.stack([x, y], axis=-1), rtol=0, atol=8e-6)

    image = noise((height, width, 3))
    theirs = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderValue=(0.5, 0.5, 0.5))
    ours = jl.undistort_image(image, lens, frame=frame, fill=0.5)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)
    theirs = cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    ours = jl.undistort_image(image, lens, frame=frame, method="bicubic_opencv", border="reflect")
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=2e-5)


@pytest.mark.usefixtures("x64")
def test_undistort_to_another_camera_agrees_with_opencv():
    matrix = np.array([[70.0, 0, 30.5], [0, 74.0, 25.0], [0, 0, 1]])
    target = np.array([[50.0, 0, 20.0], [0, 55.0, 15.0], [0, 0, 1]])
    x, y = cv2.initUndistortRectifyMap(matrix, np.array([-0.2, 0.05, 0, 0]), None, target, (40, 30), cv2.CV_32FC1)
    frame, output_frame = (jl.Frame.from_camera_matrix(camera) for camera in (matrix, target))
    coordinates = jl.undistortion_map(
        jl.RadialPolynomial([-0.2, 0.05]), 48, 64, frame=frame, output_frame=output_frame, shape=(30, 40)
    )
    np.testing.assert_allclose(coordinates, np.stack([x, y], axis=-1), rtol=0, atol=8e-6)


# Directions, frames and identities.


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kappas", [[0.0, 1.0], [-0.2, 0.0]])
def test_undistort_takes_back_distort(kappas):
    lens, image = jl.RadialPolynomial(kappas), scene(96, 128)
    distorted = jl.distort_image(image, lens, method="bicubic", border="edge", fill=0.5)
    restored = jl.undistort_image(distorted, lens, method="bicubic", fill=0.5)
    # Four pixels inside the picture no kernel meets a border.
    places, sources = pixel_centers(96, 128), np.asarray(jl.undistortion_map(lens, 96, 128))
    inside = np.all((np.minimum(places, sources) > 4) & (np.maximum(places, sources) < [123, 91]), axis=-1)
    assert inside.mean() > 0.4
    np.testing.assert_allclose(np.asarray(restored)[inside], image[inside], rtol=0, atol=1e-3)


@pytest.mark.usefixtures("x64")
def test_the_maps_take_each_other_back():
    lens = jl.RadialPolynomial([0.4, -0.05])
    frame = jl.Frame.half_diagonal(40, 50)
    there = frame.denormalize(lens.undistort(frame.normalize(jl.undistortion_map(lens, 40, 50))))
    np.testing.assert_allclose(there, pixel_centers(40, 50), rtol=0, atol=1e-11)


def test_pincushion_and_barrel_have_opencvs_sign():
    # κ > 0 moves observed points outward: the picture is magnified towards its corners.
    frame = jl.Frame.half_diagonal(101, 101)
    corner = np.array([5.0, 5.0])
    outward = jl.distortion_map(jl.RadialPolynomial([0.5]), 101, 101)[5, 5] - corner
    inward = jl.distortion_map(jl.RadialPolynomial([-0.1]), 101, 101)[5, 5] - corner
    assert np.all(outward > 1)  # its source lies nearer to the centre
    assert np.all(inward < -1)
    np.testing.assert_allclose(frame.center, [50.5, 50.5])


@pytest.mark.parametrize("direction", WARPS)
def test_the_default_frame_is_that_of_equation_10(direction):
    lens, image = jl.RadialPolynomial([0.3]), noise((9, 14))
    frame = jl.Frame([7, 4.5], np.hypot(9, 14) / 2)
    warp = WARPS[direction]
    np.testing.assert_allclose(warp(image, lens), warp(image, lens, frame=frame), rtol=0, atol=2e-6)
    moved = warp(image, lens, frame=jl.Frame([6.5, 4], np.hypot(9, 14) / 2))
    assert np.abs(moved - warp(image, lens)).max() > 1e-2


@pytest.mark.parametrize("coefficients", [[], [0.0, 0.0]])
@pytest.mark.parametrize("direction", WARPS)
def test_the_identity_keeps_the_image(coefficients, direction, dtype):
    lens, warp = jl.RadialPolynomial(np.array(coefficients, dtype)), WARPS[direction]
    height, width = 60, 91
    bytes_ = np.random.default_rng(1).integers(0, 255, (height, width), np.uint8)
    np.testing.assert_array_equal(warp(bytes_, lens, fill=255), bytes_)
    # A frame's arithmetic rounds, so that floats come back but for the last digits of a coordinate.
    floats = noise((height, width), dtype)
    np.testing.assert_allclose(warp(floats, lens, fill=0.5), floats, rtol=0, atol=2 * width * np.finfo(dtype).eps)


@pytest.mark.parametrize(
    ("direction", "options"),
    [
        ("distort", {}),
        ("undistort", {}),
        ("undistort", {"method": "bicubic", "border": "wrap"}),
        ("undistort", {"antialias": True}),
    ],
)
def test_a_map_made_before_gives_the_same(direction, options):
    lens, image = jl.RadialPolynomial([-0.3, 0.2]), noise((20, 31, 3))
    shape, frame = (17, 25), jl.Frame([15, 11], 20)
    zoomed = frame.zoomed(1.5)
    coordinates = MAPS[direction](lens, 20, 31, frame=frame, output_frame=zoomed, shape=shape)
    assert coordinates.shape == (17, 25, 2)
    expected = jl.remap(image, coordinates, fill=0.5, **options)
    warped = WARPS[direction](image, lens, frame=frame, output_frame=zoomed, shape=shape, fill=0.5, **options)
    np.testing.assert_allclose(warped, expected, rtol=0, atol=2e-5)


# Any map, any view.


@pytest.mark.usefixtures("x64")
def test_warp_with_a_chain():
    first, second, image = jl.RadialPolynomial([0.2]), jl.Division(0.1), noise((15, 18), "float64")
    chain = first.then(second)
    middle, scale = reference_frame(15, 18)
    points = second(first((pixel_centers(15, 18) - middle) / scale))
    expected = reference_samples(image, np.asarray(points) * scale + middle, 0.0)
    np.testing.assert_allclose(jl.warp(image, chain), expected, rtol=0, atol=1e-12)
    inverse = jl.warp(image, chain.inverse())
    points = first.undistort(second.undistort((pixel_centers(15, 18) - middle) / scale))
    np.testing.assert_allclose(
        inverse, reference_samples(image, np.asarray(points) * scale + middle, 0), rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(jl.warp(image, jl.Chain(())), image, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_an_output_frame_zooms_and_a_shape_crops():
    lens, image = jl.RadialPolynomial([0.3]), noise((20, 24), "float64")
    frame = jl.Frame.half_diagonal(20, 24)
    coordinates = jl.distortion_map(lens, 20, 24, output_frame=frame.zoomed(2.0), shape=(13, 11))
    assert coordinates.shape == (13, 11, 2)
    # Twice the pixels a unit: pixel p of the output is what stood at centre + (p − centre) / 2.
    points = (pixel_centers(13, 11) - [12, 10]) / 2 / np.asarray(frame.scale)
    expected = np.asarray(lens.undistort(points)) * np.asarray(frame.scale) + [12, 10]
    np.testing.assert_allclose(coordinates, expected, rtol=0, atol=1e-11)
    picture = jl.distort_image(image, lens, output_frame=frame.zoomed(2.0), shape=(13, 11))
    np.testing.assert_allclose(picture, reference_samples(image, expected, 0.0), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("direction", "image_dtype", "channels"),
    [
        ("distort", "uint8", (3,)),
        ("undistort", "uint8", ()),
        ("undistort", "uint16", (1,)),
        ("undistort", "int16", (4,)),
        ("undistort", "float16", (3,)),
        ("undistort", "float32", ()),
    ],
)
def test_dtype_and_channels_are_kept(direction, image_dtype, channels):
    image, lens = (noise((8, 9, *channels)) * 250).astype(image_dtype), jl.RadialPolynomial([0.2])
    picture = WARPS[direction](image, lens)
    assert picture.shape == image.shape
    assert picture.dtype == image_dtype
    exact = reference_samples(image.reshape(8, 9, -1)[..., -1], reference_sources(lens, 8, 9, direction), 0)
    last = np.asarray(picture).reshape(8, 9, -1)[..., -1].astype(float)
    tolerance = {"float16": 0.13, "float32": 1e-3}.get(image_dtype, 0.5 + 1e-3)
    np.testing.assert_allclose(last, exact, rtol=0, atol=tolerance)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_coordinates_have_the_precision_of_the_lens():
    single = jl.RadialPolynomial(np.array([0.1], np.float32))
    assert jl.distortion_map(single, 5, 6).dtype == np.float32
    assert jl.distortion_map(jl.RadialPolynomial(np.array([0.1])), 5, 6).dtype == np.float64
    assert jl.distort_image(noise((5, 6), "float64"), single).dtype == np.float64
    assert jl.distort_image(noise((5, 6), "float32"), jl.RadialPolynomial([0.1])).dtype == np.float32


# Transformations.


VMAPS = {"both": (0, 0), "images": (0, None), "lenses": (None, 0)}


@pytest.mark.parametrize(
    ("direction", "over"), [("distort", "both"), ("distort", "lenses"), *(("undistort", over) for over in VMAPS)]
)
def test_vmap_equals_a_loop(direction, over):
    warp = partial(WARPS[direction], fill=0.5)
    images, coefficients = noise((3, 12, 15)), np.array([[0.3, 0.1], [-0.3, 0.0], [-1.5, 0.2]], np.float32)
    lenses = jax.vmap(jl.RadialPolynomial)(coefficients)
    pick_image, pick_lens = (axis is not None for axis in VMAPS[over])
    batch = jax.vmap(warp, VMAPS[over])(
        images if pick_image else images[0], lenses if pick_lens else jl.RadialPolynomial(coefficients[0])
    )
    singles = [warp(images[i * pick_image], jl.RadialPolynomial(coefficients[i * pick_lens])) for i in range(3)]
    np.testing.assert_allclose(batch, np.stack(singles), rtol=0, atol=5e-5)


def test_vmap_of_vmap():
    images, coefficients = noise((2, 6, 7)), np.array([[0.3], [-0.3], [0.1]], np.float32)
    lenses = jax.vmap(jl.RadialPolynomial)(coefficients)
    across = jax.vmap(lambda image: jax.vmap(jl.undistort_image, (None, 0))(image, lenses))(images)
    for i, j in np.ndindex(2, 3):
        single = jl.undistort_image(images[i], jl.RadialPolynomial(coefficients[j]))
        np.testing.assert_allclose(across[i, j], single, rtol=0, atol=2e-5)


@pytest.mark.parametrize("direction", WARPS)
def test_jit_changes_nothing(direction):
    lens, image = jl.RadialPolynomial([-0.3, 0.1]), noise((12, 15))
    warp = partial(WARPS[direction], fill=0.5)
    np.testing.assert_allclose(jax.jit(warp)(image, lens), warp(image, lens), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("direction", "kappas"),
    [("distort", ([0.3, -0.05], [-0.9, 0.1], [0.0, 0.0])), ("undistort", ([-0.2, 0.1], [0.3, 0.4]))],
)
@pytest.mark.usefixtures("x64")
def test_the_gradient_of_an_image_loss(direction, kappas):
    source, target = scene(24, 28), noise((24, 28), "float64", seed=3)
    warp = partial(WARPS[direction], method="bicubic", fill=0.4)

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
    def loss_and_slopes(coefficients, center, image):
        def loss(coefficients, center, image):
            return jnp.mean((warp(image, jl.RadialPolynomial(coefficients, center=center)) - target) ** 2)

        return jax.value_and_grad(loss, argnums=(0, 1, 2))(coefficients, center, image)

    random = np.random.default_rng(5)
    for coefficients in kappas:
        arguments = [np.array(coefficients), np.array([0.02, -0.01]), source]
        _, slopes = loss_and_slopes(*arguments)
        for index, slope in enumerate(slopes):
            assert np.all(np.isfinite(slope))
            step = random.normal(size=slope.shape) * 1e-6
            ahead, behind = (
                loss_and_slopes(*(a + sign * step if k == index else a for k, a in enumerate(arguments)))[0]
                for sign in (1, -1)
            )
            np.testing.assert_allclose(np.sum(slope * step), (ahead - behind) / 2, rtol=1e-5, atol=1e-13)


@pytest.mark.usefixtures("x64")
def test_gradients_from_the_identity_lens():
    # All sources are pixel centres, where bilinear interpolation has a corner: the slopes are one-sided, and right. In
    # this frame, of whole numbers and a power of two, nothing is rounded, or it would fall to one side by chance.
    image, frame = noise((20, 22), "float64"), jl.Frame([11.0, 10.0], 16.0)

    @jax.jit
    def slope(coefficients):
        def loss(coefficients):
            picture = jl.undistort_image(image, jl.RadialPolynomial(coefficients), frame=frame, border="edge")
            return jnp.sum((picture - 0.3) ** 2)

        return jax.grad(loss)(coefficients)

    offset = (pixel_centers(20, 22) - np.array([11.0, 10.0])) / 16
    squared = np.sum(offset**2, axis=-1)
    along_x = np.diff(np.pad(image, ((0, 0), (0, 1)), mode="edge"), axis=1)
    along_y = np.diff(np.pad(image, ((0, 1), (0, 0)), mode="edge"), axis=0)
    outward = 2 * (image - 0.3) * 16 * (along_x * offset[..., 0] + along_y * offset[..., 1])
    expected = [np.sum(outward * squared), np.sum(outward * squared**2)]
    np.testing.assert_allclose(slope(jnp.zeros(2)), expected, rtol=1e-11)


# Misuse.


@pytest.mark.usefixtures("_untyped")
@pytest.mark.parametrize("warp", [jl.distort_image, jl.undistort_image, jl.warp])
@pytest.mark.parametrize(
    ("image", "options", "message"),
    [
        (np.zeros(5), {}, r"\(H, W\) or \(H, W, C\).*got \(5,\)"),
        (np.zeros((0, 5)), {}, "at least one pixel"),
        (np.zeros((2, 3, 4, 5)), {}, r"got \(2, 3, 4, 5\)"),
        (np.zeros((4, 5)), {"method": "cubic"}, "method must be one of nearest.*got 'cubic'"),
        (np.zeros((4, 5)), {"border": "black"}, "border must be one of constant.*got 'black'"),
        (np.zeros((4, 5, 3)), {"fill": np.zeros(4)}, r"3 channels, got shape \(4,\)"),
    ],
)
def test_misuse_is_a_value_error(warp, image, options, message):
    with pytest.raises(ValueError, match=message):
        warp(image, jl.RadialPolynomial([0.1]), **options)


def test_options_are_keyword_only():
    with pytest.raises(TypeError):
        jl.distort_image(np.zeros((3, 4)), jl.RadialPolynomial([0.1]), jl.Frame.half_diagonal(3, 4))
    with pytest.raises(TypeError):
        jl.distortion_map(jl.RadialPolynomial([0.1]), 3, 4, jl.Frame.half_diagonal(3, 4))
