"""From one family of lenses to another, and how two cameras differ."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl

pytestmark = pytest.mark.usefixtures("x64")
FRAME = [319.5, 239.5], 420.0


def camera(lens):
    return jl.Camera(lens, jl.Frame(*FRAME), 640, 480)


@pytest.mark.parametrize(
    ("lens", "family", "terms", "expected"),
    [
        (lambda: jl.RadialPolynomial([-0.2, 0.05]), jl.BrownConrady, 5, [-0.2, 0.05, 0, 0, 0]),
        (lambda: jl.Poly5(-0.1, 0.02), jl.RadialPolynomial, 2, [-0.1, 0.02]),
        (jl.Equidistant, jl.KannalaBrandt, 4, [0, 0, 0, 0]),
    ],
    ids=["polynomial", "poly5", "equidistant"],
)
def test_a_family_that_contains_the_lens_is_met_exactly(lens, family, terms, expected):
    found = jl.fitting.convert(camera(lens()), family, terms=terms)
    assert float(found.largest) < 1e-9
    np.testing.assert_allclose(found.camera.lens.coefficients, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.camera.frame.scale, 420.0, rtol=1e-11)


def test_a_fisheye_in_other_words_is_met_as_well_as_it_can_be():
    fisheye = camera(jl.KannalaBrandt([-0.02, 0.003, -0.001, 0.0001]))
    found = jl.fitting.convert(fisheye, jl.DoubleSphere)
    assert float(found.rms) < float(found.largest) < 1
    # What it says is so: over all pixels, not those of its grid.
    y, x = np.mgrid[:480:7, :640:7]
    pixels = np.stack([x, y], -1).astype(float)
    apart = np.hypot(*np.moveaxis(np.asarray(found.camera.project(fisheye.unproject(pixels)) - pixels), -1, 0))
    assert apart.max() <= 1.02 * float(found.largest)
    at_worst = found.camera.project(fisheye.unproject(found.where)) - found.where
    assert float(jnp.hypot(*at_worst)) == pytest.approx(float(found.largest), rel=1e-6)


def test_what_a_plane_cannot_hold_is_refused():
    wide = jl.Camera(jl.Equidistant(), jl.Frame([319.5, 239.5], 180.0), 640, 480)
    with pytest.raises(ValueError, match=r"% of the picture lie 90° or more from the axis, where BrownConrady"):
        jl.fitting.convert(wide, jl.BrownConrady)


def test_two_cameras_differ_after_the_best_rotation():
    first = camera(jl.BrownConrady([-0.2, 0.05, 0.001, 0.0]))
    same = jl.diagnostics.difference(first, first)
    assert float(same.rms) < 1e-9
    np.testing.assert_allclose(same.rotation, np.eye(3), rtol=0, atol=1e-12)
    # A principal point a little aside is mostly a rotation, and the rest is a difference of lenses.
    aside = jl.Camera(first.lens, jl.Frame([321.5, 239.5], 420.0), 640, 480)
    turned, fixed = (jl.diagnostics.difference(first, aside, rotate=rotate) for rotate in (True, False))
    np.testing.assert_allclose(fixed.distances, 2.0, rtol=1e-9)
    assert float(turned.rms) < 0.25
    assert float(jnp.arctan(2 / 420)) == pytest.approx(
        float(jnp.linalg.norm(turned.rotation - jnp.eye(3))) / 2**0.5, rel=0.2
    )
    # No small rotation does better.
    import jaxlie

    rays = first.unproject(turned.pixels)
    for axis in 1e-5 * np.concatenate([np.eye(3), -np.eye(3)]):
        moved = jaxlie.SO3.exp(jnp.asarray(axis)).as_matrix() @ turned.rotation
        offsets = aside.project(jnp.einsum("ij,...j->...i", moved, rays)) - turned.pixels
        assert float(jnp.mean(jnp.sum(offsets**2, -1))) > float(turned.rms) ** 2


def test_differences_are_differentiable():
    def apart(k):
        return jl.diagnostics.difference(camera(jl.RadialPolynomial(jnp.stack([k]))), camera(jl.Perspective())).rms

    slope = jax.grad(apart)(-0.1)
    assert float(slope) == pytest.approx(float((apart(-0.1 + 1e-5) - apart(-0.1 - 1e-5)) / 2e-5), rel=1e-4)
