"""Comparing two images in every square window inside them, from local means, variances and covariance."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jaxtyping import Array, Bool, Float

Kernel: TypeAlias = tuple[float, ...]
Planes: TypeAlias = tuple[Array, ...]


class LocalStatistics(NamedTuple):
    """Weighted statistics of two images x and y, one for each window.

    Windows are named by their first pixel, so the rows and columns are (H − n + 1, W − n + 1) for side n.
    Variances are the population's: weighted means of squared deviations, exactly 0 in a flat window.
    """

    mean_x: Float[Array, "rows columns"]
    mean_y: Float[Array, "rows columns"]
    variance_x: Float[Array, "rows columns"]
    variance_y: Float[Array, "rows columns"]
    covariance: Float[Array, "rows columns"]


Comparison: TypeAlias = Callable[..., Planes]


def uniform_kernel(size: int) -> Kernel:
    """Returns equal weights along one side of a window; they sum to 1."""
    return (1.0 / size,) * size


def gaussian_kernel(size: int, sigma: float) -> Kernel:
    """Returns Gaussian weights along one side of a window of `size` pixels, centred; they sum to 1."""
    offsets = np.arange(size) - (size - 1) / 2
    weights = np.exp(-0.5 * (offsets / sigma) ** 2)
    return tuple(float(weight) for weight in weights / weights.sum())


def compare_windows(
    comparison: Comparison,
    x: Float[Array, "height width *channels"],
    y: Float[Array, "height width *channels"],
    kernel: Kernel,
    *parameters: Float[Array, ""],
) -> tuple[Float[Array, "rows columns *channels"], ...]:
    """Compares two images in all windows that lie wholly inside them, each channel on its own.

    The window's weight at (row i, column j) is `kernel[i] * kernel[j]`.

    The variances do not suffer from cancellation: each row is measured from the pixel in its middle, and each
    window from its middle row, so a small texture on a large offset keeps its digits in float32.

    Args:
        comparison: a function at module level, `comparison(statistics, *parameters)`, of `LocalStatistics`
            and scalars; it returns planes, element by element, and is written with operators and `lax`.
        x: the first image.
        y: the second image.
        kernel: the weights along one side, with a sum of 1.
        *parameters: scalars handed on to the comparison.

    Returns:
        The comparison's planes, one value a window. Differentiable in x, y and the parameters, forward and in
        reverse.
    """
    channels = x.shape[2:]
    # Channels stay interleaved: the next pixel of a row lies `step` samples on.
    step = int(np.prod(channels, dtype=int))
    planes = _compare(comparison, kernel, step, x.reshape(x.shape[0], -1), y.reshape(y.shape[0], -1), *parameters)
    return tuple(plane.reshape(plane.shape[0], -1, *channels) for plane in planes)


def whole_windows(mask: Bool[Array, "height width"], size: int) -> Bool[Array, "rows columns"]:
    """Returns true for every window, of side `size`, whose pixels are all true in the mask."""
    along_row = lax.reduce_window(mask, True, lax.bitwise_and, (1, size), (1, 1), "VALID")
    return lax.reduce_window(along_row, True, lax.bitwise_and, (size, 1), (1, 1), "VALID")


def compiled_apart(function: Callable[..., Planes], *operands: Array) -> Planes:
    """Calls a function of arrays, and keeps XLA on the CPU from fusing it with what follows.

    There, XLA would fold the first pass of a separable filter into each tap of the second, and the whole into
    a final sum: ten times slower, and sixty in the gradient. An `optimization_barrier` does not help, as it
    is removed before fusion. The result is the same either way.

    Write the function with operators and `lax`: what `jnp` compiles inside it would be kept apart as well.
    """

    def apart(*operands: Array) -> Planes:
        with set_xla_metadata(inlineable="false"):
            return jax.jit(function)(*operands)

    return lax.platform_dependent(*operands, cpu=apart, default=function)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _compare(comparison: Comparison, kernel: Kernel, step: int, x: Array, y: Array, *parameters: Array) -> Planes:
    # The second pass and the comparison are one loop, so that the statistics never go through memory.
    def finish(*operands: Array) -> Planes:
        return comparison(_down_columns(*operands[:5], kernel=kernel), *operands[5:])

    rows = compiled_apart(partial(_along_rows, kernel=kernel, step=step), x, y)
    return compiled_apart(finish, *rows, *parameters)


@_compare.defjvp
def _compare_jvp(
    comparison: Comparison, kernel: Kernel, step: int, primals: Planes, tangents: Planes
) -> tuple[Planes, Planes]:
    # The derivative is written from the definitions, because that of the two passes would keep some sixty
    # planes in memory. A constant drops out of it; with each image's mean off, little is left to cancel.
    (x, y, *parameters), (dx, dy, *dparameters) = primals, tangents
    rows = compiled_apart(partial(_along_rows, kernel=kernel, step=step), x, y)
    values = LocalStatistics(*compiled_apart(partial(_down_columns, kernel=kernel), *rows))
    offset_x, offset_y = lax.stop_gradient((jnp.mean(x), jnp.mean(y)))
    x, y = x - offset_x, y - offset_y
    mean_x, mean_y = values.mean_x - offset_x, values.mean_y - offset_y
    dmean_x, dmean_y, dxx, dyy, dxy = _filter((dx, dy, x * dx, y * dy, x * dy + y * dx), kernel, step)
    changes = LocalStatistics(
        dmean_x,
        dmean_y,
        2 * (dxx - mean_x * dmean_x),
        2 * (dyy - mean_y * dmean_y),
        dxy - mean_x * dmean_y - mean_y * dmean_x,
    )
    return jax.jvp(comparison, (values, *parameters), (changes, *dparameters))


def _filter(planes: Planes, kernel: Kernel, step: int) -> Planes:
    """Returns weighted means of each plane over the windows."""

    def along_rows(*planes: Array) -> Planes:
        return tuple(_weigh(_taps(plane, len(kernel), 1, step), kernel) for plane in planes)

    def down_columns(*planes: Array) -> Planes:
        return tuple(_weigh(_taps(plane, len(kernel), 0, 1), kernel) for plane in planes)

    return compiled_apart(down_columns, *compiled_apart(along_rows, *planes))


def _along_rows(x: Array, y: Array, *, kernel: Kernel, step: int) -> Planes:
    """Statistics of the pieces of rows that windows are made of."""
    size = len(kernel)
    return tuple(_spread(_taps(x, size, 1, step), _taps(y, size, 1, step), kernel))


def _down_columns(
    mean_x: Array, mean_y: Array, variance_x: Array, variance_y: Array, covariance: Array, *, kernel: Kernel
) -> LocalStatistics:
    """Statistics of windows from those of their rows: the spread within the rows plus that of their means."""
    size = len(kernel)
    between = _spread(_taps(mean_x, size, 0, 1), _taps(mean_y, size, 0, 1), kernel)
    return LocalStatistics(
        between.mean_x,
        between.mean_y,
        between.variance_x + _weigh(_taps(variance_x, size, 0, 1), kernel),
        between.variance_y + _weigh(_taps(variance_y, size, 0, 1), kernel),
        between.covariance + _weigh(_taps(covariance, size, 0, 1), kernel),
    )


def _spread(xs: Sequence[Array], ys: Sequence[Array], kernel: Kernel) -> LocalStatistics:
    """Means, variances and covariance over the taps, measured from the middle tap."""
    middle = len(kernel) // 2
    us, vs = [x - xs[middle] for x in xs], [y - ys[middle] for y in ys]
    u, v = _weigh(us, kernel), _weigh(vs, kernel)
    return LocalStatistics(
        xs[middle] + u,
        ys[middle] + v,
        _weigh([a * a for a in us], kernel) - u * u,
        _weigh([b * b for b in vs], kernel) - v * v,
        _weigh([a * b for a, b in zip(us, vs, strict=True)], kernel) - u * v,
    )


def _taps(plane: Array, size: int, axis: int, step: int) -> list[Array]:
    length = plane.shape[axis] - (size - 1) * step
    return [lax.slice_in_dim(plane, k * step, k * step + length, axis=axis) for k in range(size)]


def _weigh(taps: Sequence[Array], kernel: Kernel) -> Array:
    total = taps[0] * kernel[0]
    for tap, weight in zip(taps[1:], kernel[1:], strict=True):
        total = total + tap * weight
    return total
