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
        text: Its own; lines end in a newline, whatever Git was told.
        names: Where the names come from that it hands on: its stub, if it has one, else its text.
        package: Whether it is a package's `__init__.py`.
    """

    text: str
    names: str
    package: bool

    @classmethod
    def read(cls, path: Path) -> "Source":
        """Reads a module.

        Raises:
            OSError: it cannot be read.
            UnicodeDecodeError: it is no text.
        """
        text, stub = path.read_text(encoding="utf-8"), path.with_suffix(".pyi")
        return cls(text, stub.read_text(encoding="utf-8") if stub.is_file() else text, path.stem == "__init__")

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
            for full_name in _used(name, source):
                waiting += _modules(full_name, read)
    return found


def _modules(full_name: str, read: Read) -> Iterator[str]:
    """The module of that name, or those where what has that name is defined."""
    if read(full_name) is not None:
        yield full_name
        return
    parent, _, name = full_name.rpartition(".")
    source = read(parent) if parent else None
    if source is not None and name in (given := _given(parent, source)):
        for other in given[name] - {full_name}:
            yield from _modules(other, read)
    elif parent:
        yield from _modules(parent, read)


@cache
def _given(module: str, source: Source) -> dict[str, frozenset[str]]:
    """The names that a module imports, and the full names behind them."""
    return _bindings(_parse(source.names), module, source.package)


@cache
def _used(module: str, source: Source) -> frozenset[str]:
    """Full names of all that a module imports; of what it uses by names alone, these."""
    tree = _parse(source.text)
    bindings = dict(_bindings(tree, module, source.package))
    finder = _Finder(bindings)
    finder.visit(tree)
    unused = {name for local in bindings.keys() - finder.seen for name in bindings[local]}
    # A package whose names a stub lists, imported whole, is all of these.
    handed_on = {} if source.names == source.text else _given(module, source)
    return frozenset(finder.used | unused | {name for names in handed_on.values() for name in names})


class _Finder(ast.NodeVisitor):
    """Finds the uses of imported names, `a` and `a.b.c`, each as long as it is written."""

    def __init__(self, bindings: dict[str, frozenset[str]]):
        self.bindings, self.used, self.seen = bindings, set[str](), set[str]()

    def visit_Attribute(self, node: ast.Attribute) -> None:
        parts, inner = [node.attr], node.value
        while isinstance(inner, ast.Attribute):
            parts.append(inner.attr)
            inner = inner.value
        if isinstance(inner, ast.Name):
            self._note(inner.id, parts[::-1])
        else:
            self.visit(inner)

    def visit_Name(self, node: ast.Name) -> None:
        self._note(node.id, [])

    def _note(self, local: str, attributes: list[str]) -> None:
        if local in self.bindings:
            self.seen.add(local)
            self.used |= {".".join([name, *attributes]) for name in self.bindings[local]}


def _bindings(tree: ast.Module, module: str, package: bool) -> dict[str, frozenset[str]]:
    """Local names and the full names that they are imported from; one may mean several, in several functions."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                first = alias.name.partition(".")[0]
                found[alias.asname or first].add(alias.name if alias.asname else first)
        elif isinstance(node, ast.ImportFrom):
            parts = module.split(".")
            above = parts[: len(parts) - node.level + package] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                found[alias.asname or alias.name].add(base if alias.name == "*" else f"{base}.{alias.name}")
    return {local: frozenset(names) for local, names in found.items()}


@cache
def _parse(text: str) -> ast.Module:
    try:
        return ast.parse(text)
    except SyntaxError:
        # Said where it is imported.
        return ast.Module([], [])
