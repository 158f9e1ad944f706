"""Where the compiler may not merge loops: what several loops read, or one slow loop reads, is computed once before."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool


def in_memory(function: Callable[[], Any], witness: Array) -> Any:
    """Returns `function()`, computed in loops of its own and written to memory.

    XLA's compiler for CPUs takes `lax.optimization_barrier` out before it merges loops. A gather then drags the
    arithmetic of its indices into a loop that is not vectorized; and two loops that each compute a position may round
    it to different sides of a pixel. Into a branch it does not look.

    Args:
        function: What it closes over is differentiated as if it were called.
        witness: Any array that is known only at run time.
    """
    if witness.size == 0:
        return function()
    results = jax.eval_shape(function)

    def nothing():
        return jax.tree.map(lambda result: jnp.zeros(result.shape, result.dtype), results)

    return lax.cond(always(witness), function, nothing)


def always(witness: Array) -> Bool[Array, ""]:
    """Returns true, without the compiler knowing; one answer for a whole batch, so that a `cond` stays one."""
    return _not_above_infinity(lax.stop_gradient(witness))


@custom_vmap
def _not_above_infinity(witness: Array) -> Bool[Array, ""]:
    return ~(witness[(0,) * witness.ndim].astype(jnp.float32) > jnp.inf)


@_not_above_infinity.def_vmap
def _not_above_infinity_in_batch(size, is_batched, witness):
    del size, is_batched
    return _not_above_infinity(witness), False
