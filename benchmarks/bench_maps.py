"""Maps of the plane and their inverses, as warps of a picture."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers, truth
from benchmarks.checks import check

POSITION = "largest error of the source position inside the picture, pixels"
# float32 keeps positions near 1000 to 1e-4 pixels.
_LIMIT = 2e-3


def _source_error(coordinates: np.ndarray, expected: np.ndarray) -> float:
    inside = truth.interior(expected)
    return float(np.max(np.abs(coordinates - expected)[inside]))


@pytest.mark.row("`warp` by a `Homography`", against="`cv2.warpPerspective`, `WARP_INVERSE_MAP`", target=1.3)
def bench_homography(race):
    image = material.picture()
    frame = jl.Frame([0.0, 0.0], 1.0)
    mapping = jl.deformations.Homography(np.asarray(material.HOMOGRAPHY, np.float32))
    pixels = jnp.asarray(image)
    error = check(
        POSITION,
        lambda found: _source_error(found, truth.homography(truth.pixel_grid())),
        lambda: jl.source_coordinates(mapping, material.SIZE, material.SIZE, frame=frame),
        None,
        limit=_LIMIT,
    )
    ours = lambda: jl.warp(pixels, mapping, frame=frame)  # noqa: E731
    peer = peers.opencv_warp_perspective(image, material.HOMOGRAPHY)
    race(ours, peer, package="OpenCV", checks=[error], moved=2 * image.nbytes)


def _deformation(kind: str) -> jl.CoordinateMap:
    random = np.random.default_rng(3)
    corners = {"lower": (-1.0, -1.0), "upper": (1.0, 1.0)}
    if kind == "b-spline":
        return jl.deformations.BSplineField(0.02 * random.normal(size=(19, 19, 2)).astype(np.float32), **corners)
    still = jl.deformations.FreeForm.identity(4, 4, **corners)
    moved = still.control_points + 0.1 * random.normal(size=(5, 5, 2)).astype(np.float32)
    return jl.deformations.FreeForm(moved, **corners)


def _warp_back(race, kind: str) -> None:
    image, mapping = material.picture(), _deformation(kind)
    pixels, inverse = jnp.asarray(image), mapping.inverse()
    grid = jax.random.uniform(jax.random.key(0), (10_000, 2), minval=-0.6, maxval=0.6)
    error = check(
        "largest error of a round trip, normalized units",
        lambda found: float(np.max(np.abs(found - np.asarray(grid)))),
        lambda: mapping(inverse(grid)),
        None,
        limit=5e-6,
    )
    race(lambda: jl.warp(pixels, inverse), None, package=None, checks=[error], moved=2 * image.nbytes)


@pytest.mark.row("`warp` by the inverse of a `BSplineField`, 16×16 cells (at most 250 ms)", against="—")
def bench_inverse_b_spline(race):
    _warp_back(race, "b-spline")


@pytest.mark.row("`warp` by the inverse of a `FreeForm`, degrees 4×4 (at most 150 ms)", against="—")
def bench_inverse_free_form(race):
    _warp_back(race, "free form")


@pytest.mark.row("`warp` by a `BSplineField`, 16×16 cells", against="—")
def bench_b_spline(race):
    image, mapping = material.picture(), _deformation("b-spline")
    pixels = jnp.asarray(image)
    race(lambda: jl.warp(pixels, mapping), None, package=None, checks=[], moved=2 * image.nbytes)
