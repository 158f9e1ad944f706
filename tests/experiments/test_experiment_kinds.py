"""A kind of experiment is a file beside its configuration: how it is found, which source its results depend on."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from paper_kinds import EXPERIMENTS

from jaxlens import experiments
from jaxlens.experiments import ConfigError, config, reproduce, run
from jaxlens.experiments.finding import find_kind
from jaxlens.experiments.imports import PACKAGE, Source, imported

KIND = '''
"""How large a lens makes a square."""

from typing import TYPE_CHECKING

import numpy as np

import jaxlens as jl
from jaxlens.experiments import Experiment, Outcome, write_csv

from .numbers import side

if TYPE_CHECKING:
    from jaxlens.experiments import Configuration


class Square(Experiment):
    """A square through a lens."""

    k: float

    def run(self, configuration: "Configuration", folder, progress):
        """Moves its corner."""
        corner = jl.RadialPolynomial([self.k]).distort(np.array([side(), side()]))
        write_csv(folder, {"x": [float(corner[0])], "dtype": [str(corner.dtype)]})
        return Outcome([], {"k": self.k}, ["The square is drawn."])
'''
CONFIG = 'kind = "square"\nname = "s"\nk = 0.5\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a kind of its own, and a module that this imports."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "square.py").write_text(KIND)
    (folder / "numbers.py").write_text("def side():\n    return 1.0\n")
    (folder / "s.toml").write_text(CONFIG)
    return folder


def test_a_new_kind_is_one_file_and_is_named_before_it_runs(folder: Path, capsys: pytest.CaptureFixture[str]):
    before = list(sys.path)
    report = run("mine/s.toml")
    assert (report.folder / "table.csv").read_text() == "x,dtype\n2,float64\n"
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == ["kind square: mine/square.py", "The square is drawn."]
    assert sys.path == before
    assert list(report.manifest["configuration"]) == ["name", "dtype", "seed", "kind", "k"]
    with pytest.raises(ConfigError, match="kind = 'square' takes no picture"):
        config.load("mine/s.toml", image="square.py")


def test_a_kind_may_be_a_folder(folder: Path):
    (folder / "square").mkdir()
    (folder / "square.py").rename(folder / "square" / "__init__.py")
    (folder / "square" / "__init__.py").write_text(KIND.replace(".numbers", "..numbers"))
    assert run("mine/s.toml", quiet=True).files
    assert find_kind("square", Path("mine")).file == Path("mine/square/__init__.py")


def states() -> list[str]:
    (step,) = reproduce(["mine"], quiet=True).steps
    return [step.state, step.reason]


def test_results_are_stale_when_a_module_that_ran_has_changed_and_not_when_another_has(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    assert states() == ["done", ""]
    assert states() == ["up to date", ""]
    (folder / "beside_it.py").write_text("")
    (folder / "square.py").write_text(KIND.replace("class", "# A comment is source, too.\nclass"))
    configuration = config.load("mine/s.toml")
    assert experiments.reproduction.out_of_date(configuration, Path("results/s")) == (
        "the source has changed: beside.square"
    )
    assert states() == ["done", ""]
    (folder / "numbers.py").write_text("def side():\n    return 2.0\n")
    assert states() == ["done", ""]
    assert Path("results/s/table.csv").read_text() == "x,dtype\n10,float64\n"
    other = Source("edited")
    for name, stale in {
        "jaxlens.images.exif": False,
        "jaxlens.lenses._division": False,
        "jaxlens.experiments.gallery.page": False,
        "jaxlens.experiments.sweep.scoring": False,
        "jaxlens.lenses._radial_polynomial": True,
        "jaxlens.numerics": True,
        "jaxlens.experiments.tables": True,
        "jaxlens.experiments.runner": True,
    }.items():
        with monkeypatch.context() as patch:
            patch.setitem(PACKAGE, name, other)
            said = experiments.reproduction.out_of_date(config.load("mine/s.toml"), Path("results/s"))
        assert said == (f"the source has changed: {name}" if stale else None)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("square.py", "import jaxlens\n1 / 0\n", "mine/square.py, line 2: ZeroDivisionError"),
        ("square.py", KIND.replace("class Square", "class"), "mine/square.py, line 17: SyntaxError"),
        ("square.py", "import no_such_library\n", "mine/square.py, line 1: ModuleNotFoundError"),
        ("square.py", "raise SystemExit(3)\n", "mine/square.py, line 1: SystemExit: 3"),
        ("numbers.py", "\n\nside = none\n", "mine/numbers.py, line 3: NameError: name 'none'"),
        ("square.py", "\0", "mine.*: .*null bytes"),
        ("square.py", "x = 1\n", "mine/square.py: must define one subclass .* and defines none"),
        ("square.py", KIND + "class Other(Experiment): ...\n", "defines Square, Other"),
        ("square.py", "\xff", None),
    ],
)
def test_a_file_that_is_no_kind_is_refused(folder: Path, name: str, text: str, said: str | None):
    (folder / name).write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError, match=said or "mine/square.py or a file that it imports cannot be read") as caught:
        config.load("mine/s.toml")
    assert str(caught.value).startswith("mine/s.toml: kind: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "kind", ["Square", "../mine/square", "mine.square", "square.py", "", "_square", "squäre", "os", "link", "out"]
)
def test_elsewhere_nothing_is_looked_for(folder: Path, kind: str):
    (folder.parent / "out").mkdir()
    (folder.parent / "out" / "__init__.py").write_text(KIND)
    os.symlink(folder.parent / "out" / "__init__.py", folder / "link.py")
    os.symlink(folder.parent / "out", folder / "out")
    (folder / "_square.py").write_text(KIND)
    (folder / "s.toml").write_text(CONFIG.replace("square", kind))
    with pytest.raises(ConfigError, match=r"'sweep'.*: 'numbers', 'square'$") as caught:
        config.load(folder / "s.toml")
    assert repr(kind) in str(caught.value)


KINDS = sorted(
    {path.stem for path in EXPERIMENTS.glob("*.py")} | {path.parent.name for path in EXPERIMENTS.glob("*/*.py")}
)


@pytest.mark.parametrize("kind", ["sweep", *KINDS])
def test_nothing_heavy_is_imported_to_check_a_file(kind: str):
    code = (
        "import sys\nfrom pathlib import Path\nfrom jaxlens.experiments.finding import find_kind\n"
        f"find_kind({kind!r}, Path({str(EXPERIMENTS)!r})).sources()\n"
        "print(sorted({'jax', 'matplotlib', 'equinox', 'PIL'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", sorted(EXPERIMENTS.rglob("*.py")), ids=lambda path: path.stem)
def test_the_papers_kinds_use_public_names_alone(path: Path):
    """Of jaxlens they import names of the public lists, and none that begins with an underscore is used as its."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            assert all(alias.name == "jaxlens" for alias in node.names if alias.name.startswith("jaxlens"))
        if isinstance(node, ast.ImportFrom) and node.level == 0 and str(node.module).startswith("jaxlens"):
            module = __import__(str(node.module), fromlist=["__all__"])
            public = getattr(module, "__all__", [name for name in dir(module) if not name.startswith("_")])
            assert {alias.name for alias in node.names} <= {*public, "experiments", "figures"}
            assert "._" not in str(node.module)
        if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__"):
            assert isinstance(node.value, ast.Name), ast.unparse(node)
            assert node.value.id in ("self", "cls"), ast.unparse(node)


