"""What a map does to a picture: where it folds, what it covers, what it repeats, and how to crop the rest."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxlens.frames import Frame
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import split
from jaxlens.warping import frame_for, pixel_grid, source_coordinates

# Halvings of the zoom: enough for single precision.
_BISECTIONS = 30


@partial(jax.jit, static_argnames=("height", "width"))
def jacobian_determinant(
    mapping: CoordinateMap, height: int, width: int, *, frame: Frame | None = None
) -> Float[Array, "height width"]:
    """Returns the local change of area at every pixel of a grid: below one the map shrinks, below zero it has folded.

    Args:
        mapping: Any map, or lens (its `distort`).
        height: Height of the picture, in pixels.
        width: Width of the picture, in pixels.
        frame: Ties pixels to normalized coordinates; Eq. 10's by default.
    """
    frame = frame_for(mapping, height, width) if frame is None else frame
    return mapping.jacobian_determinant(frame.normalize(pixel_grid(height, width, frame.scale.dtype)))


@partial(jax.jit, static_argnames=("height", "width", "shape"))
def coverage(
    mapping: CoordinateMap,
    height: int,
    width: int,
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    shape: tuple[int, int] | None = None,
) -> Bool[Array, "new_height new_width"]:
    """Returns which output pixels of `warp(image, mapping)` have their source inside the picture.

    For `distort_image` the map is `lens.inverse()`. A source is inside if it lies on the area between the centres of
    the outermost pixels, so that nothing of it is interpolated with the fill value.

    Args:
        mapping: From output to source.
        height: Height of the picture, in pixels.
        width: Width of the picture, in pixels.
        frame: Ties pixels to normalized coordinates; Eq. 10's by default.
        output_frame: As in `warp`.
        shape: As in `warp`.
    """
    sources = source_coordinates(mapping, height, width, frame=frame, output_frame=output_frame, shape=shape)
    return _inside(sources, height, width)


def _inside(coordinates: Float[Array, "*batch 2"], height: int, width: int) -> Bool[Array, "*batch"]:
    x, y = split(coordinates)
    # A source that is the edge but for rounding (the identity map, say) is inside.
    slack = 64 * jnp.finfo(x.dtype).eps * max(height, width)
    return (x >= -slack) & (x <= width - 1 + slack) & (y >= -slack) & (y <= height - 1 + slack)


@partial(jax.jit, static_argnames=("height", "width"))
def multiplicity(coordinates: Float[Array, "*points 2"], height: int, width: int) -> Int[Array, "height width"]:
    """Counts how many output pixels draw from each source pixel: zero is lost, above one is repeated.

    An output pixel draws from the source pixel nearest to its coordinates (the paper: "some pixels are moved to
    multiple positions").

    Args:
        coordinates: Source positions in pixels, as of `distortion_map`; those outside the picture, or not finite,
            count for none.
        height: Height of the source, in pixels.
        width: Width of the source, in pixels.
    """
    x, y = split(coordinates)
    column, row = jnp.floor(x + 0.5), jnp.floor(y + 0.5)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    index = jnp.where(inside, row, 0).astype(jnp.int32) * width + jnp.where(inside, column, 0).astype(jnp.int32)
    counts = jnp.zeros(height * width, jnp.int32).at[index.ravel()].add(inside.ravel().astype(jnp.int32))
    return counts.reshape(height, width)


@jax.jit
def largest_rectangle(
    mask: Bool[Array, "height width"],
) -> tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """Finds the largest axis-parallel rectangle on which a mask is true throughout.

    Args:
        mask: `(H, W)`, such as `coverage`.

    Returns:
        `top, left, height, width` in pixels; all zero where the mask is nowhere true. Of equal areas the first found,
        from the top, is taken.
    """
    height, width = mask.shape
    columns = jnp.arange(width)

    def add_row(carry, row):
        # For each column: the run of true pixels that ends in this row, and how far it extends at that height.
        tall, left, right, best = carry
        index, here = row
        first = 1 + lax.cummax(jnp.where(here, -1, columns))
        beyond = lax.cummin(jnp.where(here, width, columns), reverse=True)
        tall = jnp.where(here, tall + 1, 0)
        left = jnp.where(here, jnp.maximum(left, first), 0)
        right = jnp.where(here, jnp.minimum(right, beyond), width)
        area = tall * (right - left)
        widest = jnp.argmax(area)
        found = jnp.stack([index + 1 - tall[widest], left[widest], tall[widest], right[widest] - left[widest]])
        best = jnp.where(area[widest] > best[2] * best[3], found, best)
        return (tall, left, right, best), None

    zeros = jnp.zeros(width, columns.dtype)
    start = (zeros, zeros, jnp.full(width, width, columns.dtype), jnp.zeros(4, columns.dtype))
    rows = (jnp.arange(height), mask)
    top, left, tall, wide = lax.scan(add_row, start, rows)[0][3]
    return top, left, tall, wide


@partial(jax.jit, static_argnames=("height", "width"))
def zoom_to_fill(mapping: CoordinateMap, height: int, width: int, *, frame: Frame | None = None) -> Float[Array, ""]:
    """Finds the least zoom at which a warped picture has no black border.

    Use as `warp(image, mapping, output_frame=frame.zoomed(zoom))`. The search looks at the output's border alone, so it
    is for maps that keep the picture's interior inside: lenses and other deformations about the frame's centre.

    Args:
        mapping: From output to source; for `distort_image`, `lens.inverse()`.
        height: Height of the picture, in pixels.
        width: Width of the picture, in pixels.
        frame: Ties pixels to normalized coordinates; Eq. 10's by default.

    Returns:
        The factor, below one where the picture can be shrunk and still fill the frame; between 1/1024 and 1024, and NaN
        where even the greatest zoom leaves a border. Without derivatives.
    """
    frame = frame_for(mapping, height, width) if frame is None else frame
    grid = pixel_grid(height, width, frame.scale.dtype)
    border = jnp.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])

    def fills(log_zoom):
        output_frame = frame.zoomed(jnp.exp2(log_zoom))
        return jnp.all(_inside(frame.denormalize(mapping(output_frame.normalize(border))), height, width))

    def halve(_, bounds):
        low, high = bounds
        middle = 0.5 * (low + high)
        enough = fills(middle)
        return jnp.where(enough, low, middle), jnp.where(enough, middle, high)

    limit = jnp.asarray(10, frame.scale.dtype)
    _, high = lax.fori_loop(0, _BISECTIONS, halve, (-limit, limit))
    return jnp.where(fills(limit), jnp.exp2(high), jnp.nan)
