"""Calibration files for the commands: errors in the words of the command line."""

from pathlib import Path
from typing import TYPE_CHECKING

from jaxlens.calibrations import Calibration, CalibrationError, read_calibration, write_calibration
from jaxlens.cli.errors import CommandError, UsageError

if TYPE_CHECKING:
    from jaxlens.fitting import Fit


def load_calibration(path: Path) -> Calibration:
    """Reads a calibration, and makes its lens once.

    Raises:
        UsageError: the file is no calibration, or one of no lens.
    """
    try:
        calibration = read_calibration(path)
    except CalibrationError as error:
        raise UsageError(str(error)) from error
    try:
        calibration.lens()
    except CalibrationError as error:
        raise UsageError(f"{str(path)!r}: {error}") from error
    return calibration


def save_fit(path: Path, fit: "Fit", image_size: tuple[int, int] | None, *, overwrite: bool) -> None:
    """Writes a fit as a calibration.

    Raises:
        CommandError: the file exists, or cannot be written.
    """
    try:
        write_calibration(path, Calibration.from_fit(fit, image_size=image_size), overwrite=overwrite)
    except FileExistsError:
        raise CommandError(f"{str(path)!r} exists; pass --overwrite to replace it") from None
    except (CalibrationError, OSError) as error:
        raise CommandError(f"cannot write {str(path)!r}: {error}") from error
