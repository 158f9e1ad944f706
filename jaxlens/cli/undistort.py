"""`jaxlens undistort`: a picture without its lens."""

from dataclasses import dataclass

from jaxlens.cli.warping import WarpArguments, warp_pictures

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
  jaxlens undistort a.tif --kappa 0.03 --center 1210.5 803 --output b.tif
  jaxlens undistort a.jpg --lens lens.json --model own.lenses:Mine -o b.jpg"""


@dataclass(frozen=True)
class Arguments(WarpArguments):
    """Remove a lens from a picture."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    return warp_pictures(arguments, "undistort")
