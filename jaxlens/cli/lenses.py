"""Lenses that are named on the command line: by --kappa, by --lens, and by --model, which may be the user's own."""

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from jaxlens.cli.inputs import check_file
from jaxlens.cli.messages import UsageError, in_options

if TYPE_CHECKING:
    from jaxlens.calibrations import Calibration
    from jaxlens.frames import Frame
    from jaxlens.lenses import Lens


@dataclass(frozen=True)
class LensChoice:
    """A lens for pictures of any size; hashable, so that what depends on it and a size is computed once.

    Attributes:
        kappa: Coefficients of a radial lens.
        center: Of that lens, (x, y) in pixels; None for Eq. 10's.
        calibration: Another lens with a frame of its own, in place of `kappa` and `center`.
    """

    kappa: tuple[float, ...] = ()
    center: tuple[float, float] | None = None
    calibration: "Calibration | None" = None

    def lens(self) -> "Lens":
        """Returns the lens, in JAX's default float."""
        from jaxlens.lenses import RadialPolynomial

        return RadialPolynomial(self.kappa) if self.calibration is None else self.calibration.lens()

    def place(self, height: int, width: int) -> "tuple[Lens, Frame]":
        """Returns the lens, and its frame for pictures of that size, in JAX's default float.

        Raises:
            CalibrationError: as `Calibration.frame`.
        """
        from jaxlens.frames import Frame

        if self.calibration is not None:
            return self.lens(), self.calibration.frame(height, width)
        center = (width / 2, height / 2) if self.center is None else self.center
        return self.lens(), Frame(center, math.hypot(width, height) / 2)


def check_choice(
    kappa: Sequence[float] | None, lens: Path | None, model: str | None, center: Sequence[float] | None = None
) -> None:
    """Refuses options that name no lens, or two.

    Raises:
        UsageError: not one of --kappa and --lens, or --center or --model without the one that it goes with.
    """
    if kappa is not None and lens is not None:
        raise UsageError(f"--kappa and --lens {str(lens)!r} are two lenses; leave one of them out")
    if kappa is None and lens is None:
        raise UsageError("a lens is needed: pass --kappa K1 [K2 ...], or --lens FILE.json")
    if lens is None and model is not None:
        raise UsageError("--model says what the lens in --lens FILE.json is; leave it out")
    if lens is not None:
        if center is not None:
            raise UsageError("--center goes with --kappa; a calibration has a centre of its own: leave it out")
        check_file(lens)


def choose_lens(
    kappa: Sequence[float] | None, lens: Path | None, model: str | None, center: Sequence[float] | None = None
) -> LensChoice:
    """Returns the lens that options name, which `check_choice` has let pass.

    Args:
        kappa: Coefficients.
        lens: A calibration file. It never makes anything be imported.
        model: The class of the lens in it: only what the user names is imported, and thus run.
        center: Of the lens of `kappa`.

    Raises:
        UsageError: the file is no calibration, or one of no lens that is known.
    """
    if lens is None:
        return LensChoice(tuple(kappa or ()), None if center is None else (center[0], center[1]))
    from jaxlens.calibrations import CalibrationError, read_calibration

    named = None if model is None else _file_name(model, "--model")
    try:
        calibration = read_calibration(lens)
    except CalibrationError as error:
        raise UsageError(in_options(error, lens)) from error
    if named not in (None, calibration.model):
        raise UsageError(f"--model {model} is the lens {named!r}, and {str(lens)!r} holds a {calibration.model!r}")
    try:
        calibration.lens()
    except CalibrationError as error:
        raise UsageError(f"{str(lens)!r}: {error}") from error
    return LensChoice(calibration=calibration)


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


def coefficients(lens: "Lens") -> tuple[float, ...]:
    """Returns the numbers of a lens that --start sets, in their order."""
    import equinox as eqx
    import numpy as np
    from jax.flatten_util import ravel_pytree

    return tuple(np.asarray(ravel_pytree(eqx.filter(lens, lens.adjustable()))[0], float).tolist())


def check_saved(model: str) -> None:
    """Refuses to save a lens that files have no name for, before it is fitted.

    Raises:
        UsageError: it is not registered.
    """
    _file_name(model, "--output")


def _file_name(model: str, option: str) -> str:
    """The name in files of the lens that --model names."""
    from jaxlens.lenses import registered_name

    try:
        return registered_name(find_model(model))
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from error


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
