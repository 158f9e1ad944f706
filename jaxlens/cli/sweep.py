"""`jaxlens sweep`: run an experiment from its configuration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli.inputs import check_file
from jaxlens.cli.messages import CommandError, UsageError

HELP = """Run an experiment: lenses over an image, with table, figures and manifest.

What it does:
  The configuration is a TOML file; `experiments/` holds those of the paper.
  A kind of experiment that is not built in is a Python file beside it, which
  is run: a folder of experiments is a program.
  What comes out replaces the same experiment's earlier output; a folder that
  holds anything else is refused.

Examples:
  jaxlens sweep experiments/table1.toml
  jaxlens sweep experiments/table1.toml --image me.png --output results/me"""


@dataclass(frozen=True)
class Arguments:
    """Run an experiment from its configuration."""

    config: Annotated[Path, Positional, arg(metavar="CONFIG", help_behavior_hint="")]
    """The experiment, a TOML file."""

    image: Annotated[Optional[Path], arg(metavar="FILE", help_behavior_hint="(default: the configuration's)")] = None
    """Another picture to run it on."""

    output: Annotated[
        Optional[Path], arg(metavar="DIR", aliases=["-o"], help_behavior_hint="(default: results/ and its name)")
    ] = None
    """The folder for the results, which is made if need be."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_file(arguments.config)
    if arguments.image is not None:
        check_file(arguments.image)
    from rich.console import Console

    from jaxlens import experiments

    try:
        experiments.run(
            arguments.config, image=arguments.image, output=arguments.output, console=Console(highlight=False)
        )
    except experiments.ConfigError as error:
        raise UsageError(str(error)) from error
    except experiments.ExperimentError as error:
        raise CommandError(str(error)) from error
    return 0
