from functools import partial
from itertools import product

import cv2
import jax
import jax.numpy as jnp
import jaxtyping
import ml_dtypes
import numpy as np
import pytest
from scipy import ndimage

from jaxlens import remap

METHODS = ("nearest", "bilinear", "bicubic", "bicubic_opencv")
SIZE = (12, 13)
BORDERS = ("constant", "edge", "reflect", "wrap")
# The names that NumPy, scipy and OpenCV have for our borders.
PAD_MODES = dict(zip(BORDERS, ("constant", "edge", "symmetric", "wrap"), strict=True))
SCIPY_MODES = dict(zip(BORDERS, ("grid-constant", "nearest", "reflect", "grid-wrap"), strict=True))
CV2_BORDERS = dict(
    zip(BORDERS, (cv2.BORDER_CONSTANT, cv2.BORDER_REPLICATE, cv2.BORDER_REFLECT, cv2.BORDER_WRAP), strict=True)
)
CV2_METHODS = {"nearest": cv2.INTER_NEAREST, "bilinear": cv2.INTER_LINEAR, "bicubic_opencv": cv2.INTER_CUBIC}
# Rounding of images with values up to one and coordinates up to a few hundred.
TOLERANCE = {"float32": 2e-6, "float64": 1e-13}

each_method = pytest.mark.parametrize("method", METHODS)
each_border = pytest.mark.parametrize("border", BORDERS)


