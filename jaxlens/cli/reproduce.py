"""`jaxlens reproduce`: run all experiments of a folder, and write the page of their results."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from jaxlens.cli.inputs import check_path
from jaxlens.cli.messages import CommandError, UsageError, describe_unexpected, say, wants_traceback
from jaxlens.cli.options import Names, Paths, words

HELP = """Run all experiments, and write one page of their figures, tables and parameters.

What it does:
  Results that are up to date stay: same configuration, inputs, modules
  imported and package versions, and no file changed. What fails or lacks an input is named,
  and the others are done. Interrupted, it goes on from there the next time.
  The page, index.html in the results' folder, links the figures beside it;
  with --self-contained it holds them, and can be sent alone.

Examples:
  jaxlens reproduce experiments/
  jaxlens reproduce experiments/ --only table1 grids --force
  jaxlens reproduce my.toml other.toml --output my-results"""


_FOLDER = Paths([Path("experiments")])
_ALL = Names()


@dataclass(frozen=True)
class Arguments:
    """Run all experiments, and write the page of their results."""

    configs: Annotated[
        Paths, Positional, words(Paths, "CONFIG..."), arg(help_behavior_hint="(default: experiments)")
    ] = _FOLDER
    """Experiments, TOML files, or folders of them, which are not searched deeper."""

    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = Path("results")
    """The folder for the page, and for a folder of results for each experiment."""

    only: Annotated[Names, words(Names, "NAME [NAME ...]"), arg(help_behavior_hint="(default: all)")] = _ALL
    """Run only these experiments, by the names in their files; the page still shows all."""

    force: Annotated[bool, arg(help_behavior_hint="")] = False
    """Run them even if their results are up to date."""

    self_contained: Annotated[bool, arg(help_behavior_hint="")] = False
    """Put the figures into the page, instead of links to them."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    for path in arguments.configs:
        check_path(path)
    from rich.console import Console

    from jaxlens import experiments

    try:
        done = experiments.reproduce(
            arguments.configs,
            output=arguments.output,
            only=arguments.only,
            force=arguments.force,
            self_contained=arguments.self_contained,
            console=Console(highlight=False),
        )
    except experiments.ConfigError as error:
        raise UsageError(str(error)) from error
    except experiments.ExperimentError as error:
        raise CommandError(str(error)) from error
    failed = [step for step in done.steps if step.state == "failed"]
    for step in failed:
        foreseen = isinstance(step.error, experiments.ConfigError | experiments.ExperimentError)
        if step.error is not None and not foreseen:
            if wants_traceback():
                raise step.error
            say(f"{step.name}: {describe_unexpected(step.error)}")
    if failed:
        say(f"{len(failed)} of {len(done.steps)} experiments failed: {', '.join(step.name for step in failed)}")
    return 1 if failed else 0
