"""Which code an experiment runs: its kind's module, what that imports, and so on; read, and not run, to find it."""

import ast
import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True)
class Source:
    """The source of a module.

    Attributes:
        text: What it says, and what its stub says, where the names stand that a lazy package hands on. Lines end in a
            newline, whatever Git was told.
        package: Whether it is a package's `__init__`.
    """

    text: str
    package: bool = False

    @classmethod
    def read(cls, path: Path) -> "Source":
        """Reads a module.

        Raises:
            OSError: it cannot be read.
            UnicodeDecodeError: it is no text.
        """
        files = [path, *(stub for stub in [path.with_suffix(".pyi")] if stub.is_file())]
        return cls("\n".join(file.read_text(encoding="utf-8") for file in files), path.stem == "__init__")

    @property
    def sha256(self) -> str:
        """The checksum of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


Read = Callable[[str], Source | None]
"""From the full name of a module to its source; None where there is no such module, or it is not to be looked at."""


def _read_package() -> dict[str, Source]:
    package, found = Path(__file__).parents[1], {}
    for path in package.rglob("*.py"):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = Source.read(path)
    return found


PACKAGE = _read_package()
"""The modules of jaxlens. Read at once, when this is imported: the source may be edited while an experiment runs."""


def imported(start: str, read: Read) -> dict[str, Source]:
    """Returns a module and all that it imports, at its top or in functions, directly or not.

    A name that a package's `__init__` only hands on stands for the module that it comes from. So does a package that
    is used by names alone (`jl.warp`); one that is used otherwise stands for all that it hands on.

    Args:
        start: The module, by its full name.
        read: Of the modules that count.
    """
    found: dict[str, Source] = {}
    waiting = [start]
    while waiting:
        name = waiting.pop()
        source = read(name)
        if source is not None and name not in found:
            found[name] = source
            waiting += [module for used in _used(name, source) for module in _modules(used, read)]
    return found


def _modules(full_name: str, read: Read) -> Iterator[str]:
    """The module of that name, or those where what has that name is defined."""
    parent, _, name = full_name.rpartition(".")
    if read(full_name) is not None:
        yield full_name
    elif parent:
        source = read(parent)
        handed_on = _bindings(parent, source).get(name, set()) - {full_name} if source is not None else set()
        for other in handed_on or {parent}:
            yield from _modules(other, read)


@cache
def _used(module: str, source: Source) -> set[str]:
    """Full names of all that a module imports; where it uses something of that by name, the longer names."""
    bindings, nodes = _bindings(module, source), _nodes(source)
    inner = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    used, seen = set[str](), set[str]()
    for node in nodes:
        if id(node) in inner:
            continue
        # As long as it is written: `a.b.c`.
        attributes: list[str] = []
        while isinstance(node, ast.Attribute):
            attributes.insert(0, node.attr)
            node = node.value
        if isinstance(node, ast.Name) and node.id in bindings:
            used |= {".".join([name, *attributes]) for name in bindings[node.id]}
            seen.add(node.id)
    return used | {name for local in bindings.keys() - seen for name in bindings[local]}


@cache
def _bindings(module: str, source: Source) -> dict[str, set[str]]:
    """Local names and the full names that they are imported from; one may mean several, in several functions."""
    found = defaultdict[str, set[str]](set)
    for node in _nodes(source):
        if isinstance(node, ast.Import):
            for alias in node.names:
                first = alias.name.partition(".")[0]
                found[alias.asname or first].add(alias.name if alias.asname else first)
        elif isinstance(node, ast.ImportFrom):
            parts = module.split(".")
            above = parts[: len(parts) - node.level + source.package] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                found[alias.asname or alias.name].add(base if alias.name == "*" else f"{base}.{alias.name}")
    return found


@cache
def _nodes(source: Source) -> list[ast.AST]:
    try:
        return list(ast.walk(ast.parse(source.text)))
    except (SyntaxError, ValueError):
        # Said where it is imported.
        return []
