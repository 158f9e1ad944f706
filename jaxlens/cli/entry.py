"""The way in and out of every command: arguments to a command, exceptions to exit codes.

| exit code | meaning |
|---|---|
| 0 | done |
| 1 | something failed at work; of many pictures, the others are done |
| 2 | the arguments are wrong; nothing was begun |
| 130 | interrupted, or (143, 129) told to end; nothing is left half-written |
| 141 | whoever read the output has stopped reading |
"""

import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NoReturn

from jaxlens.cli.messages import CommandError, describe_unexpected, say, wants_traceback
from jaxlens.cli.signals import leave, obey_signals

COMMANDS = (
    "sweep",
    "reproduce",
    "distort",
    "undistort",
    "deform",
    "compare",
    "fit points",
    "fit lines",
    "fit images",
    "calibrate",
    "inspect",
    "surface",
    "geodesic",
)
"""In the order of the help; each is a module here, its words joined by `_`, with `Arguments`, `HELP` and `run`."""

_HELP = """Lenses for pictures: apply a lens, remove it, find it, compare, run the experiments.

Examples:
  jaxlens undistort photo.jpg --kappa -0.2 0.05 --output straight.jpg
  jaxlens distort photos/ --kappa 0.3 --output distorted/ --crop
  jaxlens compare photo.jpg straight.jpg
  jaxlens fit images photo.jpg distorted.jpg --output lens.json
  jaxlens calibrate boards/*.jpg --board 9x6 --output camera.json
  jaxlens inspect camera.json --output camera.png
  jaxlens sweep experiments/table1.toml
  jaxlens reproduce experiments/
  jaxlens distort --help
  jaxlens --version"""
_FIT_HELP = """Find a lens by least squares, from what it did.

Examples:
  jaxlens fit points points.csv --image-size 640x480 --output lens.json
  jaxlens fit lines lines.csv --image-size 640x480 --fit-center
  jaxlens fit images portrait.png distorted.png --plots fit/
  jaxlens fit points --help"""
_INTERRUPTED = 130
_BROKEN_PIPE = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        arguments: What follows the program's name. Without them those of the process are taken, and the process
            is made the command's own: its libraries' noise is silenced, and a signal to end cleans up first.

    Returns:
        The exit code, see above. Messages go to stderr, results to stdout; no exception leaves.
    """
    own = arguments is None
    try:
        if own:
            _own_process()
        code = _dispatch(sys.argv[1:] if arguments is None else list(arguments), own)
        if sys.stdout is not None:
            # Here, where a failure still gets a message.
            sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        say("interrupted")
        if own:
            leave(_INTERRUPTED)
        return _INTERRUPTED
    except SystemExit as end:
        # By a signal: others do not come here.
        if not own:
            raise
        leave(end.code if isinstance(end.code, int) else 1)
    except BrokenPipeError:
        _abandon_stdout()
        return _BROKEN_PIPE
    except CommandError as error:
        say(str(error))
        return error.exit_code
    except Exception as error:
        if wants_traceback():
            raise
        say(describe_unexpected(error))
        return 1


def _dispatch(arguments: list[str], own: bool) -> int:
    if arguments == ["--version"]:
        print(f"jaxlens {_version()}")  # noqa: T201
        return 0
    try:
        run, parsed = _parse(arguments)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 2
    if own:
        _silence_libraries()
    return run(parsed)


def _parse(arguments: list[str]) -> tuple[Callable[[Any], int], Any]:
    """Returns the command's function and its arguments.

    Raises:
        SystemExit: the help was asked for (0) or the arguments are wrong (2); what there is to say is said.
    """
    import tyro

    config = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    name = next((name for name in COMMANDS if arguments[: len(name.split())] == name.split()), None)
    if name is not None:
        # Only the command that is meant is imported and explained.
        command, rest = _command(name), arguments[len(name.split()) :]
        parsed = tyro.cli(command.Arguments, prog=f"jaxlens {name}", description=command.HELP, args=rest, config=config)
        return command.run, parsed
    # What is left is a group of commands, its help, or nothing that there is.
    group = arguments[0] if arguments and any(name.startswith(f"{arguments[0]} ") for name in COMMANDS) else ""
    members = [name for name in COMMANDS if name.startswith(group)]
    tyro.extras.subcommand_cli_from_dict(
        {name.removeprefix(group).strip(): _command(name).Arguments for name in members},
        prog=f"jaxlens {group}".strip(),
        description=_FIT_HELP if group else _HELP,
        args=arguments[1:] if group else arguments,
        config=config,
    )
    _not_a_command(arguments)


def _not_a_command(arguments: list[str]) -> NoReturn:
    say(f"a command comes first ({', '.join(COMMANDS)}), got {arguments[:2]}; see jaxlens --help")
    raise SystemExit(2)


def _command(name: str) -> Any:
    return import_module(f"jaxlens.cli.{name.replace(' ', '_')}")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("jaxlens")
    except PackageNotFoundError:
        return "(run from its source, not installed)"


def _own_process() -> None:
    """Sets what a library must not touch, but a program may."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    # A program that warps a picture has no business with three quarters of a shared accelerator's memory.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    if sys.stdout is not None:
        # Help and tables hold Greek letters, and terminals there are that do not.
        sys.stdout.reconfigure(errors="replace")  # pyright: ignore[reportAttributeAccessIssue]
    obey_signals()


def _silence_libraries() -> None:
    """Keeps from stderr the log lines that nobody asked for: what people must know, the commands say."""
    import logging

    logging.getLogger().addHandler(logging.NullHandler())


def _abandon_stdout() -> None:
    """Keeps the interpreter from complaining, at its end, of what it can no longer write."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
