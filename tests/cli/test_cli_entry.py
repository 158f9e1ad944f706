import ast
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args

import pytest

import jaxlens
from jaxlens.cli import entry, inputs, options
from jaxlens.cli.entry import COMMANDS, main
from jaxlens.cli.messages import CommandError, UsageError
from jaxlens.images import DEFAULT_MAX_PIXELS

ROOT = Path(__file__).parents[2]
HEAVY = {"jax", "numpy", "matplotlib", "imageio", "PIL", "tifffile", "pydantic", "equinox", "rich", "typeguard"}
LIST_MODULES = """
import json, sys
from jaxlens.cli import main
try:
    code = main(sys.argv[1:])
finally:
    print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})), file=sys.stderr)
sys.exit(code)
"""


def imported_by(*arguments):
    """The exit code of a command, and what packages it imported."""
    environment = {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"}
    done = subprocess.run(
        [sys.executable, "-c", LIST_MODULES, *arguments], capture_output=True, text=True, env=environment, timeout=60
    )
    return done.returncode, set(json.loads(done.stderr.splitlines()[-1])), done.stdout


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_imports_nothing_heavy(command):
    code, modules, out = imported_by(*(command or "").split(), "--help")
    assert code == 0
    assert not modules & HEAVY
    assert "Examples:" in out
    assert f"jaxlens {command or 'sweep'} " in out


def test_version_and_wrong_arguments_import_nothing_heavy():
    code, modules, out = imported_by("--version")
    assert code == 0
    assert not modules & (HEAVY | {"tyro"})
    assert out.startswith("jaxlens ")
    code, modules, out = imported_by("distort", "no.png", "--kappa", "0.1", "--output", "out.png")
    assert code == 2
    assert not modules & HEAVY
    assert out == ""


def test_a_configuration_is_judged_without_jax(tmp_path):
    (tmp_path / "wrong.toml").write_text("no = 'experiment'\n")
    code, modules, out = imported_by("sweep", str(tmp_path / "wrong.toml"))
    assert code == 2
    assert not modules & {"jax", "jaxlib", "matplotlib"}
    assert out == ""


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["--nonsense"],
        ["distort"],
        ["distort", "a.png", "--kappa", "0.1"],
        ["distort", "a.png", "--output", "b.png"],
        ["compare", "a.png"],
        ["sweep"],
        ["sweep", "a.toml", "--nonsense", "1"],
    ],
)
def test_wrong_arguments(run, arguments):
    result = run(*arguments)
    assert result.code == 2
    assert result.out == ""
    assert result.err


def test_the_process_itself(run_process):
    result = run_process("--version")
    assert result.code == 0
    assert result.out.startswith("jaxlens ")
    assert result.err == ""
    result = run_process("distort", "no.png", "--kappa", "nan", "--output", "out.png")
    assert result.code == 2
    assert "nan" in result.err


