"""How a batch of large problems is solved: one after another, so that each finds its temporary memory in the cache."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

# Elements from which the members of a batch take turns.
_LARGE = 1 << 15


def in_turns(function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function whose `jax.vmap` runs large problems in turns, and small ones together.

    In turns, too, each problem takes only its own branch of a `cond`, and its own number of steps.

    Args:
        function: Without derivatives; its second argument is an array as large as the problem.
    """
    batched = custom_vmap(function)

    @batched.def_vmap
    def batch(size, is_batched, *arguments):
        elements = arguments[1].size // (size if is_batched[1] else 1)
        if elements < _LARGE:
            axes = jax.tree.map(lambda batched: 0 if batched else None, is_batched)
            results = jax.vmap(function, in_axes=tuple(axes), axis_size=size)(*arguments)
        else:
            results = lax.map(
                lambda each: batched(*each), jax.tree.map(_repeated(size), tuple(arguments), tuple(is_batched))
            )
        return results, jax.tree.map(lambda _: True, results)

    return batched


def _repeated(size: int) -> Callable[[Any, bool], Any]:
    return lambda leaf, batched: leaf if batched else jnp.broadcast_to(leaf, (size, *jnp.shape(leaf)))
