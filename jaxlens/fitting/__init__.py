"""Least-squares fits: from what was observed back to the lens, with honest uncertainties."""

from jaxlens.fitting._boards import Boards as Boards
from jaxlens.fitting._boards import Validation as Validation
from jaxlens.fitting._boards import calibrate as calibrate
from jaxlens.fitting._boards import calibrated_parameters as calibrated_parameters
from jaxlens.fitting._boards import validate as validate
from jaxlens.fitting._conversion import Conversion as Conversion
from jaxlens.fitting._conversion import convert as convert
from jaxlens.fitting._curve import distortion_curve as distortion_curve
from jaxlens.fitting._images import fit_images as fit_images
from jaxlens.fitting._lines import fit_lines as fit_lines
from jaxlens.fitting._points import fit_points as fit_points
from jaxlens.fitting._poses import Poses as Poses
from jaxlens.fitting._poses import rotation_matrix as rotation_matrix
from jaxlens.fitting._problem import Knowledge as Knowledge
from jaxlens.fitting._problem import Minimum as Minimum
from jaxlens.fitting._problem import Problem as Problem
from jaxlens.fitting._problem import assess as assess
from jaxlens.fitting._problem import minimize as minimize
from jaxlens.fitting._problem import report as report
from jaxlens.fitting._result import Fit as Fit
from jaxlens.fitting._result import FitError as FitError
from jaxlens.fitting._result import FitStatus as FitStatus
from jaxlens.fitting._result import FitWarning as FitWarning
from jaxlens.fitting._robust import Loss as Loss
from jaxlens.fitting._solver import Unknowns as Unknowns
