"""Small numerical helpers that every layer of the core shares."""

import dataclasses
import enum
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

# What the field calls the x and y of these.
_PAIRS = {"center": "center_", "principal_point": "c", "focal_length": "f"}
# Numbers up to which an array is shown in full.
_FEW = 32

Method = TypeVar("Method", bound=Callable)


class Status(enum.IntEnum):
    """How something ended: stored and compared as a number, printed as a name."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, specification: str) -> str:
        return format(self.name, specification)


def jitted(method: Method) -> Method:
    """Compiles a method by `jax.jit`, so that type checkers still see the method, which a subclass may override."""
    return cast(Method, jax.jit(method))


def is_concrete(*trees: PyTree) -> bool:
    """Tells whether the numbers are known, or stand for later ones under `jax.jit` or `jax.vmap`."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def numbered(name: str, shape: tuple[int, ...]) -> list[str]:
    """Returns a name for each number of an array, row by row: `name[0]`, `name[1]`, …; a lone number has the name."""
    if name in _PAIRS and shape == (2,):
        return [_PAIRS[name] + axis for axis in "xy"]
    return [name + "".join(f"[{i}]" for i in index) for index in np.ndindex(*shape)]


def shown(module: Any) -> str:
    """Returns a module as it is made, with its numbers where they are known and not too many."""
    values = [f"{field.name}={_shown(getattr(module, field.name))}" for field in dataclasses.fields(module)]
    return f"{type(module).__name__}({', '.join(values)})"


def _shown(value: Any) -> str:
    if isinstance(value, jax.Array | np.ndarray) and is_concrete(value) and value.size <= _FEW:
        return np.array2string(np.asarray(value), separator=", ", max_line_width=10**6)
    return eqx.tree_pformat(value) if isinstance(value, jax.Array) else repr(value)


def as_floating(values: ArrayLike | Sequence) -> Array:
    """Returns `values` as a floating array: floats keep their dtype, anything else gets JAX's default float."""
    if isinstance(values, jax.Array) and jnp.issubdtype(values.dtype, jnp.floating):
        return values
    if not any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)):
        # Numbers and lists become an array several times faster in NumPy: a lens is often made for one call.
        values = np.asarray(values)
        if values.dtype.kind in "biu":
            values = values.astype(jnp.result_type(float))
    array = jnp.asarray(values)
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise ValueError(f"expected real numbers, got dtype {array.dtype}; pass the real part or the magnitude")
    if jnp.issubdtype(array.dtype, jnp.floating):
        return array
    return array.astype(jnp.result_type(float))


def as_parameter(value: ArrayLike, name: str) -> Float[Array, ""]:
    """Returns a lens's number as an array.

    Raises:
        ValueError: it is no single number.
    """
    number = as_floating(value)
    if number.ndim != 0:
        raise ValueError(f"{name} must be a number, got shape {number.shape}; a batch of lenses is made by jax.vmap")
    return number


def as_parameters(**values: ArrayLike) -> list[Float[Array, ""]]:
    """Returns a lens's numbers, given by name, as arrays of one dtype: plain numbers take that of arrays beside them.

    Raises:
        ValueError: one of them is no single number.
    """
    arrays = [as_parameter(value, name) for name, value in values.items()]
    typed = [array.dtype for array, value in zip(arrays, values.values(), strict=True) if hasattr(value, "dtype")]
    dtype = jnp.result_type(*(typed or [float]))
    return [array.astype(dtype) for array in arrays]


def as_coefficients(values: ArrayLike | Sequence, name: str, meaning: str) -> Float[Array, " terms"]:
    """Returns the coefficients of a lens as a vector; OpenCV's 1×n and n×1 arrays are taken as such.

    Args:
        values: The coefficients.
        name: The class that they are for, for messages.
        meaning: What they are, for messages.

    Raises:
        ValueError: a single number, or an array that is no vector.
    """
    array = as_floating(values)
    if array.ndim == 0:
        raise ValueError(f"{name} takes {meaning} as a list, got a number: write {name}([{values}])")
    if array.ndim == 2 and 1 in array.shape:
        return array.reshape(-1)
    if array.ndim != 1:
        raise ValueError(
            f"{name} takes {meaning} as a vector, got shape {array.shape}; a batch of lenses is made by "
            f"jax.vmap({name})(coefficients)"
        )
    return array


def as_points(points: ArrayLike | Sequence) -> Float[Array, "*batch 2"]:
    """Returns `points` as a floating array and checks that its last axis holds (x, y).

    Raises:
        ValueError: the last axis has not length 2.
    """
    array = as_floating(points)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ValueError(f"points must have shape (..., 2) in (x, y) order, got {array.shape}")
    return array


def as_rays(rays: ArrayLike | Sequence) -> Float[Array, "*batch 3"]:
    """Returns `rays` as a floating array and checks that its last axis holds (x, y, z).

    Raises:
        ValueError: the last axis has not length 3.
    """
    array = as_floating(rays)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"rays must have shape (..., 3), x to the right, y down, z forward, got {array.shape}")
    return array


def split(points: Float[Array, "*batch axes"]) -> tuple[Any, ...]:
    """Returns the x and y of points, or the x, y and z of rays, as planes: on them arithmetic is twice as fast."""
    return tuple(points[..., axis] for axis in range(points.shape[-1]))


def join(*planes: Float[Array, "*batch"]) -> Float[Array, "*batch axes"]:
    """Returns points from their x and y, rays from their x, y and z."""
    return jnp.stack(planes, axis=-1)


def masked(points: Float[Array, "*batch axes"], valid: Bool[Array, "*batch"]) -> Float[Array, "*batch axes"]:
    """Returns points, or rays, with NaN where they are not valid; plane by plane, which fuses with what comes next."""
    return join(*(jnp.where(valid, points[..., axis], jnp.nan) for axis in range(points.shape[-1])))


def epsilon(dtype: jax.typing.DTypeLike) -> float:
    """Returns the spacing of `dtype` at one: the unit in which every tolerance of the library is stated."""
    return float(jnp.finfo(dtype).eps)


def polynomial(
    coefficients: Float[Array, " terms"] | tuple[float, ...], x: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Evaluates `Σ coefficients[i] xⁱ` by Horner's rule; the empty sum is zero."""
    total = jnp.zeros_like(x)
    for coefficient in reversed(list(coefficients)):
        total = total * x + coefficient
    return total
