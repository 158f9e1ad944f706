"""The lens that --model names: one that jaxlens knows, or a class of the user's own."""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING

from jaxlens.cli.errors import UsageError

if TYPE_CHECKING:
    from jaxlens.lenses import Lens


def find_model(name: str) -> "type[Lens]":
    """Returns the class that --model names; what it says with a colon is imported, and thus run.

    Raises:
        UsageError: no such lens, or what is named is none.
    """
    if ":" in name:
        return _imported(name)
    from jaxlens.lenses import find_lens

    try:
        return find_lens(name)
    except ValueError as error:
        raise UsageError(f"--model: {error}; one of your own is package.module:Class") from None


def starting_lens(model: str, terms: int | None, start: tuple[float, ...]) -> "Lens":
    """Returns the lens that a fit starts from: the one without distortion, its first coefficients replaced by `start`.

    Raises:
        UsageError: a number of coefficients that the lens does not have.
    """
    import equinox as eqx
    from jax.flatten_util import ravel_pytree

    lens_class = find_model(model)
    if terms is not None and terms not in lens_class.term_counts:
        listed = ", ".join(str(count) for count in sorted(lens_class.term_counts)) or "left out only"
        raise UsageError(f"--terms of the {model} lens can be {listed}; got {terms}")
    try:
        lens = lens_class.identity() if terms is None else lens_class.identity(terms=terms)
        adjusted, rest = eqx.partition(lens, lens.adjustable())
    except Exception as error:
        raise UsageError(f"--model {model}: no lens to start from: {_said(error)}") from error
    values, made_of = ravel_pytree(adjusted)
    if len(start) > values.size:
        raise UsageError(
            f"--start has {len(start)} coefficients, and the {model} lens {values.size}; leave some out"
            + (", or pass --terms" if len(lens_class.term_counts) > 1 else "")
        )
    return eqx.combine(made_of(values.at[: len(start)].set(start)), rest)


def check_saved(model: str) -> None:
    """Refuses to save a lens that files have no name for, before it is fitted.

    Raises:
        UsageError: it is not registered.
    """
    from jaxlens.lenses import registered_name

    try:
        registered_name(find_model(model))
    except ValueError as error:
        raise UsageError(f"--output: {error}") from error


def _imported(name: str) -> "type[Lens]":
    from jaxlens.lenses import Lens

    module_name, _, class_name = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), class_name)):
        raise UsageError(f"--model {name!r} is no package.module:Class")
    if os.getcwd() not in sys.path:
        # Last, so that a file here does not take the place of a library.
        sys.path.append(os.getcwd())
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise UsageError(f"--model {name}: {module_name} cannot be imported: {_said(error)}") from error
        raise UsageError(
            f"--model {name}: there is no module {error.name!r} in the current folder, nor among what is installed"
        ) from None
    except (Exception, SystemExit) as error:
        raise UsageError(f"--model {name}: {module_name} cannot be imported: {_said(error)}") from error
    found = getattr(module, class_name, None)
    if found is None:
        lenses = [key for key, value in vars(module).items() if _is_lens(value) and value.__module__ == module_name]
        there = f"; its lenses are {', '.join(lenses)}" if lenses else ""
        raise UsageError(f"--model {name}: the module {module_name} has no {class_name}{there}")
    if not _is_lens(found):
        raise UsageError(f"--model {name} is no subclass of jaxlens.Lens, but {type(found).__name__} {class_name}")
    assert issubclass(found, Lens)
    return found


def _is_lens(value: object) -> bool:
    from jaxlens.lenses import Lens

    return isinstance(value, type) and issubclass(value, Lens)


def _said(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