@pytest.fixture
def _untyped():
    """Leave misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def noise(shape, dtype="float32", seed=0):
    return np.random.default_rng(seed).uniform(0, 1, shape).astype(dtype)


def scattered(count, low, high, dtype="float32", seed=1):
    return np.random.default_rng(seed).uniform(low, high, (count, 2)).astype(dtype)


def pixel_centers(height, width, dtype="float32"):
    y, x = np.mgrid[:height, :width].astype(dtype)
    return np.stack([x, y], axis=-1)


def sample(image, coordinates, method, border, fill=0.0, count=3000):
    """`remap` of as many points as ever, so that it is compiled once a method, border and dtype for many tests."""
    rows = np.arange(count) % len(coordinates)
    samples = remap(image, np.asarray(coordinates, image.dtype)[rows], method=method, border=border, fill=fill)
    return np.asarray(samples)[: len(coordinates)]


def keys_weights(fraction, a):
    """The four weights of Keys's cubic convolution as OpenCV's documentation writes them."""
    t = fraction
    first = ((a * (t + 1) - 5 * a) * (t + 1) + 8 * a) * (t + 1) - 4 * a
    second = ((a + 2) * t - (a + 3)) * t * t + 1
    third = ((a + 2) * (1 - t) - (a + 3)) * (1 - t) ** 2 + 1
    return np.stack([first, second, third, 1 - first - second - third])


def reference_remap(image, coordinates, method, border, fill, margin=64):
    """Interpolation in double precision from an image that `numpy.pad` has extended far enough to need no borders."""
    options = {"constant_values": fill} if border == "constant" else {}
    padded = np.pad(image.astype(np.float64), margin, mode=PAD_MODES[border], **options)
    x, y = coordinates.astype(np.float64).T + margin
    if method == "nearest":
        return padded[np.floor(y + 0.5).astype(int), np.floor(x + 0.5).astype(int)]
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    if method == "bilinear":
        horizontal, vertical, reach = np.stack([1 - x + column, x - column]), np.stack([1 - y + row, y - row]), 0
    else:
        a = -0.5 if method == "bicubic" else -0.75
        horizontal, vertical, reach = keys_weights(x - column, a), keys_weights(y - row, a), 1
    taps = product(range(len(vertical)), range(len(horizontal)))
    return sum(vertical[j] * horizontal[i] * padded[row + j - reach, column + i - reach] for j, i in taps)


# Against others.


@each_border
@pytest.mark.parametrize("method", CV2_METHODS)
def test_remap_agrees_with_opencv(method, border):
    image, coordinates = noise((20, 24, 3)), scattered(3000, -12, 36)
    x, y = (np.ascontiguousarray(plane[None]) for plane in coordinates.T)
    theirs = cv2.remap(image, x, y, CV2_METHODS[method], borderMode=CV2_BORDERS[border], borderValue=(0.3, 0.9, 0.5))
    ours = remap(image, coordinates, method=method, border=border, fill=np.array([0.3, 0.9, 0.5]))
    np.testing.assert_allclose(ours, theirs[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("image_dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("method", CV2_METHODS)
def test_remap_of_integers_agrees_with_opencv(method, image_dtype):
    peak = np.iinfo(image_dtype).max
    image = np.random.default_rng(2).integers(0, peak, (20, 24), image_dtype, endpoint=True)
    # OpenCV may round coordinates of 8-bit images to 1/32 pixel; on that lattice it has nothing to round.
    coordinates = np.round(scattered(2000, 3, 16) * 32) / 32 + np.float32(1 / 64 if method == "nearest" else 0)
    theirs = cv2.remap(image, *(np.ascontiguousarray(plane[None]) for plane in coordinates.T), CV2_METHODS[method])
    ours = np.asarray(remap(image, coordinates, method=method))
    difference = np.abs(ours.astype(int) - theirs[0].astype(int))
    # Its weights are integers of 15 bits, so that a rounding may tip the other way.
    assert difference.max() <= (0 if method == "nearest" else 1)
    assert np.mean(difference > 0) <= 0.02


@each_border
@pytest.mark.parametrize(("method", "order"), [("nearest", 0), ("bilinear", 1)])
def test_remap_agrees_with_scipy(method, order, border, dtype):
    image, coordinates = noise(SIZE, dtype), scattered(3000, -130, 140, dtype)
    theirs = ndimage.map_coordinates(
        image.astype(np.float64),
        coordinates[:, ::-1].T.astype(np.float64),
        order=order,
        mode=SCIPY_MODES[border],
        cval=0.25,
    )
    ours = sample(image, coordinates, method, border, 0.25)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=TOLERANCE[dtype])


@each_border
@each_method
def test_remap_agrees_with_a_padded_reference(method, border, dtype):
    image, coordinates = noise(SIZE, dtype), scattered(3000, -50, 60, dtype)
    expected = reference_remap(image, coordinates, method, border, 0.25)
    ours = sample(image, coordinates, method, border, 0.25)
    assert ours.dtype == dtype
    np.testing.assert_allclose(ours, expected, rtol=0, atol=TOLERANCE[dtype])


@pytest.mark.parametrize(
    ("method", "shape", "border"),
    [
        *product(["bilinear"], [(1, 1)], BORDERS),
        *product(["bicubic"], [(1, 6), (2, 2)], BORDERS),
        *product(["nearest"], [(1, 1), (4, 1)], ["constant", "wrap"]),
        *product(["bicubic_opencv"], [(3, 3), (1, 1)], ["constant", "reflect"]),
    ],
)
def test_images_smaller_than_the_kernel(method, shape, border):
    image, coordinates = noise(shape), scattered(500, -20, 24)
    expected = reference_remap(image, coordinates, method, border, -0.5)
    ours = remap(image, coordinates, method=method, border=border, fill=-0.5)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=3e-6)


# What each kernel reproduces.


@pytest.mark.parametrize(("method", "degree"), [("bilinear", 1), ("bicubic", 2)])
@pytest.mark.usefixtures("x64")
def test_polynomials_are_reproduced(method, degree):
    def surface(x, y):
        return (0.3 + 0.7 * x - 0.2 * x**degree) * (1 - 0.4 * y + 0.1 * y**degree)

    y, x = np.mgrid[:12, :14].astype(float)
    inside = scattered(500, 1, 10, "float64")
    samples = remap(surface(x, y), inside, method=method)
    np.testing.assert_allclose(samples, surface(*inside.T), rtol=0, atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_bicubic_converges_with_the_third_order():
    def error(count, method):
        wave = np.sin(np.linspace(0, 3, count))[None, :]
        x = np.linspace(2.1, count - 3.1, 997)
        samples = remap(wave, np.stack([x, 0 * x], -1), method=method, border="edge")
        return np.abs(samples - np.sin(x * 3 / (count - 1))).max()

    assert error(64, "bicubic") / error(128, "bicubic") == pytest.approx(8, rel=0.1)
    assert error(64, "bilinear") / error(128, "bilinear") == pytest.approx(4, rel=0.1)


@each_border
@each_method
def test_weights_add_up_to_one(method, border, dtype):
    far = np.array([[1e30, 2], [-(2**24) - 2, 1e9], [2**53 + 2, -3e38]], dtype)
    coordinates = np.concatenate([scattered(500, -90, 90, dtype), pixel_centers(5, 5, dtype).reshape(-1, 2), far])
    samples = sample(np.full(SIZE, 0.7, dtype), coordinates, method, border, 0.7)
    # Rounding of the weights, up to sixteen of them, and some negative.
    roundings = 16 if method.startswith("bicubic") else 4
    np.testing.assert_allclose(samples, np.full(528, 0.7, dtype), rtol=0, atol=roundings * np.finfo(dtype).eps)


@each_border
@each_method
def test_pixels_are_reproduced(method, border, dtype):
    image = noise(SIZE, dtype)
    samples = sample(image, pixel_centers(*SIZE, dtype).reshape(-1, 2), method, border, 9.0)
    np.testing.assert_array_equal(samples, image.ravel())


@each_border
def test_nearest_rounds_halves_up(border, dtype):
    below, half = np.nextafter(np.asarray(0.5, dtype), np.asarray(0, dtype)), np.asarray(0.5, dtype)
    x = np.array([-half, -below, 0, below, half, 1.5, 2.5, 2.5 + 1e-6, 3 - half, 3], dtype)
    image = np.array([[10, 20, 30, 40]], dtype)
    samples = remap(image, np.stack([x, 0 * x], -1), method="nearest", border=border)
    np.testing.assert_array_equal(samples, [10, 10, 10, 10, 20, 30, 40, 40, 40, 40])


def test_nearest_ends_half_a_pixel_outside(dtype):
    x = np.array([-0.5, np.nextafter(np.asarray(-0.5, dtype), np.asarray(-1, dtype)), 1.4999, 1.5], dtype)
    samples = remap(np.array([[1, 2]], dtype), np.stack([x, 0 * x], -1), method="nearest", fill=7)
    np.testing.assert_array_equal(samples, [1, 7, 2, 7])


# Dtypes.


@pytest.mark.parametrize(
    "image_dtype",
    ["uint8", "uint16", "uint32", "int8", "int16", "int32", "bool", "float16", "bfloat16", "float32", "float64"],
)
@pytest.mark.usefixtures("x64")
def test_every_dtype_is_kept(image_dtype):
    scale = {"uint16": 60000, "uint32": 4e9, "int16": 30000, "int32": 2e9, "bool": 1}.get(image_dtype, 120)
    kind = ml_dtypes.bfloat16 if image_dtype == "bfloat16" else np.dtype(image_dtype)
    image = (noise((6, 7), "float64") * scale + (0.5 if image_dtype == "bool" else 0)).astype(kind)
    coordinates = np.concatenate([scattered(400, 0, 5, "float64"), pixel_centers(6, 7, "float64").reshape(-1, 2)])
    exact = reference_remap(image, coordinates, "bilinear", "constant", 0)
    samples = remap(image, coordinates)
    assert samples.dtype == image.dtype
    if image_dtype == "float64":
        np.testing.assert_allclose(samples, exact, rtol=1e-13)
    elif image_dtype == "bool":
        np.testing.assert_array_equal(samples, exact >= 0.5)
    else:
        rounded = np.round(exact) if "int" in image_dtype else exact
        np.testing.assert_array_equal(np.asarray(samples), rounded.astype(kind))
    np.testing.assert_array_equal(np.asarray(samples[400:]), image.ravel())


def test_integers_are_rounded_half_to_even():
    image = np.array([[0, 1, 2, 3, 4]], np.uint8)
    x = np.arange(4, dtype=np.float32) + 0.5
    np.testing.assert_array_equal(remap(image, np.stack([x, 0 * x], -1)), [0, 2, 2, 4])
    np.testing.assert_array_equal(remap(-image.astype(np.int8), np.stack([x, 0 * x], -1)), [0, -2, -2, -4])


@pytest.mark.parametrize("image_dtype", ["uint8", "int16", "uint32", "int32"])
def test_overshoot_saturates(image_dtype, dtype):
    limits = np.iinfo(image_dtype)
    step = np.repeat([[limits.min, limits.min, limits.max, limits.max]], 4, axis=0).astype(image_dtype)
    coordinates = np.array([[0.6, 1], [2.4, 1], [1.1, 1], [1.9, 1]], dtype)
    low, high, rising, falling = np.asarray(remap(step, coordinates, method="bicubic")).astype(np.int64)
    # Integers of 32 bits end, without double precision, at the last float below their maximum.
    spacing = 2 ** (limits.bits - 24) if limits.bits == 32 and dtype == "float32" else 1
    assert low == limits.min
    assert limits.max - spacing < high <= limits.max
    assert limits.min < rising < falling < limits.max


@pytest.mark.parametrize("image_dtype", ["int32", "uint32"])
def test_extreme_integers_do_not_wrap_around(image_dtype, dtype):
    limits = np.iinfo(image_dtype)
    image = np.array([[limits.min, limits.max], [limits.max - 1, limits.min + 1]], image_dtype)
    samples = np.asarray(remap(image, pixel_centers(2, 2))).astype(np.int64)
    error = np.abs(samples - image.astype(np.int64)).max()
    assert error <= (0 if dtype == "float64" else 2 ** (limits.bits - 24))


@pytest.mark.parametrize(
    ("fill", "expected"), [(0, [0, 0, 0]), (300, [255, 255, 255]), (-4, [0, 0, 0]), ([1, 2.6, 1e9], [1, 3, 255])]
)
def test_fill_is_per_channel_rounded_and_saturated(fill, expected):
    image = np.full((4, 5, 3), 100, np.uint8)
    samples = remap(image, np.array([[-9.0, 2], [2, 2], [np.nan, 1]], np.float32), fill=np.array(fill))
    np.testing.assert_array_equal(samples, [expected, [100, 100, 100], expected])


def test_fill_blends_with_the_edge():
    image = np.full((3, 3), 10, np.float32)
    x = np.array([-0.25, 2.75, 3.5, -1.0], np.float32)
    np.testing.assert_allclose(remap(image, np.stack([x, 0 * x + 1], -1), fill=20), [12.5, 17.5, 20, 20], rtol=1e-6)


@pytest.mark.parametrize("coordinate_dtype", [np.float16, ml_dtypes.bfloat16])
def test_coarse_coordinates_address_every_pixel_they_can(coordinate_dtype):
    image = noise((2, 700))
    coordinates = np.array([[2, 1], [300, 0], [513, 1], [698, 0]]).astype(coordinate_dtype)
    x, y = np.asarray(coordinates, np.float32).astype(int).T
    np.testing.assert_array_equal(remap(image, coordinates), image[y, x])


# Coordinates out of the ordinary.


@each_border
@each_method
def test_coordinates_that_are_not_finite_take_the_fill_value(method, border, dtype):
    inf, nan = np.inf, np.nan
    coordinates = np.array([[nan, 1], [1, nan], [inf, 1], [1, -inf], [nan, nan], [2, 1]])
    image = noise(SIZE, dtype)
    samples = sample(image, coordinates, method, border, -3.0)
    np.testing.assert_array_equal(samples, [-3, -3, -3, -3, -3, image[1, 2]])


@each_method
def test_huge_coordinates(method):
    image = noise(SIZE)
    far = np.array([[1e30, 1], [-1e30, 1], [2**24 + 2, 2], [2, -1e9], [3e38, -3e38]], np.float32)
    np.testing.assert_array_equal(sample(image, far, method, "constant", -3.0), np.full(5, -3))
    clamped = image[[1, 1, 2, 0, 0], [12, 0, 12, 2, 12]]
    np.testing.assert_array_equal(sample(image, far, method, "edge"), clamped)
    # Where floats are further apart than pixels a sample is still one of the pixels, not a multiple of one.
    if method in ("nearest", "bilinear"):
        x, y = np.mod(far.astype(np.float64), [13, 12]).T.astype(int)
        np.testing.assert_array_equal(sample(image, far, method, "wrap"), image[y, x])
        x, y = np.mod(far.astype(np.float64), [26, 24]).T.astype(int)
        mirrored = image[np.minimum(y, 23 - y), np.minimum(x, 25 - x)]
        np.testing.assert_array_equal(sample(image, far, method, "reflect"), mirrored)


@each_border
def test_odd_pixels_beyond_the_precision_of_halves(border):
    # At 2²³ + 1 adding a half rounds to the next even number.
    image = np.arange(4, dtype=np.float32)[None]
    coordinates = np.array([[2**23 + 1, 0], [2**23 + 2, 0], [-(2**23) - 3, 0]], np.float32)
    expected = {"constant": [9, 9, 9], "edge": [3, 3, 0], "reflect": [1, 2, 2], "wrap": [1, 2, 1]}[border]
    np.testing.assert_array_equal(remap(image, coordinates, method="nearest", border=border, fill=9), expected)


@pytest.mark.parametrize(
    ("channels", "shape"),
    [((), (2,)), ((), (3, 4, 2)), ((1,), (7, 2)), ((3,), (2,)), ((3,), (2, 1, 3, 2)), ((5,), (7, 2)), ((), (0, 5, 2))],
)
def test_shapes(channels, shape):
    image = noise((6, 8, *channels))
    coordinates = np.random.default_rng(3).uniform(0, 5, shape).astype(np.float32)
    samples = remap(image, coordinates)
    assert samples.shape == shape[:-1] + channels
    if samples.size:
        plane = image.reshape(6, 8, -1)[..., -1]
        expected = reference_remap(plane, coordinates.reshape(-1, 2), "bilinear", "constant", 0)
        last = np.asarray(samples).reshape(len(expected), -1)[:, -1]
        np.testing.assert_allclose(last, expected, rtol=0, atol=1e-6)


def test_strided_arrays():
    image, coordinates = noise((12, 16, 3)), scattered(50, 0, 5)
    expected = remap(image[::2, ::-2].copy(), coordinates[::-1].copy())
    np.testing.assert_array_equal(remap(image[::2, ::-2], coordinates[::-1]), expected)
    transposed = remap(image.transpose(1, 0, 2), coordinates[:, ::-1])
    np.testing.assert_allclose(transposed, remap(image, coordinates), rtol=0, atol=1e-6)


# NaN among pixels and fill values.


@each_border
@each_method
def test_a_pixel_that_is_nan_spoils_only_what_its_kernel_spans(method, border):
    image = noise(SIZE)
    image[0, 0] = image[6, 6] = np.nan
    image[11, 12] = np.inf
    coordinates = np.concatenate([scattered(2000, -4, 16), [[np.nan, 3], [3, np.nan], [-90, 2]]]).astype(np.float32)
    samples = sample(image, coordinates, method, border, 0.5)
    clean = sample(np.nan_to_num(image, posinf=0), coordinates, method, border, 0.5)
    x, y = coordinates.astype(np.float64).T
    if border == "reflect":
        x, y = 12.5 - abs(np.mod(x + 0.5, 26) - 13), 11.5 - abs(np.mod(y + 0.5, 24) - 12)
    elif border == "wrap":
        x, y = np.mod(x, 13), np.mod(y, 12)
    elif border == "edge":
        x, y = np.clip(x, 0, 12), np.clip(y, 0, 11)
    spoilt = [(0, 0), (6, 6), (12, 11)]
    if border == "wrap":
        spoilt += [(13, 0), (0, 12), (13, 12), (-1, 11), (12, -1), (-1, -1)]
    # Where the taps reach beyond the edge of a constant border they are moved into the image, with weight zero.
    reach = {"nearest": 0.5, "bilinear": 1}.get(method, 2) * (2 if border == "constant" else 1)
    distance = np.min([np.maximum(abs(x - column), abs(y - row)) for column, row in spoilt], axis=0)
    untouched = ~(distance <= reach)
    outside = ~np.isfinite(coordinates).all(axis=-1)
    if border == "constant":
        outside |= (x < -2) | (y < -2) | (x > 14) | (y > 13)
    assert np.sum(untouched) > 900
    # Two programs may round the same sum differently.
    np.testing.assert_allclose(samples[untouched], clean[untouched], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(samples[outside], 0.5)
    assert np.isnan(sample(image, np.array([[6.2, 5.9]]), method, border, 0.5))


@each_border
@each_method
def test_fill_with_nan_marks_what_is_missing(method, border, dtype):
    image = noise(SIZE, dtype)
    inside = np.concatenate([scattered(2000, 1.01, 9.99, dtype), pixel_centers(*SIZE, dtype).reshape(-1, 2)])
    inside = np.concatenate([inside, [[-0.5, 11], [1e-9, 11.4]]]) if method == "nearest" else inside
    plain = sample(image, inside, method, border)
    rounding = 8 * float(np.finfo(dtype).eps)
    np.testing.assert_allclose(sample(image, inside, method, border, np.nan), plain, rtol=0, atol=rounding)
    assert np.isnan(sample(image, np.array([[np.nan, 4]]), method, border, np.nan))
    if border == "constant":
        outside = np.array([[-0.6, 5], [-9, 5], [5, 12], [99.5, 99.51]])
        assert np.all(np.isnan(sample(image, outside, method, border, np.nan)))
        assert np.all(sample(image, outside, method, border, np.inf) == np.inf)
        if method != "nearest":
            assert np.all(np.isnan(sample(image, np.array([[-0.01, 5], [5, 11.01]]), method, border, np.nan)))


def test_fill_with_nan_in_a_large_image(dtype):
    # The weights of far coordinates round like those of near ones.
    image = noise((600, 900), dtype)
    coordinates = np.random.default_rng(9).uniform(1, [897, 597], (3000, 2)).astype(dtype)
    for method in METHODS:
        assert np.all(np.isfinite(remap(image, coordinates, method=method, fill=np.nan)))


# Derivatives.


@partial(jax.jit, static_argnames=("method", "border"), compiler_options={"xla_backend_optimization_level": 0})
def loss_and_slopes(image, coordinates, fill, weights, method, border):
    """A weighted sum of the finite samples, and its derivatives by image, coordinates and fill."""

    def loss(image, coordinates, fill):
        samples = remap(image, coordinates, method=method, border=border, fill=fill)
        return jnp.sum(jnp.where(jnp.isfinite(samples), weights * samples, 0))

    return jax.value_and_grad(loss, argnums=(0, 1, 2))(image, coordinates, fill)


DERIVATIVE_SHAPE = (5, 6, 2)
each_smooth_method_and_border = pytest.mark.parametrize(
    ("method", "border"), [*product(["bilinear"], BORDERS), ("bicubic", "constant"), ("bicubic", "wrap")]
)


def derivatives(method, border, coordinates, image=None, fill=(0.3, -0.2), weights=None, dtype="float64", count=40):
    rows = np.arange(count) % len(coordinates)
    image = noise(DERIVATIVE_SHAPE, dtype) if image is None else image
    weights = np.ones((len(rows), 2), dtype) if weights is None else weights
    coordinates = np.asarray(coordinates, dtype)
    loss, slopes = loss_and_slopes(image, coordinates[rows], np.asarray(fill, dtype), weights, method, border)
    return float(loss), [np.asarray(slope) for slope in slopes]


@each_smooth_method_and_border
@pytest.mark.usefixtures("x64")
def test_derivatives_agree_with_finite_differences(method, border):
    random = np.random.default_rng(4)
    # Away from pixel centres, where the second derivative jumps (the first, for bilinear), and outside too.
    cells = np.array([[0, 0], [2, 3], [4, 1], [-1, 2], [5, 4], [7, 1], [-2, -2], [40, -30]], float)
    arguments = (
        cells + random.uniform(0.1, 0.9, cells.shape),
        noise(DERIVATIVE_SHAPE, "float64"),
        np.array([0.3, -0.2]),
    )
    weights = random.normal(size=(40, 2))
    evaluate = partial(derivatives, method, border, weights=weights)
    _, (by_image, by_coordinates, by_fill) = evaluate(*arguments)
    # Each point was repeated; their slopes belong together.
    by_coordinates = by_coordinates.reshape(-1, *cells.shape).sum(axis=0)
    for index, slope in enumerate((by_coordinates, by_image, by_fill)):
        for _ in range(4):
            step = random.normal(size=slope.shape)
            change = [
                evaluate(*(value + sign * 1e-6 * step if k == index else value for k, value in enumerate(arguments)))[0]
                for sign in (1, -1)
            ]
            np.testing.assert_allclose(np.sum(slope * step), (change[0] - change[1]) / 2e-6, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("border", ["constant", "reflect"])
@pytest.mark.usefixtures("x64")
def test_forward_and_reverse_derivatives_are_equal(border):
    image, coordinates = noise(DERIVATIVE_SHAPE, "float64"), scattered(40, -3, 8, "float64")
    weights, tangent = np.random.default_rng(5).normal(size=(2, 40, 2))
    _, (_, slope, _) = derivatives("bilinear", border, coordinates, weights=weights)

    def sample_along(points):
        return remap(image, points, border=border, fill=np.array([0.3, -0.2]))

    pushed = jax.jvp(sample_along, (coordinates,), (tangent,))[1]
    np.testing.assert_allclose(np.sum(weights * pushed), np.sum(slope * tangent), rtol=1e-12)


@each_smooth_method_and_border
@pytest.mark.usefixtures("x64")
def test_at_a_pixel_the_derivative_is_that_of_the_interpolant_on_its_right(method, border):
    # The identity map samples at pixel centres only: a fit that starts there follows these derivatives.
    image, centers = noise(DERIVATIVE_SHAPE, "float64"), pixel_centers(5, 6, "float64").reshape(-1, 2)
    step = 2**-20
    _, (_, at, _) = derivatives(method, border, centers, image)
    _, (_, right, _) = derivatives(method, border, centers + step, image)
    # Bilinear interpolation has a slope that changes along the other axis only; bicubic of curvature at most 6 or so.
    np.testing.assert_allclose(at, right, rtol=0, atol=24 * step)
    _, (_, flat, _) = derivatives(method, border, centers, np.full(DERIVATIVE_SHAPE, 0.25), (0.25, 0.25))
    np.testing.assert_allclose(flat, np.zeros((40, 2)), rtol=0, atol=1e-14)
    if method == "bilinear":
        slope, total = at[:30].reshape(5, 6, 2), image.sum(axis=-1)
        np.testing.assert_allclose(slope[:, :-1, 0], np.diff(total, axis=1), rtol=0, atol=1e-14)
        np.testing.assert_allclose(slope[:-1, :, 1], np.diff(total, axis=0), rtol=0, atol=1e-14)


def test_at_a_pixel_the_derivative_in_single_precision():
    image, centers = noise(DERIVATIVE_SHAPE), pixel_centers(5, 6).reshape(-1, 2)
    _, (_, slope, _) = derivatives("bilinear", "edge", centers, image, dtype="float32")
    expected = np.diff(image.sum(axis=-1), axis=1)
    np.testing.assert_allclose(slope[:30, 0].reshape(5, 6)[:, :-1], expected, rtol=0, atol=5e-7)


@pytest.mark.parametrize(
    ("method", "border"),
    [*product(["bilinear"], BORDERS), ("bicubic", "constant"), ("bicubic", "wrap"), ("nearest", "constant")],
)
@pytest.mark.usefixtures("x64")
def test_derivatives_are_finite_everywhere(method, border):
    nan, inf = np.nan, np.inf
    coordinates = np.array([[nan, 1], [1, inf], [1e300, 1], [-0.0, 5], [2.5, 2.5], [9, 9], [-0.5, 3], [1e30, -1e30]])
    for fill in ((0.3, -0.2), (nan, 1.0)):
        _, slopes = derivatives(method, border, coordinates, fill=fill)
        assert all(np.all(np.isfinite(slope)) for slope in slopes)
        np.testing.assert_array_equal(slopes[1].reshape(-1, 8, 2)[:, :2], np.zeros((5, 2, 2)))
        if method == "nearest":
            np.testing.assert_array_equal(slopes[1], np.zeros((40, 2)))


# Transformations.


@pytest.mark.parametrize("method", ["nearest", "bilinear", "bicubic"])
def test_jit_and_vmap_change_nothing(method):
    images = noise((3, 6, 7, 2))
    coordinates = np.stack([scattered(20, -3, 9, seed=seed) for seed in range(3)])
    one = partial(remap, method=method, fill=0.5)
    each = np.stack([one(image, points) for image, points in zip(images, coordinates, strict=True)])
    np.testing.assert_allclose(jax.vmap(one)(images, coordinates), each, rtol=0, atol=1e-6)
    np.testing.assert_allclose(jax.jit(jax.vmap(one))(images, coordinates), each, rtol=0, atol=1e-6)
    shared = jax.vmap(one, (None, 0))(images[0], coordinates)
    np.testing.assert_allclose(shared[0], each[0], rtol=0, atol=1e-6)
    fills = jnp.array([0.0, 1.0, 2.0])
    filled = jax.vmap(lambda fill: remap(images[0], np.full(2, -9, np.float32), method=method, fill=fill))(fills)
    np.testing.assert_array_equal(filled[:, 0], fills)


# Antialiasing.


def affine_grid(shape, matrix, offset, dtype="float32"):
    return (pixel_centers(*shape, "float64") @ np.transpose(matrix) + offset).astype(dtype)


def zone_plate(size):
    y, x = np.mgrid[:size, :size] - size / 2
    return (0.5 + 0.5 * np.cos(np.pi * (x * x + y * y) / size)).astype(np.float32)


def area_average(image, matrix, offset, shape, count=24):
    """What each output pixel covers of the source, averaged over a lattice of `count`² points."""
    steps = (np.arange(count) + 0.5) / count - 0.5
    total = np.zeros(shape)
    for dy, dx in product(steps, steps):
        points = affine_grid(shape, matrix, offset + np.asarray(matrix) @ [dx, dy], "float64")
        total += ndimage.map_coordinates(
            image.astype(np.float64), points[..., ::-1].transpose(2, 0, 1), order=1, mode="reflect"
        )
    return total / count**2


@pytest.mark.parametrize(
    ("method", "border"),
    [("nearest", "edge"), ("bilinear", "constant"), ("bilinear", "reflect"), ("bilinear", "wrap"), ("bicubic", "edge")],
)
def test_antialiasing_changes_nothing_where_nothing_shrinks(method, border):
    image = np.random.default_rng(6).integers(0, 255, (10, 12, 2), np.uint8)
    warp = partial(remap, image, method=method, border=border, fill=7)
    for scale in (1.0, 0.25, -0.5):
        grid = affine_grid((9, 8), [[scale, 0], [0, scale]], [3.5, 4.5])
        np.testing.assert_array_equal(warp(grid, antialias=True), warp(grid))


def test_antialiasing_changes_nothing_under_the_identity():
    image = noise((33, 47))
    np.testing.assert_array_equal(remap(image, pixel_centers(33, 47), antialias=True), image)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_antialiasing_changes_nothing_under_rotation():
    # The footprint's axes have length one up to rounding.
    angle = 0.3
    rotation = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    image, grid = noise((10, 12), "float64"), affine_grid((9, 8), rotation, [3, 1], "float64")
    np.testing.assert_allclose(remap(image, grid, antialias=True), remap(image, grid), rtol=0, atol=1e-12)


SHRINKS = {
    "isotropic": [[5.3, 0], [0, 5.3]],
    "power of two": [[4, 0], [0, 4]],
    "horizontal": [[6, 0], [0, 1]],
    "vertical": [[1, 0], [0, 4.5]],
    "rotated and anisotropic": [[4.2, 1.1], [-2.0, 3.0]],
}


@pytest.mark.parametrize("matrix", SHRINKS.values(), ids=SHRINKS.keys())
def test_shrinking_does_not_alias(matrix):
    size, shape = 256, (28, 30)
    image = zone_plate(size)
    middle = np.array([size, size]) / 2 - np.asarray(matrix) @ [15, 14] + 0.37
    grid = affine_grid(shape, matrix, middle)
    truth = area_average(image, matrix, middle, shape)
    # The plate's frequencies in cycles an output pixel; those above one half cannot be shown.
    frequency = np.abs((grid - size / 2) / size @ np.asarray(matrix)).max(axis=-1)
    visible, hidden = frequency < 0.25, frequency > 0.75

    def error(where, **options):
        return np.sqrt(np.mean((np.asarray(remap(image, grid, border="reflect", **options)) - truth)[where] ** 2))

    assert error(hidden) > 0.2
    assert error(hidden, antialias=True) < 0.3 * error(hidden)
    assert error(visible, antialias=True) < 0.06


def test_a_fine_checkerboard_turns_gray():
    board = (np.indices((128, 128)).sum(0) % 2 * 255).astype(np.uint8)
    grid = affine_grid((20, 20), [[6, 0], [0, 6]], [3, 3])
    plain, smooth = (
        np.asarray(remap(board, grid, border="edge", antialias=antialias)).astype(int) for antialias in (False, True)
    )
    assert np.ptp(plain) == 0  # every sample falls on the same colour
    assert abs(plain[0, 0] - 127.5) > 127
    np.testing.assert_allclose(smooth, np.full((20, 20), 127.5), rtol=0, atol=0.5)


@pytest.mark.parametrize(
    ("border", "image_dtype"), [("constant", "float32"), ("wrap", "float32"), ("edge", "uint8"), ("reflect", "uint16")]
)
def test_antialiasing_keeps_a_constant_image(border, image_dtype):
    grid = affine_grid((6, 7), [[5, 1], [0, 3]], [-4, 2])
    value = {"float32": 0.7, "uint8": 200, "uint16": 60001}[image_dtype]
    image = np.full((11, 13), value, image_dtype)
    samples = remap(image, grid, border=border, fill=value, antialias=True)
    np.testing.assert_allclose(samples, np.full((6, 7), value), rtol=1e-6 if image_dtype == "float32" else 0)


def test_antialiasing_beside_coordinates_that_are_not_finite():
    image = zone_plate(128)
    grid = affine_grid((24, 24), [[5, 0], [0, 5]], [4.3, 4.7])
    whole = np.asarray(remap(image, grid, antialias=True))
    holes = np.random.default_rng(7).uniform(size=(24, 24)) < 0.3
    grid[holes, 0] = np.nan
    grid[5, 5] = np.inf
    grid[12, 7] = [1e30, -3e38]
    samples = np.asarray(remap(image, grid, antialias=True, fill=-1))
    holes[5, 5] = holes[12, 7] = True
    np.testing.assert_array_equal(samples[holes], -1)
    # A pixel that still has a neighbour to each axis knows its footprint; its samples are the same.
    padded = np.pad(holes, 1, constant_values=True)
    neighbours = [padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]]
    huge = np.zeros_like(holes)
    huge[11:14, 6:9] = True
    known = ~holes & ~(neighbours[0] & neighbours[1]) & ~(neighbours[2] & neighbours[3]) & ~huge
    assert known.sum() > 250
    np.testing.assert_allclose(samples[known], whole[known], rtol=0, atol=1e-5)
    assert np.all(np.isfinite(samples))


@pytest.mark.parametrize("border", ["reflect", "wrap"])
def test_antialiasing_repeats_with_the_border(border):
    # Odd sizes: the halvings do not tile.
    image, grid = noise((9, 11)), affine_grid((4, 5), [[2.5, 0], [0, 2.5]], [0.25, 0.5])
    warp = partial(remap, border=border, antialias=True)
    shift = np.array([22, 18], np.float32)
    np.testing.assert_allclose(warp(image, grid + 50 * shift), warp(image, grid), rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "output"),
    [((1, 1), (1, 1)), ((1, 9), (1, 4)), ((2, 2), (3, 1)), ((7, 3), (0, 3)), ((7, 3), (4, 0)), ((7, 3), (3, 3))],
)
def test_antialiasing_of_small_sizes(shape, output):
    image, grid = noise(shape), affine_grid(output, [[3, 0], [0, 3]], [0, 0])
    samples = remap(image, grid, border="edge", antialias=True)
    assert samples.shape == output
    assert np.all((samples >= 0) & (samples <= 1))


@pytest.mark.usefixtures("x64")
def test_antialiasing_can_be_transformed():
    image, grid = noise((16, 18), "float64"), affine_grid((4, 5), [[3.3, 0.2], [0.1, 2.7]], [1.2, 1.3], "float64")
    warp = partial(remap, antialias=True, fill=0.4)
    many = jax.vmap(warp)(np.stack([image, 1 - image]), np.stack([grid, grid + 0.5]))
    np.testing.assert_allclose(many[0], warp(image, grid), rtol=0, atol=1e-13)
    np.testing.assert_allclose(many[1], warp(1 - image, grid + 0.5), rtol=0, atol=1e-13)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_derivatives_of_antialiasing():
    image, grid = noise((8, 9), "float64"), affine_grid((3, 4), [[2.3, 0.2], [0.1, 1.7]], [0.713, 1.337], "float64")
    direction = np.random.default_rng(8).normal(size=(3, 4))

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
    def project(image, grid):
        def total(image, grid):
            return jnp.sum(direction * remap(image, grid, antialias=True, fill=0.4))

        return jax.value_and_grad(total, argnums=(0, 1))(image, grid)

    _, (by_image, by_grid) = project(image, grid)
    # The footprint carries no derivative: shift the grid as a whole, under which it stays.
    step = np.array([1e-6, -2e-6])
    slope = (project(image, grid + step)[0] - project(image, grid - step)[0]) / 2
    np.testing.assert_allclose(np.sum(by_grid @ step), slope, rtol=1e-6)
    slope = (project(image + 1e-3 * image**2, grid)[0] - project(image - 1e-3 * image**2, grid)[0]) / 2e-3
    np.testing.assert_allclose(np.sum(by_image * image**2), slope, rtol=1e-10)
    grid[1, 1] = np.nan
    grid[2, 3, 0] = np.inf
    assert all(np.all(np.isfinite(slopes)) for slopes in project(image, grid)[1])


# Misuse.


@pytest.mark.usefixtures("_untyped")
@pytest.mark.parametrize(
    ("image", "coordinates", "options", "message"),
    [
        (np.zeros(4), np.zeros(2), {}, r"\(H, W\) or \(H, W, C\).*\(4,\)"),
        (np.zeros((1, 2, 3, 4)), np.zeros(2), {}, r"\(1, 2, 3, 4\)"),
        (np.zeros((0, 4)), np.zeros(2), {}, "at least one pixel"),
        (np.zeros((3, 4, 0)), np.zeros(2), {}, "at least one pixel"),
        (np.zeros((3, 4), complex), np.zeros(2), {}, "must be real.*real and imaginary parts"),
        (np.zeros((3, 4)), np.zeros(3), {}, r"\(\.\.\., 2\) in \(x, y\) order, got \(3,\)"),
        (np.zeros((3, 4)), np.float32(1), {}, r"\(\.\.\., 2\)"),
        (np.zeros((3, 4)), np.zeros(2, complex), {}, "expected real numbers"),
        (np.zeros((3, 4)), np.zeros(2), {"method": "lanczos"}, "one of nearest, .*bicubic_opencv, got 'lanczos'"),
        (np.zeros((3, 4)), np.zeros(2), {"border": "mirror"}, "one of constant, edge, reflect, wrap, got 'mirror'"),
        (np.zeros((3, 4, 3)), np.zeros(2), {"fill": np.zeros(2)}, r"each of the 3 channels, got shape \(2,\)"),
        (np.zeros((3, 4)), np.zeros(2), {"fill": np.zeros((1, 1))}, r"got shape \(1, 1\)"),
        (np.zeros((3, 4)), np.zeros((5, 2)), {"antialias": True}, r"shape \(H, W, 2\).*got \(5, 2\)"),
    ],
)
def test_misuse_is_a_value_error(image, coordinates, options, message):
    with pytest.raises(ValueError, match=message):
        remap(image, coordinates, **options)


def test_options_are_keyword_only():
    with pytest.raises(TypeError):
        remap(np.zeros((3, 4)), np.zeros(2), "nearest")
