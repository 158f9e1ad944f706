"""From an experiment to the function that performs it."""

from pathlib import Path

from rich.console import Console

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.kinds.boards import perform_boards
from jaxlens.experiments.kinds.free_form import perform_free_form
from jaxlens.experiments.kinds.geodesics import perform_geodesics
from jaxlens.experiments.kinds.grids import perform_grids
from jaxlens.experiments.kinds.inversion import perform_inversion
from jaxlens.experiments.kinds.noise import perform_noise
from jaxlens.experiments.kinds.outcome import Outcome
from jaxlens.experiments.kinds.panels import perform_panels
from jaxlens.experiments.kinds.projections import perform_projections
from jaxlens.experiments.kinds.readings import perform_readings
from jaxlens.experiments.kinds.rotation import perform_rotation
from jaxlens.experiments.kinds.surface_plots import perform_surface_plot
from jaxlens.experiments.kinds.sweeps import perform_sweep
from jaxlens.experiments.kinds.unknown import perform_unknown
from jaxlens.experiments.schema import (
    BoardsExperiment,
    FreeFormExperiment,
    GeodesicsExperiment,
    GridsExperiment,
    InversionExperiment,
    NoiseExperiment,
    PanelsExperiment,
    ProjectionsExperiment,
    ReadingsExperiment,
    RotationExperiment,
    SurfacePlotExperiment,
    UnknownExperiment,
)
from jaxlens.figures.style import style


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
        if isinstance(experiment, SurfacePlotExperiment):
            return perform_surface_plot(configuration, experiment, folder)
        if isinstance(experiment, FreeFormExperiment):
            return perform_free_form(configuration, experiment, folder, progress)
        if isinstance(experiment, ProjectionsExperiment):
            return perform_projections(configuration, experiment, folder)
        if isinstance(experiment, NoiseExperiment):
            return perform_noise(configuration, experiment, folder)
        if isinstance(experiment, GeodesicsExperiment):
            return perform_geodesics(configuration, experiment, folder, progress)
        if isinstance(experiment, RotationExperiment):
            return perform_rotation(experiment, folder, progress)
        if isinstance(experiment, UnknownExperiment):
            return perform_unknown(experiment, folder, progress)
        return perform_sweep(configuration, experiment, folder, progress)
