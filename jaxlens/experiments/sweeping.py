"""An image through many lenses: one compiled program, run in steps whose memory does not grow with the grid."""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Num

from jaxlens import metrics
from jaxlens.diagnostics import coverage
from jaxlens.experiments.readings import Reading, source_map
from jaxlens.experiments.schema import Warp
from jaxlens.sampling import remap
from jaxlens.warping import source_coordinates

# Planes of the image's size that one lens takes for coordinates, solver, samples and metrics; 15 were measured.
_PLANES_PER_LENS = 20
# More lanes gain nothing on a CPU, and past four XLA sums in another order.
_MOST_LANES = 4
# Lenses between two steps of the progress bar, unless told otherwise.
_CHUNK = 16

Advance = Callable[[int], None]


def estimated_bytes(pixels: Float[np.ndarray, "height width *channels"]) -> int:
    """Returns what one lens takes, in bytes."""
    return _PLANES_PER_LENS * pixels.nbytes


def lanes_within(memory_mb: float, pixels: Float[np.ndarray, "height width *channels"]) -> int:
    """Returns how many lenses are computed side by side within a budget; never less than one."""
    return int(np.clip(memory_mb * 1e6 // estimated_bytes(pixels), 1, _MOST_LANES))


def sweep(
    pixels: Float[np.ndarray, "height width *channels"],
    kappa: Float[np.ndarray, "lenses order"],
    *,
    peak: float,
    warp: Warp,
    reading: Reading = "functional inverse",
    memory_mb: float = 256.0,
    chunk: int | None = None,
    advance: Advance = lambda lenses: None,
) -> dict[str, Num[np.ndarray, " lenses"]]:
    """Computes every metric for every lens.

    The grid is one jitted `vmap` over as many lenses as the memory allows, mapped over the chunk one after another:
    the program for a lens is the same however the grid is cut, and so is its result, to the last bit.

    Args:
        pixels: The undistorted image; its dtype is that of the computation.
        kappa: The lenses' coefficients.
        peak: L of the PSNR.
        warp: How the image is sampled.
        reading: Of Eq. 11.
        memory_mb: Budget for the lenses computed side by side.
        chunk: Lenses per call of the program; rounded up to whole lanes.
        advance: Told after each call how many lenses are done.

    Returns:
        One column a metric, and `coverage`: the share of output pixels whose source lies in the image.
    """
    count, order = kappa.shape
    lanes = min(lanes_within(memory_mb, pixels), count)
    groups = -(-min(_CHUNK if chunk is None else chunk, count) // lanes)
    step = lanes * groups
    # The last step is filled up with its own last lens: the program is compiled for one shape.
    padded = np.pad(kappa, ((0, -count % step), (0, 0)), mode="edge").astype(pixels.dtype)
    image, columns = jnp.asarray(pixels), []
    for start in range(0, count, step):
        lenses = jnp.asarray(padded[start : start + step]).reshape(groups, lanes, order)
        scores = _sweep_chunk(image, lenses, jnp.asarray(peak, pixels.dtype), reading=reading, warp=warp)
        columns.append({name: np.asarray(column).ravel() for name, column in scores.items()})
        advance(min(step, count - start))
    return {name: np.concatenate([part[name] for part in columns])[:count] for name in columns[0]}


@partial(jax.jit, static_argnames=("reading", "warp"))
def _sweep_chunk(
    image: Array, lenses: Float[Array, "groups lanes order"], peak: Float[Array, ""], *, reading: Reading, warp: Warp
) -> "OrderedDict[str, Array]":
    def score(kappa: Array) -> "OrderedDict[str, Array]":
        picture = deform(image, kappa, warp=warp, reading=reading)
        # An OrderedDict, which keeps its order through JAX.
        scores = OrderedDict(metrics.evaluate(image, picture, data_range=peak))
        covered = coverage(source_map(kappa, reading), *image.shape[:2])
        scores["coverage"] = jnp.mean(covered.astype(image.dtype))
        return scores

    return lax.map(jax.vmap(score), lenses)


@partial(jax.jit, static_argnames=("reading", "warp"))
def deform(
    image: Float[Array, "height width *channels"],
    kappa: Float[Array, " order"],
    *,
    warp: Warp,
    reading: Reading = "functional inverse",
) -> Float[Array, "height width *channels"]:
    """Returns the image that Eq. 11, under one of its readings, makes of an image."""
    coordinates = source_coordinates(source_map(kappa, reading), *image.shape[:2])
    return remap(
        image, coordinates, method=warp.method, border=warp.border, fill=warp.fill, antialias=warp.antialias
    )


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
