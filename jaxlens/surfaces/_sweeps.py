"""Sweeps over a grid, a whole row or column at a time: what a pixel gets from the three neighbours before it.

A pixel gets from one of four directions: 0 from the row above, 1 from the row below, 2 from the column to its left, 3
from the one to its right; of the three pixels there, from the middle one and from one beside it.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

DIRECTIONS = range(4)


def turned(direction: int, values: Array) -> Array:
    """Returns the array with the direction's lines as rows; its own inverse."""
    return values if direction < 2 else values.T


def _lines(step, start: Array, direction: int, *values: Array, backwards: bool = False):
    """Scans over the lines of a direction: those before first, or last."""
    rows = tuple(turned(direction, array) for array in values)
    result = lax.scan(step, start, rows, reverse=(direction % 2 == 1) != backwards)[1]
    return tuple(turned(direction, array) for array in result)


def unfinished(values: Array):
    limit = sum(values.shape)  # a way that turns back more often than this winds through a maze of single pixels
    return lambda state: state[-1] & (state[0] < limit)


def weighted_sum(
    values: Float[Array, "height width"],
    direction: Int[Array, "height width"],
    share: Float[Array, "height width"],
) -> Float[Array, "height width"]:
    """Returns P values: (1 − |share|) times the middle pixel, |share| times the left (share > 0) or right one.

    Zero where `direction` is −1.
    """
    total = jnp.zeros_like(values)
    for k in DIRECTIONS:
        rows, shares = turned(k, values), turned(k, share)
        padded = jnp.pad(rows, 1)
        padded = padded[:-2] if k % 2 == 0 else padded[2:]
        total = total + jnp.where(direction == k, turned(k, _mix(padded, shares)), 0)
    return total


def _mix(before: Array, share: Array) -> Array:
    left, middle, right = before[..., :-2], before[..., 1:-1], before[..., 2:]
    return jnp.maximum(share, 0) * left + jnp.maximum(-share, 0) * right + (1 - jnp.abs(share)) * middle


def solve(
    right: Float[Array, "height width"],
    direction: Int[Array, "height width"],
    share: Float[Array, "height width"],
    tolerance: float,
) -> Float[Array, "height width"]:
    """Solves `x = P x + right`, with P of `weighted_sum`, to a tolerance relative to the largest x."""

    def sweep(state):
        count, values, _ = state
        old = values
        for k in DIRECTIONS:

            def step(before, row, k=k):
                value, direction, share, right = row
                new = jnp.where(direction == k, _mix(before, share) + right, value)
                return jnp.pad(new, 1), (new,)

            nothing = jnp.zeros((values.shape[1 if k < 2 else 0] + 2,), values.dtype)
            (values,) = _lines(step, nothing, k, values, direction, share, right)
        return count + 1, values, _changed(values, old, tolerance)

    start = jnp.where(direction < 0, right, 0)
    return lax.while_loop(unfinished(right), sweep, (0, start, jnp.array(True)))[1]


def solve_transposed(
    right: Float[Array, "height width"],
    direction: Int[Array, "height width"],
    share: Float[Array, "height width"],
    tolerance: float,
) -> Float[Array, "height width"]:
    """Solves `x = Pᵀ x + right`: what each pixel is given by those that take from it."""

    def sweep(state):
        count, values, given, _ = state
        old = values
        for k in DIRECTIONS:

            def step(gift, row, k=k):
                other, direction, share = row
                new = other + gift
                taking = jnp.where(direction == k, new, 0)
                left, straight = jnp.maximum(share, 0) * taking, (1 - jnp.abs(share)) * taking
                rest = jnp.maximum(-share, 0) * taking
                passed = straight + jnp.pad(left, (0, 1))[1:] + jnp.pad(rest, (1, 0))[:-1]
                return passed, (new, gift)

            nothing = jnp.zeros((values.shape[1 if k < 2 else 0],), values.dtype)
            values, gift = _lines(step, nothing, k, values - given[k], direction, share, backwards=True)
            given = given.at[k].set(gift)
        return count + 1, values, given, _changed(values, old, tolerance)

    given = jnp.zeros((len(DIRECTIONS), *right.shape), right.dtype)
    return lax.while_loop(unfinished(right), sweep, (0, right, given, jnp.array(True)))[1]


def _changed(values: Array, old: Array, tolerance: float) -> Bool[Array, ""]:
    return jnp.max(jnp.abs(values - old)) > tolerance * jnp.max(jnp.abs(values))
