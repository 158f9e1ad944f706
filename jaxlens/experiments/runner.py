"""Running an experiment: configuration in, results' folder out."""

import os
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.text import Text

from jaxlens.experiments import config
from jaxlens.experiments.folders import check_target, result_folder


@dataclass(frozen=True)
class Report:
    """What a run left behind.

    Attributes:
        name: Of the experiment.
        folder: With the results.
        files: In it, the manifest and the record of the run included, sorted by name.
        manifest: As written to `manifest.json`: what was run, on what, and what came out.
        record: As written to `run.json`: when, where, on which source and versions, and how long it took.
    """

    name: str
    folder: Path
    files: tuple[Path, ...]
    manifest: dict[str, object]
    record: dict[str, object]


def run(
    config_path: str | os.PathLike[str],
    *,
    image: str | os.PathLike[str] | None = None,
    output: str | os.PathLike[str] | None = None,
    console: Console | None = None,
    progress: Console | None = None,
    quiet: bool = False,
) -> Report:
    """Runs an experiment and writes its folder of results.

    A kind of experiment that is not built in is a Python file beside the configuration, which is imported and run.
    Everything is written to a temporary folder first: a run that fails or is interrupted leaves earlier results as they
    were. Global state of JAX and matplotlib is left alone.

    Args:
        config_path: The experiment's TOML file.
        image: A picture file in place of the configured image: the whole picture, with the configured gray and peak.
        output: The folder of results; `results/<name>` under the current folder by default.
        console: Where the report is printed; stdout by default.
        progress: Where the progress bar is drawn; stderr by default.
        quiet: Print neither.

    Raises:
        ConfigError: the configuration, or the image in its place, is wrong; nothing was begun.
        ExperimentError: it could not be carried out, or something else is in the way of its results.
    """
    configuration = config.load(config_path, image=image)
    experiment = configuration.experiment
    folder = Path("results") / experiment.name if output is None else Path(output)
    check_target(Path(os.path.realpath(folder)), experiment.name)

    if quiet:
        console = progress = Console(quiet=True)
    console = Console() if console is None else console
    progress = Console(stderr=True) if progress is None else progress

    if configuration.kind.file is not None:
        console.print(Text(f"kind {experiment.kind}: {configuration.kind.file}"), soft_wrap=True)

    # JAX and matplotlib are imported when nothing is left to complain about.
    import jax

    from jaxlens.experiments.manifests import input_checksums, write_manifest, write_record
    from jaxlens.figures.style import style

    input_files = input_checksums(configuration)
    begin = time.perf_counter()
    with result_folder(folder, experiment.name) as temporary:
        with jax.enable_x64(experiment.dtype == "float64"), style():
            outcome = experiment.run(configuration, temporary, progress)
        manifest = write_manifest(
            temporary, configuration, input_files=input_files, inputs=outcome.inputs, facts=outcome.facts
        )
        record = write_record(temporary, configuration, seconds=time.perf_counter() - begin)
    for renderable in outcome.report:
        console.print(renderable)
    files = tuple(sorted(folder.iterdir()))
    console.print(f"\n{len(files)} files in {folder}", markup=False, highlight=False)
    return Report(experiment.name, folder, files, manifest, record)
