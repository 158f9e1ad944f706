from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import jaxlens as jl
from jaxlens.diagnostics import coverage, jacobian_determinant, largest_rectangle, multiplicity, zoom_to_fill


def normalized_pixels(height, width):
    """Pixel centres in Eq. 10's frame."""
    y, x = np.mgrid[:height, :width].astype(float)
    return np.stack([x - width / 2, y - height / 2], axis=-1) / (np.hypot(height, width) / 2)


def to_pixels(points, height, width):
    return np.asarray(points) * np.hypot(height, width) / 2 + [width / 2, height / 2]


# The Jacobian determinant.


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("coefficients", [[0.3], [-0.9], [-2.0, 0.5], [0.1, -0.4, 0.2], []])
def test_determinant_in_closed_form(coefficients):
    # For ρ Φ(ρ²) along rays: the slope along the ray times the ratio of radii across it.
    squared = np.sum(normalized_pixels(11, 14) ** 2, axis=-1)
    powers = np.arange(1, len(coefficients) + 1)
    terms = np.array(coefficients) * squared[..., None] ** powers
    expected = (1 + terms.sum(-1)) * (1 + ((2 * powers + 1) * terms).sum(-1))
    determinant = jacobian_determinant(jl.RadialPolynomial(coefficients), 11, 14)
    np.testing.assert_allclose(determinant, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "make",
    [
        lambda: jl.RadialPolynomial([-0.6, 0.3], center=[0.1, -0.2]),
        lambda: jl.Division(0.3),
        lambda: jl.Division(0.3).inverse(),
        lambda: jl.RadialPolynomial([0.2]).then(jl.Division(-0.1)),
    ],
    ids=["polynomial", "division", "inverse", "chain"],
)
def test_determinant_agrees_with_finite_differences(make):
    mapping = make()
    frame = jl.Frame([6.5, 5.2], [14, 11])
    determinant = jacobian_determinant(mapping, 10, 13, frame=frame)
    points, step = np.asarray(frame.normalize(np.stack(np.mgrid[:10, :13][::-1], -1).astype(float))), 1e-5
    right, down = np.array([step, 0]), np.array([0, step])
    ahead_x, behind_x, ahead_y, behind_y = jax.lax.map(
        mapping, np.stack([points + right, points - right, points + down, points - down])
    )
    along_x, along_y = np.asarray(ahead_x - behind_x) / (2 * step), np.asarray(ahead_y - behind_y) / (2 * step)
    expected = along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0]
    np.testing.assert_allclose(determinant, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.usefixtures("x64")
def test_determinant_turns_negative_at_the_fold():
    lens = jl.RadialPolynomial([-0.9])
    beyond = np.hypot(*normalized_pixels(40, 30).transpose(2, 0, 1)) > np.sqrt(1 / 2.7)
    # Past 1 / √0.9 > 1 the ratio of radii would be negative as well; that lies outside the picture.
    np.testing.assert_array_equal(jacobian_determinant(lens, 40, 30) < 0, beyond)


# Coverage.


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "make",
    [
        lambda: jl.RadialPolynomial([0.5]),
        lambda: jl.RadialPolynomial([-0.3]).inverse(),
        lambda: jl.RadialPolynomial([0.5]).inverse(),
    ],
    ids=["pincushion", "barrel's inverse", "pincushion's inverse"],
)
def test_coverage_agrees_with_the_definition(make):
    mapping = make()
    sources = to_pixels(mapping(normalized_pixels(23, 31)), 23, 31)
    x, y = sources.transpose(2, 0, 1)
    expected = np.array(
        [[0 <= x[i, j] <= 30 and 0 <= y[i, j] <= 22 for j in range(31)] for i in range(23)]  # NaN is not inside
    )
    mask = coverage(mapping, 23, 31)
    assert mask.dtype == bool
    np.testing.assert_array_equal(mask, expected)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (30, 41), (480, 640)])
def test_the_identity_covers_all(shape, dtype):
    lens = jl.RadialPolynomial(np.zeros(2, dtype))
    assert np.all(coverage(lens, *shape))
    assert np.all(coverage(lens.inverse(), *shape))


def test_what_is_covered_does_not_see_the_fill_value():
    lens = jl.RadialPolynomial([-0.25, 0.02])
    mask = np.asarray(coverage(lens.inverse(), 40, 50))
    black, white = (np.asarray(jl.distort_image(np.full((40, 50), 0.5), lens, fill=fill)) for fill in (0, 1))
    assert 0 < mask.sum() < mask.size
    np.testing.assert_allclose(black[mask], white[mask], rtol=0, atol=1e-4)
    assert np.all(white[~mask] > black[~mask])


# Multiplicity.


