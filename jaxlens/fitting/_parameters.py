"""Which numbers of a pytree are fitted: from a pytree and a mask to a vector, and back."""

from collections import Counter
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import DictKey, GetAttrKey, SequenceKey, keystr
from jaxtyping import Array, Float, PyTree

from jaxlens.maps import CoordinateMap
from jaxlens.numerics import numbered


class Choice(NamedTuple):
    """Which of a pytree's floating numbers are free: their places, and their names, in the same order."""

    indices: tuple[int, ...]
    names: tuple[str, ...]


class Selection(eqx.Module):
    """A pytree of which some numbers are free.

    Attributes:
        tree: The pytree; the numbers that are not free keep their values.
        choice: Which are free.
    """

    tree: PyTree
    choice: Choice = eqx.field(static=True)

    def values(self) -> Float[Array, " free"]:
        """Returns the free numbers."""
        return _ravel(self.tree)[np.asarray(self.choice.indices, int)]

    def insert(self, values: Float[Array, " free"]) -> Any:
        """Returns the pytree with other values for the free numbers."""
        leaves, structure = jax.tree.flatten(self.tree)
        flat = _ravel(self.tree).at[np.asarray(self.choice.indices, int)].set(values)
        ends = np.cumsum([leaf.size for leaf in leaves])[:-1]
        parts = jnp.split(flat, ends)
        return jax.tree.unflatten(
            structure, [part.reshape(leaf.shape) for part, leaf in zip(parts, leaves, strict=True)]
        )


def choose(tree: PyTree, free: PyTree) -> Choice:
    """Returns the choice of a pytree's numbers for which a pytree of booleans (or arrays of them) is true.

    Args:
        tree: A pytree of floating arrays; their values do not matter.
        free: The same structure, with a boolean or an array of booleans for each array; static.

    Raises:
        ValueError: the mask does not fit the pytree.
    """
    leaves, structure = jax.tree.flatten(tree)
    masks, masked = jax.tree.flatten(free)
    if masked != structure:
        raise ValueError(
            "`free` must have the structure of what is fitted, with a boolean for each array in it: expected "
            f"{structure}, got {masked}"
        )
    shapes = tuple(np.shape(leaf) for leaf in leaves)
    return _choose(structure, shapes, tuple(mask if isinstance(mask, bool) else _Flags(mask) for mask in masks))


class _Flags:
    """An array that can be looked up: equal to another of the same content."""

    def __init__(self, values: Any):
        self.values = np.asarray(values)
        self._key = (self.values.shape, self.values.dtype.str, self.values.tobytes())

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Flags) and self._key == other._key


@lru_cache(maxsize=256)
def _choose(structure: Any, shapes: tuple[tuple[int, ...], ...], masks: tuple["bool | _Flags", ...]) -> Choice:
    tree = jax.tree.unflatten(structure, [np.empty(shape) for shape in shapes])
    chosen: list[tuple[str, bool, int, str]] = []
    begin = 0
    for (path, _), shape, given in zip(jax.tree_util.tree_leaves_with_path(tree), shapes, masks, strict=True):
        mask = given.values if isinstance(given, _Flags) else np.asarray(given)
        if mask.dtype != bool or mask.shape not in ((), shape):
            raise ValueError(
                f"`free` needs a boolean, or an array of booleans of shape {shape}, for {keystr(path)}; got "
                f"{mask.dtype} of shape {mask.shape}"
            )
        flags = np.broadcast_to(mask, shape).ravel()
        names = _names(tree, path, shape)
        # A centre of distortion is named after the coefficients of its lens.
        branch = str(path[0].key) if isinstance(path[0], DictKey) else ""
        late = getattr(path[-1], "name", None) == "center"
        chosen += [(branch, late, begin + i, names[i]) for i in np.flatnonzero(flags).tolist()]
        begin += flags.size
    chosen = _told_apart(sorted(chosen))
    names = tuple(name for *_, name in chosen)
    assert len(set(names)) == len(names), f"parameters of one name: {names}"
    return Choice(tuple(index for *_, index, _ in chosen), names)


def without(choice: Choice, fixed: Sequence[str]) -> Choice:
    """Returns the choice without some of its names.

    Raises:
        ValueError: a name that it does not have.
    """
    unknown = [name for name in fixed if name not in choice.names]
    if unknown:
        raise ValueError(f"cannot fix {unknown[0]!r}: the parameters are {', '.join(choice.names)}")
    kept = [pair for pair in zip(*choice, strict=True) if pair[1] not in fixed]
    return Choice(tuple(index for index, _ in kept), tuple(name for _, name in kept))


def named(tree: PyTree, names: Sequence[str]) -> tuple[Selection, list[int]]:
    """Returns a pytree in which the numbers that bear one of these names are free, and their places among the names."""
    every = choose(tree, jax.tree.map(lambda _: True, tree))
    kept = [(index, name) for index, name in zip(*every, strict=True) if name in names]
    choice = Choice(tuple(index for index, _ in kept), tuple(name for _, name in kept))
    return Selection(tree, choice), [list(names).index(name) for name in choice.names]


def free_mask(lens: CoordinateMap, free: PyTree | None, *, center: bool) -> PyTree:
    """Returns which numbers of a map are free: those of `free`, or its adjustable ones; with `center` that, too.

    Raises:
        ValueError: `center`, and the lens has none of its own.
    """
    if center and not hasattr(lens, "center"):
        raise ValueError(f"center=True needs a lens with a centre of distortion; {type(lens).__name__} has none")
    free = _adjustable(jax.tree.structure(lens)) if free is None else free
    return eqx.tree_at(lambda lens: lens.center, free, True) if center else free


@cache
def _adjustable(structure: Any) -> PyTree:
    return jax.tree.unflatten(structure, [True] * structure.num_leaves).adjustable()


def in_dtype(tree: PyTree, dtype: jax.typing.DTypeLike) -> Any:
    """Returns a pytree with all its floating arrays in one dtype."""

    def cast(leaf: Any) -> Any:
        array = jnp.asarray(leaf)  # integers and booleans count or choose something, and stay
        return array.astype(dtype) if jnp.issubdtype(array.dtype, jnp.floating) else array

    return jax.tree.map(cast, tree)


def _ravel(tree: PyTree) -> Float[Array, " numbers"]:
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])


def _names(tree: PyTree, path: tuple, shape: tuple[int, ...]) -> list[str]:
    """Returns the names of an array's numbers: its owner's, after the path to an owner that stands inside another."""
    owner = tree
    for key in path[:-1]:
        match key:
            case GetAttrKey(name):
                owner = getattr(owner, name)
            case DictKey(key) | SequenceKey(key):
                owner = owner[key]
    last = path[-1] if path else None
    name = getattr(last, "name", None) or str(getattr(last, "key", "value"))
    names = owner.parameter_names(name, shape) if isinstance(owner, CoordinateMap) else numbered(name, shape)
    inside = path[1:-1] if path and isinstance(path[0], DictKey) else path[:-1]
    prefix = keystr(inside).removeprefix(".")
    return [f"{prefix}.{name}" for name in names] if prefix else names


def _told_apart(chosen: list[tuple[str, bool, int, str]]) -> list[tuple[str, bool, int, str]]:
    """Writes a name of the lens's out in full where another part has it too (a lens may have a `gain` as light has)."""
    count = Counter(name for *_, name in chosen)
    return [
        (branch, late, index, f"{branch}.{name}" if count[name] > 1 and branch == "lens" else name)
        for branch, late, index, name in chosen
    ]
