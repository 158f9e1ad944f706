"""Fisheyes with thin-prism terms: COLMAP in both directions, and their flags by brute force."""

from functools import partial

import numpy as np
import pytest
from preimages import check_against_a_search

import jaxlens as jl

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

FOCAL = 1000.0
# How large random coefficients are: k, then the rest.
LENSES = {
    jl.ThinPrismFisheye: ("THIN_PRISM_FISHEYE", np.array([3e-2, 1e-2, 2e-3, 2e-3, 2e-3, 2e-4, 2e-3, 2e-3])),
    jl.RadTanThinPrismFisheye: (
        "RAD_TAN_THIN_PRISM_FISHEYE",
        np.array([3e-2, 1e-2, 2e-3, 2e-4, 2e-5, 2e-6, 2e-3, 2e-3, 2e-3, 2e-4, 2e-3, 2e-4]),
    ),
}
lenses = pytest.mark.parametrize("lens", LENSES)


def rays(count, widest, seed=0):
    random = np.random.default_rng(seed)
    angle, azimuth = random.uniform(0, widest, count), random.uniform(0, 2 * np.pi, count)
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], -1)


def cameras(lens, count):
    """Random lenses, and COLMAP's cameras of the same."""
    pycolmap, random = pytest.importorskip("pycolmap"), np.random.default_rng(1)
    model, sizes = LENSES[lens]
    for _ in range(count):
        k = sizes * random.uniform(-1, 1, len(sizes))
        yield lens(k), pycolmap.Camera(model=model, width=100, height=100, params=[FOCAL, FOCAL, 0, 0, *k])


@lenses
def test_it_is_colmap_s_and_comes_back(x64, lens):
    directions = rays(10_000, 1.5)
    for ours, theirs in cameras(lens, 20):
        observed, expected = np.asarray(ours.project(directions)), theirs.img_from_cam(directions) / FOCAL
        seen = np.isfinite(observed).all(axis=-1)
        assert seen.mean() > 0.9
        np.testing.assert_allclose(observed[seen], expected[seen], rtol=1e-10, atol=1e-15)
        back = np.asarray(ours.unproject(observed))
        # Next to the fold rounding moves the ray by more than it is.
        inside = seen & (directions[:, 2] > np.cos(0.98 * float(ours.field_of_view())))
        assert FOCAL * np.max(np.abs(np.asarray(ours.project(back)) - observed)[seen]) < 1e-9
        assert FOCAL * np.max(np.abs(back - directions)[inside]) < 1e-9


def test_what_colmap_answers_is_ours_or_wrong(x64):
    """Its iteration may end nowhere, or on the far side of a fold; where it is right we are, too."""
    observed = np.random.default_rng(2).uniform(-1.6, 1.6, (10_000, 2))
    for lens in LENSES:
        for ours, theirs in cameras(lens, 3):
            ray, inverse = np.asarray(ours.unproject(observed)), theirs.cam_from_img(FOCAL * observed)
            theirs_back = np.column_stack([inverse, np.ones(len(inverse))])
            right = np.isfinite(inverse).all(axis=-1)
            again = np.asarray(ours.project(np.where(right[:, None], theirs_back, 1.0)))
            right &= np.max(np.abs(again - observed), axis=-1) < 1e-8  # false for NaN
            assert right.mean() > 0.3
            unit = theirs_back / np.linalg.norm(theirs_back, axis=-1, keepdims=True)
            np.testing.assert_allclose(ray[right], unit[right], rtol=0, atol=1e-7)
            valid = np.isfinite(ray).all(axis=-1)
            np.testing.assert_allclose(ours.project(ray[valid]), observed[valid], rtol=0, atol=1e-12)


def thin_prism(points, coefficients):
    k1, k2, p1, p2, k3, k4, s1, s2 = coefficients
    u, v = points
    s = u * u + v * v
    radial = k1 * s + k2 * s**2 + k3 * s**3 + k4 * s**4
    across = u * radial + 2 * p1 * u * v + p2 * (s + 2 * u * u) + s1 * s
    return points + np.stack([across, v * radial + 2 * p2 * u * v + p1 * (s + 2 * v * v) + s2 * s])


def rad_tan_thin_prism(points, coefficients):
    p, s = np.array(coefficients[6:8]), coefficients[8:]
    squared = np.sum(points * points, axis=0)
    m = points * (1 + sum(k * squared ** (i + 1) for i, k in enumerate(coefficients[:6])))
    squared = np.sum(m * m, axis=0)
    tangential = 2 * m * np.tensordot(p, m, 1) + np.multiply.outer(p, squared)
    prism = np.stack([s[0] * squared + s[1] * squared**2, s[2] * squared + s[3] * squared**2])
    return m + tangential + prism


@pytest.mark.slow
@lenses
def test_flags_against_every_preimage_that_a_search_finds(x64, lens):
    random, sizes, answers = np.random.default_rng(3), LENSES[lens][1], []
    equation = thin_prism if lens is jl.ThinPrismFisheye else rad_tan_thin_prism
    for _ in range(20):
        k = 4 * sizes * random.uniform(-1, 1, len(sizes))
        observed = random.uniform(-2.4, 2.4, (60, 2))
        inverse = lens(k).plane.invert(observed)
        check_against_a_search(partial(equation, coefficients=k), observed, inverse.points, inverse.valid, reach=3.2)
        # Of those the directions are valid whose angle is less than half a turn.
        ahead = np.asarray(inverse.valid) & (np.hypot(*np.asarray(inverse.points).T) < np.pi)
        np.testing.assert_array_equal(lens(k).invert_projection(observed).valid, ahead)
        answers.append(ahead)
    assert 0.2 < np.mean(answers) < 0.95


@pytest.mark.slow
@lenses
def test_single_precision_comes_back(lens):
    for ours, _ in cameras(lens, 5):
        ours = lens(np.float32(ours.coefficients))
        directions = rays(10_000, 0.95 * min(1.7, float(ours.field_of_view()))).astype(np.float32)
        observed = ours.project(directions)
        back = ours.unproject(observed)
        assert back.dtype == np.float32
        assert FOCAL * np.max(np.abs(np.asarray(ours.project(back)) - np.asarray(observed))) < 5e-3


@lenses
def test_turned_it_is_the_lens_of_the_turned_picture(x64, lens):
    points = np.random.default_rng(4).uniform(-0.7, 0.7, (100, 2))
    turned = np.stack([points[:, 1], -points[:, 0]], axis=-1)
    for one, _ in cameras(lens, 1):
        x, y = np.asarray(one.distort(points)).T
        assert isinstance(one.turned(1), lens)
        np.testing.assert_allclose(one.turned(1).distort(turned), np.stack([y, -x], axis=-1), rtol=0, atol=1e-15)


def test_a_wrong_number_of_coefficients():
    with pytest.raises(ValueError, match="sx1, sy1, that is 8 numbers, got 7"):
        jl.ThinPrismFisheye(np.zeros(7))
    with pytest.raises(ValueError, match="s2, s3, that is 12 numbers, got 8"):
        jl.RadTanThinPrismFisheye(np.zeros(8))
    assert jl.ThinPrismFisheye.identity().parameter_names("coefficients", (8,))[4:] == ["k3", "k4", "sx1", "sy1"]
