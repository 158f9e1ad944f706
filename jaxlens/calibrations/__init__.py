"""Calibrations as files: a lens with its frame and what is known about it, in JSON that says what it means."""

from jaxlens.calibrations._calibration import Calibration as Calibration
from jaxlens.calibrations._calibration import CalibrationError as CalibrationError
from jaxlens.calibrations._calibration import Estimate as Estimate
from jaxlens.calibrations._corners import read_corners as read_corners
from jaxlens.calibrations._lens_json import read_calibration as read_calibration
from jaxlens.calibrations._lens_json import write_calibration as write_calibration
