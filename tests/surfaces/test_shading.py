"""Normals and Lambert's law: planes and a sphere in closed form, masks, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens.surfaces import DepthMap, normals, shade

ROWS, COLUMNS = np.mgrid[0:12, 0:16].astype(float)
# A mask with a hole, a lone pixel, a horizontal strip and a vertical one.
MASK = np.zeros((12, 16), bool)
MASK[2:9, 1:8] = True
MASK[5, 4] = False
MASK[0, 15] = True
MASK[11, 9:13] = True
MASK[2:6, 13] = True


def _plane(dtype=float, mask=None):
    """Slope 0.5 along x and −0.25 along y in world units, for pixels of 2 by 4."""
    return DepthMap((1 + 0.5 * 2 * COLUMNS - 0.25 * 4 * ROWS).astype(dtype), mask=mask, spacing=(2.0, 4.0))


def test_a_plane_is_exact(dtype):
    found = normals(_plane(dtype))
    assert found.dtype == dtype
    expected = np.array([-0.5, 0.25, 1.0]) / np.sqrt(1.3125)
    np.testing.assert_allclose(found, np.broadcast_to(expected, (12, 16, 3)), rtol=4 * jnp.finfo(dtype).eps)


def test_a_plane_is_exact_at_the_borders_of_a_mask(x64):
    """Outside the mask the depths are wild; a pixel with no neighbour along an axis has no slope along it."""
    surface = _plane(mask=MASK)
    surface = DepthMap(jnp.where(MASK, surface.depth, 1e9), mask=MASK, spacing=surface.spacing)
    found = np.asarray(normals(surface))
    full = np.array([-0.5, 0.25, 1.0]) / np.sqrt(1.3125)
    block = MASK[2:9, 1:8]
    np.testing.assert_allclose(found[2:9, 1:8][block], np.broadcast_to(full, (block.sum(), 3)), rtol=1e-15)
    np.testing.assert_array_equal(found[0, 15], [0, 0, 1])
    np.testing.assert_array_equal(found[~MASK], np.broadcast_to([0.0, 0.0, 1.0], ((~MASK).sum(), 3)))
    np.testing.assert_allclose(found[11, 10], np.array([-0.5, 0, 1]) / np.sqrt(1.25), rtol=1e-15)
    np.testing.assert_allclose(found[3, 13], np.array([0, 0.25, 1]) / np.sqrt(1.0625), rtol=1e-15)


def test_a_sphere(x64):
    """Central differences are of second order: their error on a sphere of radius 100 pixels is about r/100³ / 6 … 2."""
    x, y = COLUMNS - 7.5, ROWS - 5.5
    z = np.sqrt(100.0**2 - x**2 - y**2)
    found = np.asarray(normals(DepthMap(z)))
    expected = np.stack([x, y, z], axis=-1) / 100
    assert np.abs(found - expected)[1:-1, 1:-1].max() <= 3.5e-6
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, rtol=1e-15)


def test_lamberts_law_by_hand(x64):
    """n · l = (−0.5 · 2 + 0.25 · (−1) + 1 · 2) / (√1.3125 · 3)."""
    shaded = shade(_plane(), light=(2.0, -1.0, 2.0), ambient=0.2, albedo=np.full((12, 16), 0.5))
    np.testing.assert_allclose(shaded, 0.5 * (0.2 + 0.8 * 0.75 / (3 * np.sqrt(1.3125))), rtol=1e-14)


def test_dark_side_and_background(x64):
    shaded = np.asarray(shade(_plane(mask=MASK), light=(1.0, 0.0, 0.1), background=0.7))
    assert np.all(shaded[2:9, 1:8][MASK[2:9, 1:8]] == 0.3)
    assert np.all(shaded[~MASK] == 0.7)


def test_derivatives(x64):
    """Forward, reverse and central differences agree; depths outside the mask have no influence, and nothing is NaN."""
    depth = np.random.default_rng(0).normal(0, 0.2, (12, 16))
    weights = np.random.default_rng(1).normal(size=(12, 16))

    def value(depth, light, albedo):
        surface = DepthMap(depth, mask=MASK, spacing=(2.0, 4.0))
        return jnp.sum(weights * shade(surface, light=light, albedo=albedo))

    arguments = (jnp.asarray(depth), jnp.asarray([0.3, -0.2, 1.0]), jnp.full((12, 16), 0.8))
    value = jax.jit(value)
    reverse = jax.jit(jax.grad(value, argnums=(0, 1, 2)))(*arguments)
    assert np.all(np.asarray(reverse[0])[~MASK] == 0)
    assert all(np.isfinite(part).all() for part in reverse)
    random = np.random.default_rng(2)
    tangents = tuple(jnp.asarray(random.normal(size=part.shape)) for part in arguments)
    expected = sum(float(jnp.sum(part * tangent)) for part, tangent in zip(reverse, tangents, strict=True))
    forward = jax.jit(lambda a, t: jax.jvp(value, a, t)[1])(arguments, tangents)
    np.testing.assert_allclose(forward, expected, rtol=1e-12)
    step = 1e-6
    ahead, behind = (
        value(*(part + sign * step * tangent for part, tangent in zip(arguments, tangents, strict=True)))
        for sign in (1, -1)
    )
    np.testing.assert_allclose((ahead - behind) / (2 * step), expected, rtol=1e-6)


def test_a_batch(x64):
    depths = np.random.default_rng(3).normal(size=(2, 12, 16))
    together = jax.vmap(lambda depth: shade(DepthMap(depth, mask=MASK)))(depths)
    np.testing.assert_allclose(together[1], shade(DepthMap(depths[1], mask=MASK)), rtol=1e-14)


def test_an_albedo_of_another_shape():
    with pytest.raises(ValueError, match=r"shape \(12, 16\) of the depth map, got \(16, 12\)"):
        shade(_plane(np.float32), albedo=np.ones((16, 12), np.float32))
