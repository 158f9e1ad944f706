"""What a map does to a picture: where it folds, what it covers, what it repeats; and how two cameras differ."""

from functools import partial
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxlens.frames import Frame
from jaxlens.maps import CoordinateMap
from jaxlens.newton import solve_small
from jaxlens.numerics import join, masked, split
from jaxlens.warping import frame_for, pixel_grid, source_coordinates

if TYPE_CHECKING:
    from jaxlens.cameras import Camera

# Halvings of the zoom: enough for single precision.
_BISECTIONS = 30
# Gauss–Newton's steps to the best rotation; each squares what is left.
_TURNS = 8


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


class Difference(eqx.Module):
    """How two cameras differ over the picture of the first.

    Attributes:
        pixels: `(rows, columns, 2)` pixels of the first camera, (x, y) order.
        offsets: `(rows, columns, 2)` from each to where the second, turned by `rotation`, sees the same ray, in pixels;
            NaN where one of the two does not see it.
        rotation: `(3, 3)` from the first camera's directions to the second's: the one that makes the mean square of the
            offsets least, or the identity.
    """

    pixels: Float[Array, "rows columns 2"]
    offsets: Float[Array, "rows columns 2"]
    rotation: Float[Array, "3 3"]

    @property
    def distances(self) -> Float[Array, "rows columns"]:
        """The lengths of the offsets, in pixels; NaN where there is none."""
        return jnp.hypot(*split(self.offsets))

    @property
    def rms(self) -> Float[Array, ""]:
        """The root of the mean squared distance, where there is one."""
        return jnp.sqrt(jnp.nanmean(self.distances**2))


@partial(jax.jit, static_argnames=("shape", "rotate"))
def difference(
    first: "Camera", second: "Camera", *, shape: tuple[int, int] = (31, 41), rotate: bool = True
) -> Difference:
    """Measures how two cameras differ over the picture of the first.

    Two calibrations of one camera may call another direction its axis: boards that are turned along take no notice. So
    the second is turned first to where the two agree best, as mrcal's `show-projection-diff` does with its
    intrinsics alone. Pictures of another size are measured in the first camera's pixels by `camera.resized`.

    Args:
        first: A camera.
        second: Another.
        shape: Rows and columns of the grid of pixels, from edge to edge of the picture.
        rotate: Whether the second is turned.

    Returns:
        A `Difference`.
    """
    rows, columns = (
        jnp.linspace(-0.5, size - 0.5, n) for size, n in zip((first.height, first.width), shape, strict=True)
    )
    pixels = join(*jnp.meshgrid(columns, rows)).astype(first.frame.scale.dtype)
    rays = first.unproject(pixels)
    some = jnp.isfinite(rays).all(-1)
    rays = jnp.where(some[..., None], rays, jnp.asarray([0, 0, 1], rays.dtype))

    def offsets(rotation: Array) -> Array:
        found = second.project(jnp.einsum("ij,...j->...i", rotation, rays)) - pixels
        return masked(found, some)

    def residuals(turn: Array, rotation: Array) -> Array:
        left = offsets(_turned(turn) @ rotation)
        return jnp.where(jnp.isfinite(left), left, 0).ravel()

    def step(_, rotation: Array) -> Array:
        still = jnp.zeros(3, rays.dtype)
        value, jacobian = residuals(still, rotation), jax.jacfwd(residuals)(still, rotation)
        return _turned(-solve_small(jacobian.T @ jacobian, jacobian.T @ value)) @ rotation

    rotation = jnp.eye(3, dtype=rays.dtype)
    if rotate:
        rotation = lax.fori_loop(0, _TURNS, step, rotation)
    return Difference(pixels, offsets(rotation), rotation)


def _turned(turn: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Returns the rotation about an axis by its length, in radians."""
    import jaxlie

    return jaxlie.SO3.exp(turn).as_matrix()
