"""Surfaces: distances along a depth map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers
from benchmarks.checks import check

RELATIVE = "largest relative error, farther than five pixels from the source"
LIMIT = 5e-3
# The heat method is an approximation: its largest error is recorded, and must not be that of a wrong call.
PEER_LIMIT = 0.1
SIZE = 512


def _geodesic(race, dtype, peer, size=SIZE):
    depth, mask, source, exact = material.sphere_cap(size)
    far = mask & (exact > 5)

    def error(found: np.ndarray) -> float:
        return float(np.max(np.abs(found[far] / exact[far] - 1)))

    with jax.enable_x64(dtype == np.float64):
        surface = jl.surfaces.DepthMap(jnp.asarray(depth.astype(dtype)), mask=mask)
        start = jnp.asarray(source, dtype)
        ours = lambda: jl.surfaces.geodesic_distance(surface, source=start)  # noqa: E731
        theirs = None if peer is None else peer(depth, mask, source)
        found = check(RELATIVE, error, ours, theirs, limit=LIMIT, peer_limit=PEER_LIMIT)
        race(
            ours,
            theirs,
            package=None if peer is None else "potpourri3d",
            checks=[found],
            moved=2 * depth.astype(dtype).nbytes,
        )


# Factorizing takes the peer many seconds at 512×512.
@pytest.mark.row(
    "`geodesic_distance`, 128×128, float32",
    against="`potpourri3d` `MeshHeatMethodDistanceSolver`, built and solved",
)
def bench_geodesic_once(race):
    _geodesic(race, np.float32, peers.potpourri3d_distance, 128)


@pytest.mark.row(
    "`geodesic_distance`, 512×512, float32 (asked: at most 250 ms)",
    against="`potpourri3d` `MeshHeatMethodDistanceSolver`, solved alone",
)
def bench_geodesic(race):
    _geodesic(race, np.float32, peers.potpourri3d_solve)


@pytest.mark.row("`geodesic_distance`, 512×512, float64", against="—")
def bench_geodesic_float64(race):
    _geodesic(race, np.float64, None)


@pytest.mark.row("`radial_geodesic_distance`, 512×512, float32", against="—")
def bench_radial(race):
    depth, mask, _, _ = material.sphere_cap(SIZE)
    middle = (SIZE - 1) / 2
    rho = np.hypot(*(np.mgrid[:SIZE, :SIZE] - middle))
    radius = float(np.hypot(depth[SIZE // 2, SIZE // 2], rho[SIZE // 2, SIZE // 2]))
    surface = jl.surfaces.DepthMap(jnp.asarray(depth.astype(np.float32)), mask=mask)
    source = jnp.full(2, middle, jnp.float32)
    ours = lambda: jl.surfaces.radial_geodesic_distance(surface, source)  # noqa: E731
    exact = radius * np.arcsin(np.where(mask, rho, 0) / radius)

    def error(found: np.ndarray) -> float:
        return float(np.max(np.abs(found[mask] / exact[mask] - 1)))

    found = check("largest relative error", error, ours, None, limit=1e-4)
    race(ours, None, package=None, checks=[found], moved=2 * depth.astype(np.float32).nbytes)