def test_the_identity_draws_from_each_pixel_once(dtype):
    coordinates = jl.distortion_map(jl.RadialPolynomial(np.zeros(1, dtype)), 17, 23)
    np.testing.assert_array_equal(multiplicity(coordinates, 17, 23), np.ones((17, 23)))


def test_magnification_repeats_pixels():
    # The output samples the left upper quarter at half steps: each pixel four times.
    y, x = np.mgrid[:20, :24].astype(np.float32)
    counts = np.asarray(multiplicity(jnp.stack([x / 2 - 0.25, y / 2 - 0.25], axis=-1), 20, 24))
    expected = np.zeros((20, 24))
    expected[:10, :12] = 4
    np.testing.assert_array_equal(counts, expected)


@pytest.mark.parametrize("coefficients", [[1.0, 2.0], [-0.3], [-2.0, 0.5]])
@pytest.mark.parametrize("which", [jl.distortion_map, jl.undistortion_map])
def test_multiplicity_counts_every_sample_inside(coefficients, which):
    coordinates = which(jl.RadialPolynomial(coefficients), 30, 41)
    counts = np.asarray(multiplicity(coordinates, 30, 41))
    expected = np.zeros((30, 41), int)
    for x, y in np.asarray(coordinates).reshape(-1, 2):
        if np.isfinite(x) and -0.5 <= x < 40.5 and -0.5 <= y < 29.5:
            expected[int(np.floor(y + 0.5)), int(np.floor(x + 0.5))] += 1
    assert expected.sum() > 0
    np.testing.assert_array_equal(counts, expected)


def test_multiplicity_is_what_nearest_sampling_does():
    coordinates = np.random.default_rng(0).uniform(-4, 16, (600, 2)).astype(np.float32)
    coordinates[::7] = np.round(coordinates[::7] * 2) / 2
    numbers = np.arange(12 * 11).reshape(12, 11)
    drawn = np.asarray(jl.remap(numbers.astype(np.float32), coordinates, method="nearest", fill=-1)).astype(int)
    counts = np.bincount(drawn[drawn >= 0], minlength=132).reshape(12, 11)
    np.testing.assert_array_equal(multiplicity(jnp.asarray(coordinates), 12, 11), counts)


def test_multiplicity_of_samples_nowhere():
    nan, inf = np.nan, np.inf
    coordinates = jnp.array([[nan, 1], [1, nan], [inf, 1], [1, -inf], [1e30, 1], [-0.6, 1], [1, 3.5], [1, 3.4]])
    expected = np.zeros((4, 5))
    expected[3, 1] = 1
    np.testing.assert_array_equal(multiplicity(coordinates, 4, 5), expected)
    np.testing.assert_array_equal(multiplicity(jnp.zeros((0, 2)), 4, 5), np.zeros((4, 5)))


# The largest rectangle.


def every_rectangle(mask):
    """All rectangles on which the mask is true, as (top, left, height, width)."""
    height, width = mask.shape
    return [
        (top, left, bottom - top, right - left)
        for top in range(height)
        for bottom in range(top + 1, height + 1)
        for left in range(width)
        for right in range(left + 1, width + 1)
        if mask[top:bottom, left:right].all()
    ]


def check_largest(mask):
    top, left, height, width = (int(value) for value in largest_rectangle(jnp.asarray(mask)))
    areas = [rectangle[2] * rectangle[3] for rectangle in every_rectangle(mask)]
    assert height * width == max(areas, default=0)
    if areas:
        assert mask[top : top + height, left : left + width].shape == (height, width)
        assert mask[top : top + height, left : left + width].all()
        # Of equal areas the one that ends first, from the top.
        bottoms = [r[0] + r[2] for r, area in zip(every_rectangle(mask), areas, strict=True) if area == max(areas)]
        assert top + height == min(bottoms)
    else:
        assert (top, left, height, width) == (0, 0, 0, 0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.sampled_from([(6, 7), (1, 9), (8, 1)]).flatmap(
        lambda shape: hnp.arrays(bool, shape, elements=st.sampled_from([True, True, True, False]))
    )
)
def test_the_largest_rectangle_of_any_mask(mask):
    check_largest(mask)


@pytest.mark.parametrize("seed", range(8))
def test_the_largest_rectangle_of_sparse_and_dense_masks(seed):
    random = np.random.default_rng(seed)
    check_largest(random.uniform(size=(9, 10)) < (0.97, 0.9, 0.7, 0.4)[seed % 4])


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1), (7, 4)])
def test_the_largest_rectangle_of_uniform_masks(shape, dtype):
    assert [int(v) for v in largest_rectangle(jnp.ones(shape, bool))] == [0, 0, *shape]
    assert [int(v) for v in largest_rectangle(jnp.zeros(shape, bool))] == [0, 0, 0, 0]


