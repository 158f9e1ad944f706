"""All experiments of a folder, one after another, and the page of their results; what is up to date stays."""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxlens.experiments import config, runner
from jaxlens.experiments.config import Configuration
from jaxlens.experiments.errors import ConfigError, ExperimentError
from jaxlens.experiments.folders import read_manifest, read_record
from jaxlens.experiments.gallery import Section, check_page, write_page
from jaxlens.experiments.manifests import input_checksums, package_versions
from jaxlens.files import file_sha256

PAGE = "index.html"
UNRECORDED = "there is no record of the run that made them"
"""Why results that came with a clone are made again. It says nothing against them."""
State = Literal["up to date", "done", "skipped", "failed", "left out"]


@dataclass(frozen=True)
class Step:
    """An experiment among others, and what became of it.

    Attributes:
        configuration: The experiment.
        folder: Of its results.
        state: `up to date`: there was nothing to do. `done`: it was run. `skipped`: a file that it reads is missing.
            `failed`: see the reason. `left out`: it was not asked for.
        reason: Why its results are not those of this configuration, source and these inputs; empty if they are.
        seconds: What it took.
        error: What ended it.
    """

    configuration: Configuration
    folder: Path
    state: State
    reason: str = ""
    seconds: float = 0.0
    error: Exception | None = None

    @property
    def name(self) -> str:
        """The experiment's name."""
        return self.configuration.experiment.name


@dataclass(frozen=True)
class Reproduction:
    """What all experiments left behind.

    Attributes:
        steps: In the order of the page.
        page: The file that shows them all.
    """

    steps: tuple[Step, ...]
    page: Path


def reproduce(
    configs: Sequence[str | os.PathLike[str]],
    *,
    output: str | os.PathLike[str] = "results",
    only: Sequence[str] = (),
    force: bool = False,
    console: Console | None = None,
    progress: Console | None = None,
    quiet: bool = False,
    self_contained: bool = False,
) -> Reproduction:
    """Runs experiments whose results are not up to date, and writes one page of all results.

    Results are up to date where their manifest names the same configuration (captions left out) and the same input
    files, where every file that it lists is there unchanged, and where the record of their run (`run.json`, which Git
    ignores) names the same versions of the packages that it computes with and the same source of every module that
    the run imported, of jaxlens and beside the configuration. The commit is not compared, nor the machine. In a new
    clone there is no record, so everything is run.

    An experiment that reads a file that is not there is skipped. One that fails does not stop the others. When the
    work is interrupted, what is finished stays, and the next call goes on from there; the page is written at the end.

    Args:
        configs: TOML files of experiments, and folders of them, which are not searched deeper.
        output: The folder of the page; each experiment's results go to a folder of its name in it.
        only: Names of the experiments to run; all by default. The page shows all.
        force: Run them even if they are up to date.
        console: Where the summary is printed; stdout by default.
        progress: Where it is told what is going on; stderr by default.
        quiet: Print neither.
        self_contained: Have the page hold its figures, so that it can be sent alone; else it links them.

    Returns:
        What became of each experiment.

    Raises:
        ConfigError: a configuration is wrong, two have one name, or a name is unknown; nothing was begun.
        ExperimentError: something else is in the place of the folder or of the page (nothing was begun), or the page
            cannot be written.
    """
    output = Path(output)
    configurations = _find(configs)
    _check_names(only, configurations)
    if output.exists() and not output.is_dir():
        raise ExperimentError(f"{str(output)!r} is not a folder; choose another place for the results")
    check_page(output / PAGE)
    if quiet:
        console = progress = Console(quiet=True)
    console = Console(highlight=False) if console is None else console
    progress = Console(stderr=True, highlight=False) if progress is None else progress
    steps = []
    for configuration in configurations:
        name = configuration.experiment.name
        step = _take(configuration, output / name, asked=not only or name in only, force=force, progress=progress)
        if step.state != "left out":
            progress.print(Text(_line(step)))
        steps.append(step)
    write_page(output / PAGE, [_section(step) for step in steps], embed=self_contained)
    console.print(_summary(steps))
    console.print(Text(f"{output / PAGE}: {(output / PAGE).stat().st_size / 1e6:.1f} MB"), soft_wrap=True)
    return Reproduction(tuple(steps), output / PAGE)


