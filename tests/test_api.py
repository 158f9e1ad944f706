"""The policy of the public interface: lazy, annotated, documented, options by keyword."""

import ast
import inspect
import pathlib
import subprocess
import sys

import pytest

import jaxlens as jl
from jaxlens import (
    calibrations,
    deformations,
    diagnostics,
    fitting,
    images,
    maps,
    metrics,
    projections,
    self_calibration,
    surfaces,
)

PACKAGE = pathlib.Path(jl.__file__).parent
MODULES = {
    "calibrations": calibrations,
    "deformations": deformations,
    "diagnostics": diagnostics,
    "fitting": fitting,
    "images": images,
    "metrics": metrics,
    "projections": projections,
    "self_calibration": self_calibration,
    "surfaces": surfaces,
}


def public_names():
    names = {name: getattr(jl, name) for name in jl.__all__ if name not in MODULES}
    for module_name, module in MODULES.items():
        for name, value in vars(module).items():
            if not name.startswith("_") and getattr(value, "__module__", "").startswith(module.__name__):
                names[f"{module_name}.{name}"] = value
    return names


PUBLIC = public_names()
FUNCTIONS = {name: value for name, value in PUBLIC.items() if not inspect.isclass(value)}
CLASSES = {name: value for name, value in PUBLIC.items() if inspect.isclass(value)}


def own_methods(cls):
    """Public methods and properties that a class of ours defines, or inherits from one of ours."""
    for base in cls.__mro__:
        if base.__module__.startswith("jaxlens"):
            for name, value in vars(base).items():
                if not name.startswith("_") or name == "__call__":
                    if isinstance(value, classmethod | staticmethod):
                        value = value.__func__
                    if isinstance(value, property):
                        value = value.fget
                    if callable(getattr(value, "__wrapped__", value)) and hasattr(value, "__qualname__"):
                        yield f"{base.__name__}.{name}", getattr(value, "__wrapped__", value)


METHODS = {name: method for cls in CLASSES.values() for name, method in own_methods(cls)}
CALLABLES = {name: inspect.unwrap(function) for name, function in (FUNCTIONS | METHODS).items()}
# Constructors written by hand; those that equinox or dataclasses write are lists of fields, documented on the class.
CONSTRUCTORS = {
    name: inspect.unwrap(vars(cls)["__init__"])
    for name, cls in CLASSES.items()
    if "def __init__" in inspect.getsource(cls)
}


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()


def test_the_list_for_tools_is_the_list_for_the_interpreter():
    """`__init__` names everything twice: under TYPE_CHECKING with its module, and as text."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    guarded = next(node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test))
    typed = {}
    for statement in guarded.body:
        for alias in statement.names:
            assert alias.asname == alias.name, "re-exports are written `name as name`"
            typed[alias.name] = statement.module
    expected = dict.fromkeys(jl._MODULES, "jaxlens")
    expected |= {name: f"jaxlens.{module}" for module, names in jl._NAMES.items() for name in names}
    assert typed == expected
    assert jl.__all__ == sorted(expected)
    assert set(jl.__all__) <= set(dir(jl))


def test_every_name_is_there():
    for name in jl.__all__:
        assert getattr(jl, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'undistrot'"):
        jl.undistrot  # noqa: B018


def test_importing_is_light():
    assert run("import sys, jaxlens; print(*[m for m in ('jax', 'numpy', 'equinox') if m in sys.modules])") == []


def test_importing_changes_no_global_switch():
    code = """
import jax
before = {name: jax.config.values[name] for name in jax.config.values}
import jaxlens
[getattr(jaxlens, name) for name in jaxlens.__all__]
print(*[name for name in before if jax.config.values[name] != before[name]])
"""
    assert run(code) == []


def test_the_core_knows_no_files():
    """Each layer imports only from those above it: what is below the line in the design is not seen from above."""
    core = [*PACKAGE.glob("*.py")]
    for folder in ("deformations", "fitting", "lenses", "metrics"):
        core += (PACKAGE / folder).glob("*.py")
    below = ("jaxlens.images", "jaxlens.experiments", "jaxlens.cli", "jaxlens.files", "imageio", "PIL", "matplotlib")
    for path in core:
        if path.name in ("__init__.py", "__main__.py", "files.py") and path.parent == PACKAGE:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            imported = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            imported += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not [name for name in imported if name.startswith(below)], path


@pytest.mark.parametrize("name", [*PUBLIC, *METHODS])
def test_every_name_is_documented(name):
    documentation = inspect.getdoc((PUBLIC | METHODS)[name])
    assert documentation
    assert documentation.splitlines()[0].rstrip().endswith((".", ":")), "the first line is a sentence"


@pytest.mark.parametrize("name", [*CALLABLES, *CONSTRUCTORS])
def test_every_argument_and_result_is_annotated(name):
    signature = inspect.signature((CALLABLES | CONSTRUCTORS)[name])
    for parameter in signature.parameters.values():
        if parameter.name not in ("self", "cls"):
            assert parameter.annotation is not inspect.Parameter.empty, parameter.name
    assert name in CONSTRUCTORS or signature.return_annotation is not inspect.Signature.empty


@pytest.mark.parametrize("name", [*CALLABLES, *CONSTRUCTORS])
def test_options_are_given_by_keyword(name):
    for parameter in inspect.signature((CALLABLES | CONSTRUCTORS)[name]).parameters.values():
        if parameter.default is not inspect.Parameter.empty:
            assert parameter.kind is inspect.Parameter.KEYWORD_ONLY, parameter.name


@pytest.mark.parametrize("name", [name for name, value in CLASSES.items() if issubclass(value, maps.CoordinateMap)])
def test_every_map_keeps_the_contract(name):
    for method in ("__call__", "invert", "preimages", "one_to_one", "jacobian", "jacobian_determinant", "inverse"):
        assert callable(getattr(CLASSES[name], method))
