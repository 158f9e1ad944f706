"""`jax.export` with symbols for the sizes: one compiled function for pictures of every size."""

import jax
import jaxtyping
import numpy as np
import pytest
from jax import export

import jaxlens as jl

FRAME = jl.Frame([30.0, 20.0], [50.0, 55.0])
SIZES = (31, 47), (120, 75)
# The barrels fold within the picture.
RADIAL = jl.RadialPolynomial([-0.3, 0.02])
BROWN = jl.BrownConrady([-0.2, 0.01, 0.001, 0.002, 0.0])
# At a fold rounding grows to its root in an inverse: this one has none.
PINCUSHION = jl.BrownConrady([0.1, 0.01, 0.001, 0.002, 0.0])


@pytest.fixture(autouse=True)
def _untyped():
    """Leaves sizes to JAX, as it is for users: for jaxtyping's hook a symbol is not an `int`."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def picture(shape, dtype):
    return np.random.default_rng(0).uniform(0, 255, shape).astype(dtype)


def exported(function, dtype, shape, *arguments):
    shape = export.symbolic_shape(shape)
    return export.export(jax.jit(function))(jax.ShapeDtypeStruct(shape, dtype), *arguments)


def assert_same(result, expected):
    """Alike to the rounding of coordinates: XLA fuses arithmetic otherwise where it knows the sizes."""
    assert result.dtype == expected.dtype
    in_pixels = max(result.shape) * 2.0**-21
    tolerance = 1 if result.dtype == np.uint8 else 255 * in_pixels
    np.testing.assert_allclose(np.asarray(result, float), np.asarray(expected, float), rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("function", "lens", "frame", "image_dtype"),
    [
        (jl.undistort_image, RADIAL, None, "uint8"),
        (jl.undistort_image, BROWN, FRAME, "float32"),
        (jl.distort_image, PINCUSHION, FRAME, "float32"),
    ],
)
def test_sizes_are_symbols(function, lens, frame, image_dtype):
    def through(image, lens, frame):
        return function(image, lens, frame=frame)

    compiled = exported(through, image_dtype, "h, w, 3", lens, frame)
    for size in SIZES:
        image = picture((*size, 3), image_dtype)
        assert_same(compiled.call(image, lens, frame), jax.jit(through)(image, lens, frame))


@pytest.mark.parametrize("border", ["reflect", "wrap"])
def test_borders_of_any_size(border):
    def through(image):
        return jl.undistort_image(image, RADIAL, border=border, method="bicubic")

    compiled = exported(through, np.float32, "h, w")
    for size in ((1, 1), SIZES[0]):
        image = picture(size, np.float32)
        assert_same(compiled.call(image), through(image))


def test_a_batch_of_any_size():
    """Large problems take turns and small ones do not; of a symbol none can say which it is."""

    def through(images, coefficients):
        lenses = jax.vmap(jl.BrownConrady)(coefficients)
        return jax.vmap(lambda image, lens: jl.undistort_image(image, lens, frame=FRAME))(images, lenses)

    scope = export.SymbolicScope()
    images = jax.ShapeDtypeStruct(export.symbolic_shape("b, h, w", scope=scope), np.uint8)
    coefficients = jax.ShapeDtypeStruct(export.symbolic_shape("b, 5", scope=scope), np.float32)
    compiled = export.export(jax.jit(through))(images, coefficients)
    for count, size in zip((2, 3), SIZES, strict=True):
        images = picture((count, *size), np.uint8)
        coefficients = np.random.default_rng(1).uniform(-0.1, 0.1, (count, 5)).astype(np.float32)
        assert_same(compiled.call(images, coefficients), jax.jit(through)(images, coefficients))
