"""`jaxlens undistort`: a picture without its lens."""

from dataclasses import dataclass

from jaxlens.cli.jobs import plan_jobs
from jaxlens.cli.options import WarpArguments, check_options

HELP = """Remove a lens from a picture.

What it does:
  Each pixel is an ideal point x_u, and is looked up where the lens has put
  it, x_d = x_u Φ(|x_u|²). What the lens never saw takes the fill value; a
  lens that folds inside the picture is warned of. Colour profile and EXIF
  are kept and the orientation is applied. Alpha is warped too, with colours
  averaged by their opacity. `jaxlens distort` is the way back.

Examples:
  jaxlens undistort photo.jpg --kappa -0.2 0.05 --output straight.jpg
  jaxlens undistort photos/ --kappa -0.2 0.05 --output straight/ --crop
  jaxlens undistort a.tif --kappa 0.03 --center 1210.5 803 --output b.tif"""


@dataclass(frozen=True)
class Arguments(WarpArguments):
    """Remove a lens from a picture."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_options(arguments)
    jobs = plan_jobs(arguments.files, arguments.output)
    from jaxlens.cli.batch import warp_files

    return warp_files(jobs, arguments, "undistort")
