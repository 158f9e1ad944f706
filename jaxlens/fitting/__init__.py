"""Least-squares fits: from what was observed back to the lens, with honest uncertainties."""

from jaxlens.fitting._boards import Boards as Boards
from jaxlens.fitting._boards import HeldOut as HeldOut
from jaxlens.fitting._boards import calibrate as calibrate
from jaxlens.fitting._boards import evaluate as evaluate
from jaxlens.fitting._curve import distortion_curve as distortion_curve
from jaxlens.fitting._images import fit_images as fit_images
from jaxlens.fitting._lines import fit_lines as fit_lines
from jaxlens.fitting._points import fit_points as fit_points
from jaxlens.fitting._poses import Poses as Poses
from jaxlens.fitting._result import Fit as Fit
from jaxlens.fitting._result import FitError as FitError
from jaxlens.fitting._result import FitStatus as FitStatus
from jaxlens.fitting._result import FitWarning as FitWarning
