"""An image through many lenses: one compiled program, run in steps whose memory does not grow with the grid."""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Num

from jaxlens import metrics
from jaxlens.experiments.paper import Reading
from jaxlens.experiments.readings import source_map
from jaxlens.experiments.schema import Warp
from jaxlens.sampling import remap
from jaxlens.warping import source_coordinates

# Planes of the image's size that one lens takes for coordinates, solver, samples and metrics; 15 were measured.
_PLANES_PER_LENS = 20
# More gain nothing on a CPU.
_MOST_LANES = 4
CHUNK = 16
"""Lenses between two steps of the progress bar."""

Advance = Callable[[int], None]


def estimated_bytes(pixels: Float[np.ndarray, "height width *channels"]) -> int:
    """Returns what one lens takes, in bytes."""
    return _PLANES_PER_LENS * pixels.nbytes


def lanes_within(memory_mb: float, pixels: Float[np.ndarray, "height width *channels"]) -> int:
    """Returns how many lenses are computed side by side within a budget: 1, 2 or 4."""
    fitting = memory_mb * 1e6 / estimated_bytes(pixels)
    return max(lanes for lanes in (1, 2, _MOST_LANES) if lanes == 1 or lanes <= fitting)


def score_lenses(
    pixels: Float[np.ndarray, "height width *channels"],
    kappa: Float[np.ndarray, "lenses order"],
    *,
    peak: float,
    warp: Warp,
    reading: Reading = "functional inverse",
    memory_mb: float = 256.0,
    chunk: int = CHUNK,
    advance: Advance = lambda lenses: None,
) -> dict[str, Num[np.ndarray, " lenses"]]:
    """Computes every metric for every lens.

    The grid is swept by one compiled program: a `vmap` over as many lenses as the memory allows, looped over a chunk.
    How many rounds the loop makes is an argument of the program, so that it is the same program, with the same results
    to the last bit, however the grid is cut into chunks.

    Args:
        pixels: The undistorted image; its dtype is that of the computation.
        kappa: The lenses' coefficients.
        peak: L of the PSNR.
        warp: How the image is sampled.
        reading: Of Eq. 11.
        memory_mb: Budget for the lenses computed side by side.
        chunk: Lenses per call of the program, at most `CHUNK`; rounded up to whole lanes.
        advance: Told after each call how many lenses are done.

    Returns:
        One column a metric, and `coverage`: the share of output pixels whose source lies on a pixel of the image.
    """
    count, order = kappa.shape
    lanes = lanes_within(memory_mb, pixels)
    step = -(-min(chunk, CHUNK) // lanes) * lanes
    image, columns = jnp.asarray(pixels), []
    for start in range(0, count, step):
        now = kappa[start : start + step]
        # Filled up with its last lens, for the program has one shape.
        padded = np.pad(now, ((0, CHUNK - len(now)), (0, 0)), mode="edge").astype(pixels.dtype)
        lenses = jnp.asarray(padded.reshape(CHUNK // lanes, lanes, order))
        rounds = jnp.asarray(-(-len(now) // lanes), jnp.int32)
        scores = _score_chunk(image, lenses, rounds, jnp.asarray(peak, pixels.dtype), reading=reading, warp=warp)
        columns.append({name: np.asarray(column).ravel()[: len(now)] for name, column in scores.items()})
        advance(len(now))
    return {name: np.concatenate([part[name] for part in columns]) for name in columns[0]}


@partial(jax.jit, static_argnames=("reading", "warp"))
def _score_chunk(
    image: Array,
    lenses: Float[Array, "groups lanes order"],
    rounds: Int[Array, ""],
    peak: Float[Array, ""],
    *,
    reading: Reading,
    warp: Warp,
) -> "OrderedDict[str, Array]":
    """Scores the first `rounds` groups of lenses; the rest of each column stays NaN."""

    def score(kappa: Array) -> "OrderedDict[str, Array]":
        coordinates = source_coordinates(source_map(kappa, reading), *image.shape[:2])
        picture = _deformed(image, coordinates, kappa, warp)
        # An OrderedDict, which keeps its order through JAX.
        scores = OrderedDict(metrics.evaluate(image, picture, data_range=peak))
        scores["coverage"] = _share_inside(coordinates, *image.shape[:2])
        return scores

    def fill_in(index: Array, columns: "OrderedDict[str, Array]") -> "OrderedDict[str, Array]":
        scores = jax.vmap(score)(lenses[index])
        return OrderedDict((name, columns[name].at[index].set(value)) for name, value in scores.items())

    empty = jnp.full(lenses.shape[:2], jnp.nan, image.dtype)
    columns = OrderedDict((name, empty) for name in jax.eval_shape(score, lenses[0, 0]))
    return lax.fori_loop(0, rounds, fill_in, columns)


@partial(jax.jit, static_argnames=("reading", "warp"))
def deform(
    image: Float[Array, "height width *channels"],
    kappa: Float[Array, " order"],
    *,
    warp: Warp,
    reading: Reading = "functional inverse",
) -> Float[Array, "height width *channels"]:
    """Returns the image that Eq. 11, under one of its readings, makes of an image."""
    return _deformed(image, source_coordinates(source_map(kappa, reading), *image.shape[:2]), kappa, warp)


def deform_all(
    pixels: Float[np.ndarray, "height width *channels"],
    kappa: Float[np.ndarray, "lenses order"],
    warp: Warp,
    reading: Reading = "functional inverse",
) -> list[Float[np.ndarray, "height width *channels"]]:
    """Returns the deformed images of a few lenses."""
    image = jnp.asarray(pixels)
    lenses = [jnp.asarray(one, pixels.dtype) for one in kappa]
    return [np.asarray(deform(image, one, warp=warp, reading=reading)) for one in lenses]


def _deformed(image: Array, coordinates: Array, kappa: Array, warp: Warp) -> Array:
    options = {"method": warp.method, "border": warp.border, "fill": warp.fill, "antialias": warp.antialias}
    # Without a lens the picture is the image itself, and its PSNR infinite; rounded coordinates would make it 300 dB.
    return jnp.where(jnp.any(kappa != 0), remap(image, coordinates, **options), image)


def _share_inside(coordinates: Array, height: int, width: int) -> Array:
    x, y = coordinates[..., 0], coordinates[..., 1]
    inside = (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
    return jnp.mean(inside.astype(coordinates.dtype))
