"""From an experiment to the function that performs it."""

from pathlib import Path

from rich.console import Console

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.figures.style import style
from jaxlens.experiments.kinds.boards import perform_boards
from jaxlens.experiments.kinds.grids import perform_grids
from jaxlens.experiments.kinds.inversion import perform_inversion
from jaxlens.experiments.kinds.outcome import Outcome
from jaxlens.experiments.kinds.panels import perform_panels
from jaxlens.experiments.kinds.readings import perform_readings
from jaxlens.experiments.kinds.sweeps import perform_sweep
from jaxlens.experiments.schema import (
    BoardsExperiment,
    GridsExperiment,
    InversionExperiment,
    PanelsExperiment,
    ReadingsExperiment,
)


def perform(configuration: Configuration, folder: Path, progress: Console) -> Outcome:
    """Carries out an experiment and writes its tables and figures into a folder."""
    experiment = configuration.experiment
    with style():
        if isinstance(experiment, GridsExperiment):
            return perform_grids(experiment, folder)
        if isinstance(experiment, ReadingsExperiment):
            return perform_readings(configuration, experiment, folder, progress)
        if isinstance(experiment, PanelsExperiment):
            return perform_panels(configuration, experiment, folder, progress)
        if isinstance(experiment, InversionExperiment):
            return perform_inversion(configuration, experiment, folder, progress)
        if isinstance(experiment, BoardsExperiment):
            return perform_boards(configuration, experiment, folder, progress)
        return perform_sweep(configuration, experiment, folder, progress)
