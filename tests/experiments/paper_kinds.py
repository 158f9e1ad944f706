"""The kinds of experiment in the folder `experiments`, for tests."""

import importlib
import shutil
import sys
from pathlib import Path
from types import ModuleType

from jaxlens.experiments.finding import find_kind

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def module_of(kind: str, part: str = "") -> ModuleType:
    """The module of a kind, or a part of it."""
    name = find_kind(kind, EXPERIMENTS).model.__module__
    return importlib.import_module(f"{name}.{part}") if part else sys.modules[name]


def copy_kinds(folder: Path) -> None:
    """Puts all kinds into a folder."""
    for path in EXPERIMENTS.rglob("*.py"):
        copy = folder / path.relative_to(EXPERIMENTS)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
