"""`jaxlens fit lines`: a lens from lines that ought to be straight."""

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

HELP = """Find the lens that makes lines straight again.

What it does:
  Reads a CSV file with the columns line, x, y: points, and the number of the
  line that each is on, in any order. With --image-size they are pixels, in
  Eq. 10's frame; without, normalized coordinates.

Examples:
  jaxlens fit lines lines.csv --image-size 640x480 --fit-center
  jaxlens fit lines lines.csv --image-size 640x480 --model division -o lens.json"""


@dataclass(frozen=True)
class Arguments(FitArguments):
    """Find the lens that makes lines straight again."""

    file: Annotated[Path, Positional, arg(metavar="FILE.csv", help_behavior_hint="")]
    """The points on lines."""

    image_size: options.ImageSize = None
    fit_center: options.FitCenter = False


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_fit_arguments(arguments)
    check_file(arguments.file)
    size = None if arguments.image_size is None else options.parse_size(arguments.image_size, "--image-size")
    columns = read_columns(arguments.file, ("line", "x", "y"))
    check_normalized(size, columns, ("x", "y"))
    import numpy as np

    from jaxlens.fitting import fit_lines

    with fitting():
        number, points = np.asarray(columns["line"]), np.stack([columns["x"], columns["y"]], axis=-1)
        lines = [points[number == one] for one in np.unique(number)]
        frame, unit = frame_and_unit(size)
        fit = fit_lines(
            model_lens(arguments),
            lines,
            frame=frame,
            center=arguments.fit_center,
            search=arguments.start is None,
            loss=arguments.loss,
        )
        figures = None
        if arguments.plots is not None:
            from jaxlens.figures.fits import curve_figure, lines_figure

            figures = {
                "lines": lines_figure(lines, np.asarray(fit.residuals), fit, unit),
                "curve": curve_figure(fit, np.asarray(frame.normalize(points)), unit),
            }
        deliver(arguments, fit, size, figures)
    return 0