def sources(**texts: str):
    """A package of modules, by their texts; a name with `__init__` at its end is a package."""
    return {
        name.replace("__", ".").removesuffix(".init"): Source(text, name.endswith("__init"))
        for name, text in texts.items()
    }


def test_names_that_are_handed_on_stand_for_their_modules():
    package = sources(
        p__init="from p.one import a as a\nfrom p import two as two",
        p__one="from p.three import f",
        p__two="x = 1",
        p__three="def f():\n    from p.four import g",
        p__four="",
    )
    cases = {
        "from p import a": {"p.one", "p.three", "p.four"},
        "import p\np.a.b": {"p.one", "p.three", "p.four"},
        "import p as q\nq.two.x": {"p.two"},
        "import p\nprint(p.a, p)": set(package),
        "import p": set(package),
        "from p import *": set(package),
        "from p.two import x": {"p.two"},
        "from numpy import p": set(),
    }
    for text, expected in cases.items():
        known = package | sources(start=text)
        assert set(imported("start", known.get)) == {"start"} | expected, text


RUN = """
import sys
from pathlib import Path
import jaxlens
from jaxlens.experiments import config, run
package, ran = str(Path(jaxlens.__file__).parent), set()
def note(frame, event, argument):
    code = frame.f_code
    if event == "call" and code.co_name not in ("<module>", "__getattr__") and code.co_filename.startswith(package):
        # The body of a class runs when its module is imported.
        if "__qualname__" not in code.co_names:
            ran.add(code.co_filename)
sys.setprofile(note)
run(sys.argv[1], quiet=True)
sys.setprofile(None)
names = {".".join(Path(path).relative_to(Path(package).parent).with_suffix("").parts) for path in ran}
names = {name.removesuffix(".__init__") for name in names}
print(*sorted(names - set(config.load(sys.argv[1]).kind.sources())))
"""


def test_every_module_whose_functions_run_is_counted(tmp_path: Path, folder: Path):
    """But for what happens when lenses are defined, and registered, on import."""
    done = subprocess.run([sys.executable, "-c", RUN, "mine/s.toml"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