def out_of_date(configuration: Configuration, folder: Path) -> str | None:
    """Says why an experiment's results are not what it would give now; None if they are.

    Args:
        configuration: The experiment; the files that it reads are there.
        folder: Of its results.

    Raises:
        ExperimentError: an input cannot be read.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return "there are no results yet"
    if manifest.get("configuration_sha256") != configuration.digest():
        return "the configuration has changed"
    if manifest.get("input_files") != input_checksums(configuration):
        return "an input has changed"
    files = manifest.get("files")
    if not isinstance(files, dict):
        return "the manifest lists no files"
    for name, checksum in files.items():
        if not (folder / name).is_file() or file_sha256(folder / name) != checksum:
            return f"{name} is missing or has changed"
    record = read_record(folder)
    if record is None:
        return UNRECORDED
    now, was = configuration.kind.sources(), record.get("sources")
    if now != was:
        changed = [name for name in now if not isinstance(was, dict) or was.get(name) != now[name]]
        return f"the source has changed: {', '.join(changed[:3])}" + (", …" if len(changed) > 3 else "")
    versions = record.get("versions")
    for package, version in package_versions().items():
        # The source says more than jaxlens's version.
        was = versions.get(package) if isinstance(versions, dict) else None
        if package != "jaxlens" and was != version:
            return f"{package} is {version}, and was {was}"
    return None


def _find(configs: Sequence[str | os.PathLike[str]]) -> list[Configuration]:
    """Reads every configuration, and tells of every mistake at once."""
    files: dict[Path, Path] = {}
    for path in map(Path, configs):
        found = sorted(path.glob("*.toml")) if path.is_dir() else [path]
        if not found:
            raise ConfigError(f"there is no experiment's TOML file in the folder {str(path)!r}")
        files |= {file.resolve(): file for file in found}
    configurations, mistakes = [], []
    for file in files.values():
        try:
            configurations.append(config.load(file, inputs=False))
        except ConfigError as error:
            mistakes.append(str(error))
    named: dict[str, Configuration] = {}
    for configuration in configurations:
        # Without regard to case, as some file systems see names.
        other = named.setdefault(configuration.experiment.name.casefold(), configuration)
        if other is not configuration:
            name = configuration.experiment.name
            mistakes.append(f"{configuration.path}: name: got {name!r}; {other.path} has it already, choose another")
    if mistakes:
        raise ConfigError("\n".join(mistakes))
    return sorted(configurations, key=lambda one: (one.experiment.order, one.experiment.name))


def _check_names(only: Sequence[str], configurations: Sequence[Configuration]) -> None:
    names = [configuration.experiment.name for configuration in configurations]
    for name in only:
        if name not in names:
            raise ConfigError(f"there is no experiment {name!r}; there are {', '.join(names)}")


def _take(configuration: Configuration, folder: Path, *, asked: bool, force: bool, progress: Console) -> Step:
    """Runs an experiment, if there is a reason to and nothing against it."""
    missing = configuration.missing_input()
    try:
        stale = missing or out_of_date(configuration, folder) or ""
    except (ExperimentError, OSError) as error:
        # Met again, and told, when it is run.
        stale = str(error)
    if not asked:
        return Step(configuration, folder, "left out", stale)
    if missing is not None:
        return Step(configuration, folder, "skipped", missing)
    if not stale and not force:
        return Step(configuration, folder, "up to date")
    name = configuration.experiment.name
    file = configuration.kind.file
    what = "" if file is None else f" {file}"
    progress.print(Text(f"{name}: running{what}" + (f" ({stale})" if stale else "")))
    begin = time.perf_counter()
    quiet = Console(quiet=True)
    try:
        # A bar is for a terminal.
        bar = progress if progress.is_terminal else quiet
        runner.run(configuration.path, output=folder, console=quiet, progress=bar)
    except Exception as error:
        foreseen = isinstance(error, ConfigError | ExperimentError)
        reason = str(error) if foreseen else f"unexpected {type(error).__name__}: {error}"
        return Step(configuration, folder, "failed", reason, time.perf_counter() - begin, error)
    return Step(configuration, folder, "done", seconds=time.perf_counter() - begin)


def _section(step: Step) -> Section:
    manifest = read_manifest(step.folder)
    if manifest is not None and manifest.get("experiment") != step.name:
        manifest = None
    note = ""
    if step.reason and step.reason != UNRECORDED:
        state = "Failed" if step.state == "failed" else "Not run"
        earlier = "\nWhat is shown are earlier results." if manifest else ""
        note = f"{state}: {step.reason.removeprefix(f'{step.configuration.path}: ')}.{earlier}"
    return Section(step.configuration.experiment, step.configuration.path.name, step.folder, manifest, note)


def _line(step: Step) -> str:
    took = f" in {step.seconds:.1f} s" if step.state == "done" else ""
    return f"{step.name}: {step.state}{took}" + (f": {step.reason}" if step.reason else "")


def _summary(steps: Sequence[Step]) -> Table:
    # With NumPy behind it, which a mistake in a configuration does not wait for.
    from jaxlens.experiments.reports import new_table

    table = new_table("Experiments")
    for name in ("name", "state", "seconds", ""):
        table.add_column(name, justify="right" if name == "seconds" else "left")
    for step in steps:
        seconds = f"{step.seconds:.1f}" if step.seconds else ""
        table.add_row(Text(step.name), step.state, seconds, Text(step.reason))
    return table
