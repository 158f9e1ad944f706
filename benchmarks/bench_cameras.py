"""Fisheyes beside OpenCV's: a picture made perspective, and exact inverses of points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers, truth
from benchmarks.checks import check

POSITION = "largest error of the source position inside the picture, pixels"


@pytest.mark.row(
    "`reproject` of a `KannalaBrandt` camera to perspective",
    against="`cv2.fisheye.initUndistortRectifyMap` + `cv2.remap`",
    target=0.8,
)
def bench_reproject_fisheye(race):
    image = material.picture()
    size = material.SIZE
    source = jl.Camera(jl.KannalaBrandt(np.asarray(material.FISHEYE, np.float32)), material.frame(), size, size)
    target = jl.Camera(jl.Perspective(), material.frame(), size, size)
    pixels = jnp.asarray(image)
    expected = truth.fisheye(truth.pixel_grid())
    inside = truth.interior(expected)
    error = check(
        POSITION,
        lambda found: float(np.max(np.abs(found - expected)[inside])),
        lambda: target.transfer(jnp.asarray(truth.pixel_grid(), jnp.float32), source),
        None,
        limit=1e-3,
    )
    race(
        lambda: jl.reproject(pixels, source, target),
        peers.opencv_fisheye(image),
        package="OpenCV",
        checks=[error],
        moved=2 * image.nbytes,
    )


@pytest.mark.row(
    "`KannalaBrandt.unproject`, 10⁶ points, float64", against="`cv2.fisheye.undistortPoints`, inexact", target=0.5
)
def bench_unproject_fisheye(race):
    angles, turns = np.random.default_rng(5).uniform([0, 0], [1.2, 2 * np.pi], (material.POINTS, 2)).T
    rays = np.stack([np.sin(angles) * np.cos(turns), np.sin(angles) * np.sin(turns), np.cos(angles)], -1)
    with jax.enable_x64(True):
        lens = jl.KannalaBrandt(material.FISHEYE)
        points = lens.project(rays)
        ours = lambda: lens.unproject(points)  # noqa: E731
        error = check(
            "largest error of a unit ray", lambda found: float(np.max(np.abs(found - rays))), ours, None, limit=1e-12
        )
        peer = peers.opencv_fisheye_points(np.asarray(points))
        race(ours, peer, package="OpenCV", checks=[error], moved=40 * material.POINTS)
