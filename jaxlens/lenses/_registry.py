"""The lenses that files and the command line know by name; whoever writes one registers it."""

import re
from collections.abc import Callable
from typing import TypeVar

from jaxlens.lenses._lens import Lens

Class = TypeVar("Class", bound=type[Lens])

_CLASSES: dict[str, type[Lens]] = {}
_SHORT: dict[str, str] = {}
_NAME = re.compile(r"[A-Za-z][\w.-]*", re.ASCII)


def register(name: str, *, short: str | None = None) -> Callable[[Class], Class]:
    """Gives a lens its name in files: a class decorator.

    The fields of a registered lens that hold numbers are written to `lens.json` under that name, and its constructor
    must take them by name: so it comes back. A file never makes anything be imported: it is read where the module that
    registers its lens has been imported already.

    Args:
        name: The name, letters, digits, `_`, `.` and `-`. It should not change: files hold it.
        short: What `--model` of the command line calls it, besides; `name` unless given.

    Raises:
        ValueError: no such name, or another lens has it.
        TypeError: the class is no `Lens`.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> from jaxtyping import Array, Float
        >>> @jl.lenses.register("example-cubic")
        ... class Cubic(jl.Lens):
        ...     a: Float[Array, ""]
        ...     def distort(self, points):
        ...         return points * (1 + self.a * jnp.sum(points**2, axis=-1, keepdims=True))
        >>> jl.lenses.registered()["example-cubic"] is Cubic
        True
    """
    for one in (name, short):
        if one is not None and not _NAME.fullmatch(one):
            raise ValueError(
                f"a lens's name has letters, digits, '_', '.' and '-' and begins with a letter, got {one!r}"
            )

    def decorate(lens: Class) -> Class:
        if not (isinstance(lens, type) and issubclass(lens, Lens)):
            raise TypeError(f"register({name!r}) is for subclasses of Lens, got {lens!r}")
        for one in (name, name if short is None else short):
            holder = _CLASSES.get(_SHORT.get(one, one))
            # The same class again is a notebook's cell that has been run again.
            if holder is not None and _path(holder) != _path(lens):
                raise ValueError(f"{one!r} is the name of {_path(holder)} already; give {_path(lens)} another")
        _CLASSES[name] = lens
        _SHORT[name if short is None else short] = name
        return lens

    return decorate


def registered() -> dict[str, type[Lens]]:
    """Returns the lenses that files may hold, by name."""
    return dict(_CLASSES)


def registered_name(lens: type[Lens]) -> str:
    """Returns the name of a lens in files.

    Raises:
        ValueError: it has none.
    """
    for name, one in _CLASSES.items():
        if one is lens:
            return name
    raise ValueError(
        f"{lens.__name__} has no name in files: decorate the class with @jaxlens.lenses.register(...); "
        f"registered are {', '.join(_CLASSES)}"
    )


def find_lens(name: str) -> type[Lens]:
    """Returns the lens of a name, the short one or that in files.

    Raises:
        ValueError: no such lens; the message lists those there are.
    """
    found = _CLASSES.get(_SHORT.get(name, name))
    if found is None:
        raise ValueError(f"there is no lens {name!r}; there are {', '.join(_SHORT)}")
    return found


def _path(lens: type[Lens]) -> str:
    return f"{lens.__module__}.{lens.__qualname__}"
