"""From `kind = "rotation"` to the class of that experiment: built in, or `rotation.py` beside the configuration."""

import importlib
import itertools
import re
import sys
import traceback
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

from jaxlens.experiments.errors import ConfigError
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.imports import PACKAGE, Source, imported

BUILT_IN = {"sweep": "jaxlens.experiments.sweep"}
"""The kinds that are built in, and their modules."""
RUNNER = "jaxlens.experiments.runner"

_NAME = re.compile("[a-z][a-z0-9_]*")
# The package that the modules beside a configuration are, and the number of those that there were before.
_BESIDE = "beside"
_numbers = itertools.count()


@dataclass(frozen=True)
class Kind:
    """A kind of experiment.

    Attributes:
        name: As configurations say it.
        model: Its class.
        file: The Python file that defines it; None if it is built in.
        module: The full name of the module, `beside.rotation` for one beside the configuration.
        own: That module and those beside it that it imports, as they were read; none if it is built in.
    """

    name: str
    model: type[Experiment]
    file: Path | None
    module: str
    own: tuple[tuple[str, Source], ...] = ()

    def sources(self) -> dict[str, str]:
        """Returns the SHA-256 of every module that a run imports, of jaxlens and beside the configuration."""
        known = PACKAGE | dict(self.own)
        found = imported(RUNNER, known.get) | imported(self.module, known.get)
        return {name: found[name].sha256 for name in sorted(found)}


def find_kind(name: object, folder: Path) -> Kind:
    """Finds the class of a kind of experiment, and imports its module.

    Args:
        name: What the configuration says.
        folder: Of the configuration. Elsewhere nothing is looked for, and links out of it are not followed.

    Raises:
        ConfigError: there is no such kind, its file fails when it is imported, or does not define one experiment.
    """
    plain = name if isinstance(name, str) and _NAME.fullmatch(name) else ""
    if plain in BUILT_IN:
        (model,) = _experiments_in(importlib.import_module(BUILT_IN[plain]))
        return Kind(plain, model, None, BUILT_IN[plain])
    file = _file_beside(folder, plain) if plain else None
    if file is None:
        built_in, beside = (", ".join(f"'{one}'" for one in names) for names in (BUILT_IN, _names_beside(folder)))
        got = "is missing" if name is None else f"got {name!r}"
        raise ConfigError(
            f"kind: {got}; must be {built_in} (built in) or the name, in lower-case letters, digits and underscores, "
            f"of a Python file in the configuration's folder" + (f": {beside}" if beside else "; there is none")
        )
    try:
        own = imported(f"{_BESIDE}.{plain}", lambda module: _source_beside(folder, module))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"kind: {file} or a file that it imports cannot be read: {error}") from None
    modules = tuple(sorted(own.items()))
    return Kind(plain, _load(plain, folder, folder.resolve(), modules), file, f"{_BESIDE}.{plain}", modules)


@cache
def _load(name: str, folder: Path, place: Path, own: tuple[tuple[str, Source], ...]) -> type[Experiment]:
    """Imports a module beside a configuration, anew whenever it or what it imports there has changed (`own`).

    It becomes part of a package of its own, so that `from .other import …` finds its neighbours, that nothing of it
    is found from elsewhere, and that modules of one name in several folders are several.
    """
    package = ModuleType(f"{_BESIDE}{next(_numbers)}")
    package.__path__ = [str(place)]
    sys.modules[package.__name__] = package
    importlib.invalidate_caches()
    try:
        found = _experiments_in(importlib.import_module(f"{package.__name__}.{name}"))
    except (Exception, SystemExit) as error:
        where = folder / _place_of(error, place)
        raise ConfigError(f"kind: {where}: {type(error).__name__}: {error}") from None
    if len(found) != 1:
        count = ", ".join(one.__name__ for one in found) or "none"
        raise ConfigError(
            f"kind: {_file_beside(folder, name)}: must define one subclass of jaxlens.experiments.Experiment, and "
            f"defines {count}"
        )
    return found[0]


def _experiments_in(module: ModuleType) -> list[type[Experiment]]:
    values = [value for value in vars(module).values() if isinstance(value, type) and issubclass(value, Experiment)]
    return [value for value in values if value.__module__ == module.__name__]


def _place_of(error: BaseException, folder: Path) -> str:
    """File and line of what went wrong, as deep as it lies in the folder."""
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        places = [(error.filename, error.lineno)]
    else:
        places = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    inside = [(Path(path), line) for path, line in places if Path(path).is_relative_to(folder)]
    # There is none where a file cannot be compiled, as with null bytes.
    path, line = inside[-1] if inside else (folder, 1)
    return f"{path.relative_to(folder)}, line {line}"


def _names_beside(folder: Path) -> list[str]:
    paths = [*folder.glob("*.py"), *(path.parent for path in folder.glob("*/__init__.py"))]
    return sorted({path.stem for path in paths if _NAME.fullmatch(path.stem) and _file_beside(folder, path.stem)})


def _source_beside(folder: Path, module: str) -> Source | None:
    package, *parts = module.split(".")
    path = _file_beside(folder, *parts, links=True) if package == _BESIDE and parts else None
    return None if path is None else Source.read(path)


def _file_beside(folder: Path, *parts: str, links: bool = False) -> Path | None:
    """The file of a module in a folder, as Python finds it; None if there is none, or only a link."""
    place = folder.resolve()
    for file in (Path(*parts, "__init__.py"), Path(*parts).with_suffix(".py")):
        if (place / file).is_file() and (links or (place / file).resolve() == place / file):
            return folder / file
    return None
