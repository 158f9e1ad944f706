"""The kinds of experiment in the folder `experiments`, for tests."""

import shutil
import sys
from pathlib import Path
from types import ModuleType

from jaxlens.experiments.finding import find_kind

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def module_of(kind: str) -> ModuleType:
    """The module of a kind."""
    return sys.modules[find_kind(kind, EXPERIMENTS).model.__module__]


def write(folder: Path, name: str, text: str) -> Path:
    """Writes a configuration, and all kinds beside it."""
    for path in EXPERIMENTS.rglob("*.py"):
        copy = folder / path.relative_to(EXPERIMENTS)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name