def test_the_largest_rectangle_crops_the_border_away():
    lens = jl.RadialPolynomial([-0.25])
    mask = coverage(lens.inverse(), 60, 80)
    top, left, height, width = (int(value) for value in largest_rectangle(mask))
    assert 0.2 < height * width / 4800 < 1
    picture = np.asarray(jl.distort_image(np.ones((60, 80)), lens))
    np.testing.assert_allclose(picture[top : top + height, left : left + width], 1, atol=1e-3)
    batch = jax.vmap(largest_rectangle)(jnp.stack([mask, ~mask]))
    assert [int(value[0]) for value in batch] == [top, left, height, width]


# The zoom that fills.


def fills(mapping, zoom, height, width, frame=None):
    frame = jl.Frame.half_diagonal(height, width) if frame is None else frame
    sources = np.asarray(
        jl.source_coordinates(mapping, height, width, frame=frame, output_frame=frame.zoomed(jnp.asarray(zoom)))
    )
    return bool(np.all((sources >= -1e-9) & (sources <= [width - 1 + 1e-9, height - 1 + 1e-9])))


ZOOMED = {
    "polynomials": [partial(jl.RadialPolynomial, kappas) for kappas in ([0.4, 0.1], [-0.2, 0.0], [-0.3, 0.2])],
    "off centre": [partial(jl.RadialPolynomial, [0.3], center=[0.1, 0.05])],
    "division": [partial(jl.Division, 0.3)],
    "their inverses": [
        lambda kappas=kappas: jl.RadialPolynomial(kappas).inverse()
        for kappas in ([0.4, 0.1], [-0.2, 0.0], [-0.45, 0.0])
    ],
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("group", ZOOMED)
@pytest.mark.parametrize("shape", [(48, 64)])
def test_the_zoom_fills_and_no_less_does(group, shape):
    for make in ZOOMED[group]:
        mapping = make()
        zoom = float(zoom_to_fill(mapping, *shape))
        assert fills(mapping, zoom, *shape)
        assert not fills(mapping, 0.999 * zoom, *shape)


@pytest.mark.usefixtures("x64")
def test_the_zoomed_picture_has_no_black_border():
    lens, shape = jl.RadialPolynomial([0.4, 0.1]), (33, 20)
    frame = jl.Frame.half_diagonal(*shape)
    zoom = zoom_to_fill(lens, *shape)
    picture, smaller = (
        np.asarray(jl.undistort_image(np.ones(shape), lens, output_frame=frame.zoomed(factor * zoom)))
        for factor in (1, 0.999)
    )
    np.testing.assert_allclose(picture, np.ones(shape), atol=1e-9)
    assert smaller.min() < 0.999


def test_barrel_pictures_need_zoom_in_one_direction_only():
    barrel, pincushion = jl.RadialPolynomial([-0.2]), jl.RadialPolynomial([0.3])
    assert zoom_to_fill(barrel.inverse(), 48, 64) > 1.01  # the distorted picture of a barrel lens has black borders
    assert zoom_to_fill(barrel, 48, 64) < 0.99
    assert zoom_to_fill(pincushion, 48, 64) > 1.01
    assert zoom_to_fill(pincushion.inverse(), 48, 64) < 0.99


def test_the_identity_needs_no_zoom(dtype):
    zoom = zoom_to_fill(jl.RadialPolynomial(np.zeros(1, dtype)), 40, 60)
    assert zoom.dtype == dtype
    np.testing.assert_allclose(zoom, 1, atol=5e-5 if dtype == "float32" else 1e-7)


@pytest.mark.usefixtures("x64")
def test_the_zoom_in_closed_form():
    # A map that halves needs a zoom of one half, and one that doubles two.
    for factor in (0.5, 2.0):
        frame = jl.Frame([15.0, 10.0], 20.0)
        mapping = jl.RadialPolynomial([]).then(Scaling(jnp.asarray(factor)))
        np.testing.assert_allclose(zoom_to_fill(mapping, 21, 31, frame=frame), factor, rtol=1e-7)


class Scaling(jl.CoordinateMap):
    factor: jax.Array

    def __call__(self, points):
        return self.factor * points


def test_no_zoom_fills_where_the_center_is_outside():
    zoom = zoom_to_fill(jl.RadialPolynomial([0.1]), 20, 30, frame=jl.Frame([-5, 10], 20))
    assert np.isnan(zoom)


@pytest.mark.parametrize("function", [coverage, zoom_to_fill, jacobian_determinant])
def test_diagnostics_can_be_vectorized(function):
    coefficients = np.array([[0.1, 0.2], [-0.2, 0.05]], np.float32)
    batch = jax.vmap(lambda row: function(jl.RadialPolynomial(row), 12, 17))(coefficients)
    for row, result in zip(coefficients, batch, strict=True):
        np.testing.assert_allclose(result, function(jl.RadialPolynomial(row), 12, 17), rtol=1e-5)
