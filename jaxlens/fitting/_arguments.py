"""What the fits ask of their arguments, once for all of them: clear errors for what no fit could use."""

from collections.abc import Mapping
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, PyTree

from jaxlens.fitting._robust import Loss
from jaxlens.numerics import as_floating, is_concrete

Bounds = Mapping[str, tuple[float, float]]
"""The smallest and largest value of parameters, by the names that `Fit.names` lists."""


def common_dtype(*trees: PyTree) -> jnp.dtype:
    """Returns the dtype to fit in: the widest of the data's and the lens's, at least single precision."""
    dtypes = [leaf.dtype for leaf in jax.tree.leaves(trees) if hasattr(leaf, "dtype")]
    return jnp.result_type(*[dtype for dtype in dtypes if jnp.issubdtype(dtype, jnp.floating)], jnp.float32)


def check_loss(loss: str, loss_scale: ArrayLike | None) -> None:
    """Raises `ValueError` for a loss that is none, or a scale at which it cannot bend."""
    if loss not in get_args(Loss):
        raise ValueError(f"loss must be one of {', '.join(get_args(Loss))}, got {loss!r}")
    if loss_scale is not None and is_concrete(loss_scale) and not 0 < float(np.asarray(loss_scale)) < np.inf:
        raise ValueError(f"loss_scale must be a finite number above 0, got {loss_scale}")


def check_solver(solver: object, *, bounded: bool) -> None:
    """Raises `ValueError` for a solver that is none for least squares, or that would pass over the bounds."""
    if solver is None:
        return
    if not isinstance(solver, optx.AbstractLeastSquaresSolver):
        got = f"the class {solver.__name__}" if isinstance(solver, type) else f"{type(solver).__name__}"
        raise ValueError(
            "solver must be a least-squares solver of optimistix, such as "
            f"optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8), or None for ours; got {got}"
        )
    if bounded:
        raise ValueError(
            f"{type(solver).__name__} knows no bounds: leave them out, or leave the solver to us by solver=None"
        )


class Static:
    """A pytree that `jax.jit` takes as a static argument: equal to another of the same content, arrays included."""

    def __init__(self, tree: PyTree):
        self.tree = tree
        leaves, structure = jax.tree.flatten(tree)
        self._key = structure, tuple(_as_key(leaf) for leaf in leaves)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Static) and self._key == other._key


def _as_key(leaf: Any) -> Any:
    if not isinstance(leaf, jax.Array | np.ndarray):
        return leaf
    values = np.asarray(leaf)
    return values.shape, values.dtype.str, values.tobytes()


def as_weights(weights: ArrayLike | None, shape: tuple[int, ...]) -> Array | np.ndarray:
    """Returns weights of that shape, ones by default.

    Raises:
        ValueError: a wrong shape, a negative or a NaN weight, none positive.
    """
    if weights is None:
        return np.ones(shape, np.float32)
    array = as_floating(weights)
    if array.shape != shape:
        raise ValueError(f"weights need shape {shape}, one for each point, got {array.shape}")
    if is_concrete(array):
        values = np.asarray(array)
        bad = ~(np.isfinite(values) & (values >= 0))
        if bad.any():
            where = np.argwhere(bad)[0]
            raise ValueError(
                f"weights must be finite and not negative, got {values[tuple(where)]} at index {_index(where)}"
            )
    return array


def check_finite(name: str, points: ArrayLike, weights: ArrayLike) -> None:
    """Raises `ValueError` if a point that counts is not finite, with its index; says nothing of traced points."""
    if not is_concrete(points, weights):
        return
    points = np.asarray(points)
    if np.isfinite(points).all():
        return
    bad = ~np.isfinite(points).all(axis=-1) & (np.asarray(weights) > 0)
    if bad.any():
        where = np.argwhere(bad)[0]
        others = f" (and {bad.sum() - 1} more)" if bad.sum() > 1 else ""
        raise ValueError(
            f"{name}[{_index(where)}] is not finite: {points[tuple(where)].tolist()}{others}; "
            "remove it, or give it weight 0"
        )


def check_count(components: int, weights: ArrayLike, names: tuple[str, ...], what: str, further: int = 0) -> None:
    """Raises `ValueError` if fewer residuals count than there are parameters."""
    if not names:
        raise ValueError("nothing to fit: `free` names no parameter")
    if not is_concrete(weights):
        return
    count = components * int((np.asarray(weights) > 0).sum())
    if count < len(names) + further:
        extra = f" and {further} more" if further else ""
        raise ValueError(
            f"too few {what}: {count} equations for {len(names)} parameters ({', '.join(names)}){extra}; give more "
            "data, or fix some of the parameters by `free`"
        )


def bound_vectors(bounds: Bounds | None, names: tuple[str, ...]) -> tuple[Array, Array] | None:
    """Returns the lower and upper bounds of all parameters, None if there are none.

    Raises:
        ValueError: a bound for a parameter that is not fitted, or an empty interval.
    """
    if not bounds:
        return None
    unknown = [name for name in bounds if name not in names]
    if unknown:
        raise ValueError(f"bounds are given for {unknown[0]!r}, which is not fitted; fitted are {', '.join(names)}")
    for name, (low, high) in bounds.items():
        if is_concrete(low, high) and not low <= high:
            raise ValueError(f"bounds of {name} must be (smallest, largest), got ({low}, {high})")
    low, high = (
        jnp.stack([jnp.asarray(bounds.get(name, (-jnp.inf, jnp.inf))[side], float) for name in names])
        for side in (0, 1)
    )
    return low, high


def _index(where: np.ndarray) -> str:
    return ", ".join(str(i) for i in where)
