"""What an experiment's TOML file may say: one model a kind of experiment, and the tables that they share.

Only pydantic is imported here, so that a mistake in a file is reported before anything heavy is loaded.
"""

from jaxlens.experiments.schema.figures import ControlPointMove as ControlPointMove
from jaxlens.experiments.schema.figures import FreeFormExperiment as FreeFormExperiment
from jaxlens.experiments.schema.figures import NoiseExperiment as NoiseExperiment
from jaxlens.experiments.schema.figures import ProjectionsExperiment as ProjectionsExperiment
from jaxlens.experiments.schema.figures import SurfacePlotExperiment as SurfacePlotExperiment
from jaxlens.experiments.schema.paper import GridsExperiment as GridsExperiment
from jaxlens.experiments.schema.paper import PanelsExperiment as PanelsExperiment
from jaxlens.experiments.schema.paper import ReadingsExperiment as ReadingsExperiment
from jaxlens.experiments.schema.paper import SweepExperiment as SweepExperiment
from jaxlens.experiments.schema.studies import BoardModel as BoardModel
from jaxlens.experiments.schema.studies import BoardsExperiment as BoardsExperiment
from jaxlens.experiments.schema.studies import GeodesicsExperiment as GeodesicsExperiment
from jaxlens.experiments.schema.studies import InversionExperiment as InversionExperiment
from jaxlens.experiments.schema.studies import Noise as Noise
from jaxlens.experiments.schema.studies import RotationExperiment as RotationExperiment
from jaxlens.experiments.schema.studies import Rotations as Rotations
from jaxlens.experiments.schema.studies import Surface as Surface
from jaxlens.experiments.schema.studies import UnknownExperiment as UnknownExperiment
from jaxlens.experiments.schema.tables import MOST_LENSES as MOST_LENSES
from jaxlens.experiments.schema.tables import Axis as Axis
from jaxlens.experiments.schema.tables import Common as Common
from jaxlens.experiments.schema.tables import Crop as Crop
from jaxlens.experiments.schema.tables import Image as Image
from jaxlens.experiments.schema.tables import Kappa as Kappa
from jaxlens.experiments.schema.tables import Lenses as Lenses
from jaxlens.experiments.schema.tables import Name as Name
from jaxlens.experiments.schema.tables import Table as Table
from jaxlens.experiments.schema.tables import Warp as Warp

Experiment = (
    SweepExperiment
    | ReadingsExperiment
    | GridsExperiment
    | PanelsExperiment
    | InversionExperiment
    | BoardsExperiment
    | SurfacePlotExperiment
    | FreeFormExperiment
    | ProjectionsExperiment
    | NoiseExperiment
    | GeodesicsExperiment
    | RotationExperiment
    | UnknownExperiment
)
KINDS: dict[str, type[Experiment]] = {
    "sweep": SweepExperiment,
    "readings": ReadingsExperiment,
    "grids": GridsExperiment,
    "panels": PanelsExperiment,
    "inversion": InversionExperiment,
    "boards": BoardsExperiment,
    "surface_plot": SurfacePlotExperiment,
    "free_form": FreeFormExperiment,
    "projections": ProjectionsExperiment,
    "noise": NoiseExperiment,
    "geodesics": GeodesicsExperiment,
    "rotation": RotationExperiment,
    "unknown": UnknownExperiment,
}