def test_help_on_a_terminal_without_greek():
    environment = {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-m", "jaxlens", "distort", "--help"]
    done = subprocess.run(command, capture_output=True, env=environment, timeout=60)
    assert done.returncode == 0
    assert done.stderr == b""


def test_a_reader_that_has_gone():
    read, write = os.pipe()
    os.close(read)
    environment = {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"}
    command = [sys.executable, "-m", "jaxlens", "--help"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, env=environment, timeout=60)
    os.close(write)
    assert done.returncode == 141
    assert done.stderr == b""


@pytest.mark.parametrize(
    ("raised", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (UsageError("no such thing"), 2, "no such thing"),
        (CommandError("the disk is full"), 1, "the disk is full"),
        (MemoryError(), 1, "not enough memory"),
        (ZeroDivisionError("division by zero"), 1, "JAXLENS_TRACEBACK"),
    ],
)
def test_exit_codes(monkeypatch, run, raised, code, message):
    def fail(*_):
        raise raised

    monkeypatch.setattr(entry, "_parse", fail)
    monkeypatch.delenv("JAXLENS_TRACEBACK", raising=False)
    result = run("distort")
    assert result.code == code
    assert message in result.err
    assert result.out == ""


def test_a_traceback_on_demand(monkeypatch):
    def fail(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(entry, "_parse", fail)
    monkeypatch.setenv("JAXLENS_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        main(["distort"])


WAIT = {
    "in Python": "time.sleep(60)",
    # Where what the signal raises is ignored.
    "in a finalizer": "(type('Late', (), {'__del__': lambda _: time.sleep(60)})(), None)[1] or time.sleep(60)",
    # A loop that never ends, in one call into XLA: Python does not get to raise for a signal.
    "in XLA": "jax.block_until_ready(jax.jit(lambda: jax.lax.while_loop(lambda x: x < 2, lambda x: x + 1e-9, 1.0))())",
}
INTERRUPTED = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background of a script
import jax
import jaxlens.cli.warping as warping
from jaxlens.files import atomic_write
def write_slowly(path, picture, **_):
    with atomic_write(path) as temporary:
        temporary.write_bytes(b"half")
        {wait}
warping.write_picture = write_slowly
warping._warped = lambda picture, *_: picture
sys.argv = ["jaxlens", "distort", "in.ppm", "--kappa", "0.1", "--output", "out/"]
from jaxlens.cli import main
sys.exit(main())
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("wait", WAIT)
def test_an_interruption_leaves_nothing(tmp_path, number, code, wait):
    # The writer waits in the middle of its file, which is there under its temporary name.
    (tmp_path / "in.ppm").write_bytes(b"P6 1 1 255\nabc")
    environment = {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"}
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED.format(wait=WAIT[wait])],
        cwd=tmp_path,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob("out/.*.ppm")):
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(0 if wait == "in Python" else 1)
        process.send_signal(number)
        _, err = process.communicate(timeout=10)
    finally:
        process.kill()
    assert process.returncode == code
    assert "Traceback" not in err
    assert ("interrupted" in err) == (number == signal.SIGINT)
    assert [path.name for path in tmp_path.iterdir()] == ["in.ppm"]


def test_the_help_of_an_option_is_of_whole_sentences():
    """A line of a docstring is a line of the help: one that ends within a sentence breaks off there."""
    seen = 0
    for path in sorted((ROOT / "jaxlens" / "cli").glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for owner in (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)):
            for field, text in itertools.pairwise(owner.body):
                if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                    lines = ast.literal_eval(text.value).splitlines()
                    _check_sentences(lines, f"{path.name}, {ast.unparse(field.target)}")
                    seen += 1
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            if ast.unparse(call.func) == "_shared":
                _check_sentences(ast.literal_eval(call.args[0]).splitlines(), path.name)
                seen += 1
    assert seen > 60


def _check_sentences(lines, where):
    broken = [line for line in lines if not line.endswith(".") or len(line) < 12]
    assert not broken, f"{where}: {broken}"


NEW_COMMAND = '''
from dataclasses import dataclass

HELP = """Greet somebody.

Examples:
  jaxlens greet"""


@dataclass(frozen=True)
class Arguments:
    """Greet somebody."""

    name: str = "nobody"
    """Whom to greet."""


def run(arguments):
    print(f"hello {arguments.name}")
    return 0
'''


def test_a_new_command_is_a_file_and_a_line(run, tmp_path, monkeypatch):
    (tmp_path / "greet.py").write_text(NEW_COMMAND)
    monkeypatch.setattr("jaxlens.cli.__path__", [*jaxlens.cli.__path__, str(tmp_path)])
    monkeypatch.setattr(entry, "COMMANDS", (*COMMANDS, "greet"))
    try:
        assert run("greet", "--name", "them").out == "hello them\n"
        assert "Greet somebody." in run("--help").out
        assert "Whom to greet." in run("greet", "--help").out
    finally:
        sys.modules.pop("jaxlens.cli.greet", None)


def test_choices_are_those_of_the_library():
    from jaxlens import cameras, meshes, sampling

    assert get_args(options.Keep) == get_args(cameras.Keep)
    assert get_args(options.ViewProjection) == get_args(cameras.ViewProjection)
    assert get_args(options.Method) == get_args(sampling.Method)
    assert get_args(options.Border) == get_args(sampling.Border)
    assert inputs._MESHES == meshes.SUFFIXES


def test_the_limit_named_in_the_help(run):
    assert DEFAULT_MAX_PIXELS == 200_000_000
    assert "200 million" in run("distort", "--help").out


def test_names_that_are_not_public():
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = jaxlens.nothing_of_the_kind
    with pytest.raises(ImportError):
        exec("from jaxlens import nothing_of_the_kind")
