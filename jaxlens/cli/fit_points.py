"""`jaxlens fit points`: a lens from correspondences."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.estimation import (
    FitArguments,
    check_fit_arguments,
    check_normalized,
    deliver,
    fitting,
    frame_and_unit,
    model_lens,
)
from jaxlens.cli.inputs import check_file, read_columns

HELP = """Find the lens that takes ideal points to observed ones.

What it does:
  Reads a CSV file with the columns ideal_x, ideal_y, observed_x, observed_y
  and, if there is one, weight (an inverse variance). With --image-size they
  are pixels, in Eq. 10's frame; without, normalized coordinates. Prints the
  coefficients with their standard errors.

Examples:
  jaxlens fit points points.csv --image-size 640x480 --output lens.json
  jaxlens fit points points.csv --terms 3 --fit-center --loss cauchy --plots fit/"""


@dataclass(frozen=True)
class Arguments(FitArguments):
    """Find the lens that takes ideal points to observed ones."""

    file: Annotated[Path, Positional, arg(metavar="FILE.csv", help_behavior_hint="")]
    """The correspondences."""

    image_size: options.ImageSize = None
    fit_center: options.FitCenter = False

    fit_scale: Annotated[bool, arg(help_behavior_hint="")] = False
    """Fit one factor on the size of the observed points, too."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_fit_arguments(arguments)
    check_file(arguments.file)
    size = None if arguments.image_size is None else options.parse_size(arguments.image_size, "--image-size")
    columns = read_columns(arguments.file, ("ideal_x", "ideal_y", "observed_x", "observed_y"), optional=("weight",))
    check_normalized(size, columns, ("ideal_x", "ideal_y", "observed_x", "observed_y"))
    import numpy as np

    from jaxlens.fitting import fit_points

    with fitting():
        ideal = np.stack([columns["ideal_x"], columns["ideal_y"]], axis=-1)
        observed = np.stack([columns["observed_x"], columns["observed_y"]], axis=-1)
        frame, unit = frame_and_unit(size)
        fit = fit_points(
            model_lens(arguments),
            frame.normalize(ideal),
            observed,
            frame=frame,
            weights=np.asarray(columns["weight"]) if "weight" in columns else None,
            center=arguments.fit_center,
            scale=arguments.fit_scale,
            loss=arguments.loss,
        )
        figures = None
        if arguments.plots is not None:
            from jaxlens.figures.fits import curve_figure, residual_figure

            figures = {
                "residuals": residual_figure(observed, np.asarray(fit.residuals), fit, unit),
                "curve": curve_figure(fit, np.asarray(frame.normalize(ideal)), unit),
            }
        deliver(arguments, fit, size, figures)
    return 0
