"""Calibrations as files: a lens with its frame and what is known about it, in our JSON and in everybody's formats."""

from jaxlens.calibrations._calibration import Calibration as Calibration
from jaxlens.calibrations._calibration import CalibrationError as CalibrationError
from jaxlens.calibrations._calibration import Estimate as Estimate
from jaxlens.calibrations._corners import read_corners as read_corners
from jaxlens.calibrations._formats import formats as formats
from jaxlens.calibrations._formats import read as read
from jaxlens.calibrations._formats import read_calibration as read_calibration
from jaxlens.calibrations._formats import write as write
from jaxlens.calibrations._formats import write_calibration as write_calibration
