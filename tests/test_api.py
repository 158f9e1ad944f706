"""The policy of the public interface: lazy, annotated, documented, options by keyword."""

import ast
import inspect
import pathlib
import subprocess
import sys

import pytest

import jaxlens as jl

PACKAGE = pathlib.Path(jl.__file__).parent
MODULES = {name: module for name in jl.__all__ if inspect.ismodule(module := getattr(jl, name))}


def public_names():
    names = {name: getattr(jl, name) for name in jl.__all__ if name not in MODULES}
    for module_name, module in MODULES.items():
        for name in getattr(module, "__all__", vars(module)):
            value = getattr(module, name)
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


def test_every_name_is_there():
    for name in jl.__all__:
        assert getattr(jl, name) is not None
    with pytest.raises(AttributeError, match="No jaxlens attribute undistrot"):
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


# The packages and modules directly below `jaxlens`, from the top of the design's list down; those of a row are peers,
# and may see each other.
LAYERS = (
    ("numerics", "memory", "batching", "newton", "polynomials", "linear", "interpolation"),
    ("frames", "maps"),
    ("lenses",),
    ("deformations",),
    ("pyramid", "sampling", "warping"),
    ("diagnostics", "cameras"),
    ("metrics",),
    ("profiles",),
    ("fitting", "self_calibration"),
    ("surfaces",),
    ("files", "columns"),
    ("images", "calibrations", "meshes"),
    ("figures",),
    ("experiments",),
    ("cli",),
    ("__main__",),
)
DEPTHS = {name: depth for depth, names in enumerate(LAYERS) for name in names}
PURE = [name for names in LAYERS[: LAYERS.index(("files", "columns"))] for name in names]


def imports():
    """(file, module or package directly below `jaxlens`, imported name in full), for every import there is."""
    for path in sorted(PACKAGE.rglob("*.py")):
        where = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                yield from ((path, where[0], alias.name) for alias in node.names)
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: imports are written in full"
                yield from ((path, where[0], f"{node.module}.{alias.name}") for alias in node.names)


def test_every_module_has_a_layer():
    there = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert set(DEPTHS) == there - {"__init__"}


def test_each_layer_imports_only_from_those_above_it():
    for path, here, imported in imports():
        package, *rest = imported.split(".")
        if here != "__init__" and package == "jaxlens" and rest and rest[0] in DEPTHS:
            assert DEPTHS[rest[0]] <= DEPTHS[here], f"{path}: {here} stands above {rest[0]}"


def test_the_core_knows_no_files():
    """What is below the line in the design is not seen from above, nor are the libraries that read and draw."""
    for path, here, imported in imports():
        if here in PURE:
            assert not imported.startswith(("imageio", "PIL", "contourpy", "matplotlib", "tifffile", "trimesh")), path


def test_private_names_do_not_cross_a_package():
    for path, here, imported in imports():
        package, *rest = imported.split(".")
        private = [part for part in rest if part.startswith("_") and not part.startswith("__")]
        assert package != "jaxlens" or not private or rest[0] == here, f"{path}: {imported} is private"


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


# What these compute with is no option: left out, it is the identity.
OPERANDS = {"pose", "rotation"}
# And a size is given in full, or not at all.
SIZES = {("Calibration.camera", name) for name in ("height", "width")}


@pytest.mark.parametrize("name", [*CALLABLES, *CONSTRUCTORS])
def test_options_are_given_by_keyword(name):
    for parameter in inspect.signature((CALLABLES | CONSTRUCTORS)[name]).parameters.values():
        if parameter.name in OPERANDS or (name, parameter.name) in SIZES:
            continue
        if parameter.default is not inspect.Parameter.empty:
            assert parameter.kind is inspect.Parameter.KEYWORD_ONLY, parameter.name
