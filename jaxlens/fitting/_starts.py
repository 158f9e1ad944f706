"""Where a fit starts: a grid of lenses, and from a lens of few coefficients to one of many."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxlens.fitting._problem import Minimum, Problem, descend
from jaxlens.fitting._solver import Unknowns
from jaxlens.lenses import Lens

# Starts that are refined: of those that change the first coefficient alone, and of all.
_BEST = (2, 3)

Cost = Callable[[Unknowns, Float[Array, ""]], Float[Array, ""]]


def coefficient_places(names: tuple[str, ...]) -> list[int]:
    """Returns where a lens's coefficients stand among the fitted parameters' names."""
    others = ("gain", "offset")
    return [index for index, name in enumerate(names) if "center_" not in name and name not in others]


def grid(
    lens_of: Callable[[Float[Array, " parameters"]], Lens],
    values: Float[Array, " parameters"],
    places: list[int],
    corner: Float[Array, "2"],
    moves: Float[np.ndarray, "starts coefficients"],
    *,
    observed: bool,
) -> Float[Array, "starts parameters"]:
    """Returns starts whose coefficients move a corner outwards by set shares of its radius, to first order.

    Args:
        lens_of: The lens of the parameters.
        values: The parameters to change.
        places: Which of them to change, one for each column of `moves`.
        corner: A normalized point far out.
        moves: The shares.
        observed: Whether the lens takes its point to this corner, or this corner to its point.
    """

    def one(moves):
        point = corner / jnp.maximum(1 + jnp.sum(moves), 0.1) if observed else corner
        radius = jnp.sqrt(jnp.sum(point**2))
        outwards = jax.jacfwd(lambda values: lens_of(values).distort(point))(values).T @ point / radius
        slopes = outwards[np.asarray(places)]
        safe = jnp.abs(slopes) > 1e-6 * radius
        steps = jnp.where(safe, moves * radius / jnp.where(safe, slopes, 1), 0)
        return values.at[np.asarray(places)].add(steps)

    return jax.vmap(one)(jnp.asarray(moves, values.dtype))


class _State(eqx.Module):
    current: Minimum
    best: Minimum
    cost: Float[Array, ""]


def search(
    problem: Problem,
    alone: Float[Array, "few parameters"],
    every: Float[Array, "many parameters"],
    places: list[int],
    cost: Cost,
    options: dict[str, Any],
) -> Minimum:
    """Finds the minimum from many starts, without derivatives.

    The best starts are refined in their first coefficient and then in the first two; the best answer then gains one
    coefficient after the other, and all that is left at last. So a lens ends no worse than the one it contains.

    Args:
        problem: The problem.
        alone: Starts in which the first coefficient alone differs.
        every: More of them.
        places: Where the coefficients stand among the parameters.
        cost: What to compare by, from parameters and loss scale; infinite where the data cannot be.
        options: As of `descend`.
    """
    count = every.shape[1]
    infinite = jnp.full(count, jnp.inf, every.dtype)
    low, high = (-infinite, infinite) if options["bounds"] is None else options["bounds"]
    starts = []
    for group, best in zip((alone, every), _BEST, strict=True):
        group = jnp.clip(group, low[None], high[None])
        costs = lax.map(lambda values: cost(Unknowns.dense(values), jnp.asarray(jnp.inf, values.dtype)), group)
        starts.append(group[jnp.argsort(costs)[:best]])
    candidates = jnp.concatenate(starts)
    tasks = _tasks(candidates.shape[0], places, count)

    def one(state: _State, task: tuple[Int[Array, ""], Bool[Array, ""], Bool[Array, " parameters"], Bool[Array, ""]]):
        candidate, ends, free, last = task
        values = jnp.where(candidate >= 0, candidates[candidate], state.current.unknowns.shared)
        held: dict[str, Any] = {**options, "bounds": (jnp.where(free, low, values), jnp.where(free, high, values))}
        found = descend(problem, Unknowns.dense(values), **held)
        steps = found.steps + state.current.steps
        now = cost(found.unknowns, found.loss_scale)
        better = ends & ~(now >= state.cost)
        best = _where(better, found, state.best)
        # When the last candidate is done, the best goes on.
        current = eqx.tree_at(lambda minimum: minimum.steps, _where(last, best, found), steps)
        return _State(current, best, jnp.where(better, now, state.cost)), None

    nothing = Minimum(Unknowns.dense(candidates[0]), jnp.zeros_like(low[0]), jnp.asarray(1), jnp.asarray(0))
    first = _State(nothing, nothing, jnp.asarray(jnp.inf, low.dtype))
    return lax.scan(one, first, tasks)[0].current


def _tasks(candidates: int, places: list[int], count: int) -> tuple[Array, Array, Array, Array]:
    """Returns the solver's tasks: which candidate each starts from (−1: where it is), if it ends one, what is free."""
    stages = [places[:end] for end in range(1, len(places) + 1)]
    tasks = []
    for candidate in range(candidates):
        for index, stage in enumerate(stages[:2]):
            ends = index == len(stages[:2]) - 1
            tasks.append((-1 if index else candidate, ends, stage, ends and candidate == candidates - 1))
    further = [*stages[2:], list(range(count))]
    tasks += [(-1, False, stage, False) for stage in further if len(stage) > len(stages[:2][-1])]
    free = np.zeros((len(tasks), count), bool)
    for row, (_, _, stage, _) in zip(free, tasks, strict=True):
        row[stage] = True
    origin, ends, _, last = zip(*tasks, strict=True)
    return jnp.asarray(origin), jnp.asarray(ends), jnp.asarray(free), jnp.asarray(last)


def _where(condition: Array, yes: Minimum, no: Minimum) -> Minimum:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
