"""Upright boxes through a map: the bound of the bent outline."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxlens.numerics import join, split

# Places that each look along the outline compares, and looks: at the third, places are 1e-5 of an edge apart, and at an
# extreme, where the coordinate is level, the bound is off by the square of that.
_PLACES = 129
_LOOKS = 3
# The outline is as long as it has edges.
_LENGTH = 4

Boxes = Float[Array, "boxes 4"]
Places = Float[Array, "boxes 4 places"]
PointMap = Callable[[Float[Array, "*batch 2"]], Float[Array, "*batch 2"]]


def bound_boxes(transfer: PointMap, boxes: Boxes) -> Boxes:
    """Returns the bounds of what a map makes of the outlines of boxes, as far as it is seen.

    Args:
        transfer: The map, NaN where nothing is seen.
        boxes: x0, y0, x1, y1 of each.

    Returns:
        The same of the images, NaN where nothing of an outline is seen. Each bound is looked for along the whole
        outline, then between the neighbours of the best place. Derivatives are those of the places found, which at an
        extreme are those of the extreme.
    """

    def bounds(places: Places) -> Places:
        x, y = split(transfer(_on_outline(boxes, places)))
        return jnp.stack([x[:, 0], y[:, 1], x[:, 2], y[:, 3]], axis=1)

    steps = jnp.linspace(-1, 1, _PLACES, dtype=boxes.dtype)
    outwards = jnp.asarray([-1, -1, 1, 1], boxes.dtype)[None, :, None]

    def look(_, found):
        middle, half = found
        places = middle + half * steps[None, None]
        reach = outwards * bounds(places)
        best = jnp.argmax(jnp.where(reach == reach, reach, -jnp.inf), axis=-1, keepdims=True)
        return jnp.take_along_axis(places, best, axis=-1), half * (2 / (_PLACES - 1))

    start = jnp.full((boxes.shape[0], 4, 1), _LENGTH / 2, boxes.dtype), jnp.asarray(_LENGTH / 2, boxes.dtype)
    middle, _ = lax.stop_gradient(lax.fori_loop(0, _LOOKS, look, start))
    return bounds(middle)[..., 0]


def _on_outline(boxes: Boxes, places: Places) -> Float[Array, "boxes 4 places 2"]:
    """Returns the points of outlines, from the first corner along the top and around, one unit of place an edge."""
    places = jnp.mod(places, _LENGTH)
    left, top, right, bottom = (boxes[:, i, None, None] for i in range(4))
    across = jnp.clip(places, 0, 1) - jnp.clip(places - 2, 0, 1)
    down = jnp.clip(places - 1, 0, 1) - jnp.clip(places - 3, 0, 1)
    return join(left + across * (right - left), top + down * (bottom - top))
