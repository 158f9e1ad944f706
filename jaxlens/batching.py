"""How a batch of large problems is solved: one after another, so that each finds its temporary memory in the cache."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import max_dim, min_dim
from jax.custom_batching import custom_vmap

# Elements from which the members of a batch take turns.
_LARGE = 1 << 15
# Elements of a part: on a processor as many as its cache holds, on an accelerator as many as keep it busy.
_PART, _ACCELERATOR_PART = 1 << 15, 1 << 22


def in_turns(function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function whose `jax.vmap` runs large problems in turns, and small ones together.

    In turns, too, each problem takes only its own branch of a `cond`, and its own number of steps. Where there are
    several devices a turn has a problem for each, so that a batch that is sharded over them stays where it is.

    Args:
        function: Without derivatives; its second argument is an array as large as the problem.
    """
    batched = custom_vmap(function)

    @batched.def_vmap
    def batch(size, is_batched, *arguments):
        elements = arguments[1].size // (size if is_batched[1] else 1)
        # Sizes may be symbols of `jax.export`: any, thus perhaps large.
        if isinstance(elements, int) and elements < _LARGE:
            axes = jax.tree.map(lambda batched: 0 if batched else None, is_batched)
            results = jax.vmap(function, in_axes=tuple(axes), axis_size=size)(*arguments)
        else:
            arguments = jax.tree.map(_repeated(size), tuple(arguments), tuple(is_batched))
            together = math.gcd(size, jax.device_count()) if isinstance(size, int) else 1
            if together == 1:
                results = lax.map(lambda each: batched(*each), arguments)
            else:
                several = in_turns(jax.vmap(function))
                turns = jax.tree.map(lambda leaf: _dealt(leaf, together), arguments)
                results = jax.tree.map(_collected, lax.map(lambda each: several(*each), turns))
        return results, jax.tree.map(lambda _: True, results)

    return batched


def _repeated(size: int) -> Callable[[Any, bool], Any]:
    return lambda leaf, batched: leaf if batched else jnp.broadcast_to(leaf, (size, *jnp.shape(leaf)))


def _dealt(leaf: jax.Array, hands: int) -> jax.Array:
    """Deals a batch out in runs, as devices hold it: (turns, hands, …)."""
    return jnp.swapaxes(leaf.reshape(hands, -1, *leaf.shape[1:]), 0, 1)


def _collected(leaf: jax.Array) -> jax.Array:
    """Undoes `_dealt`."""
    return jnp.swapaxes(leaf, 0, 1).reshape(-1, *leaf.shape[2:])


def in_turns_if_large(function: Callable[[Any], Any], batch: Any, elements: int) -> Any:
    """Applies a function to each member of a batch, as `in_turns` does, where it is to be transposed.

    With several devices all members take part at once.

    Args:
        function: Computes the results for one member.
        batch: A pytree of arrays with a leading axis.
        elements: How large a member's problem is.
    """
    large = not isinstance(elements, int) or elements >= _LARGE
    return lax.map(function, batch) if large and jax.device_count() == 1 else jax.vmap(function)(batch)


def in_parts(function: Callable[..., Any], *planes: jax.Array) -> Any:
    """Applies a pointwise function to planes part by part, so that its temporary memory is that of a part.

    XLA reserves that of every branch, taken or not; and where all of it passes 32 MB, the C library gives it back to
    the system after each call: to be given new pages then costs more than the arithmetic.
    """
    shape = planes[0].shape
    count = math.prod(shape)
    part = _PART if jax.default_backend() == "cpu" else _ACCELERATOR_PART
    if isinstance(count, int) and count <= part:
        return function(*planes)
    size = min_dim(part, count)
    flat = [plane.reshape(count) for plane in planes]
    results = jax.eval_shape(function, *(lax.slice(plane, (0,), (size,)) for plane in flat))

    def step(part, wholes):
        begin = jnp.minimum(part * size, count - size)  # the last part overlaps the one before
        found = function(*(lax.dynamic_slice(plane, (begin,), (size,)) for plane in flat))
        return jax.tree.map(lambda whole, new: lax.dynamic_update_slice(whole, new, (begin,)), wholes, found)

    wholes = jax.tree.map(lambda result: jnp.zeros(count, result.dtype), results)
    wholes = lax.fori_loop(0, -(-count // max_dim(size, 1)), step, wholes)
    return jax.tree.map(lambda whole: whole.reshape(shape), wholes)
