"""`jaxlens distort`: the picture that a lens would take."""

from dataclasses import dataclass

from jaxlens.cli.warping import WarpArguments, warp_pictures

HELP = """Make the picture that a lens would take of an undistorted one.

What it does:
  Each pixel is looked up at its exact preimage under x_d = x_u Φ(|x_u|²).
  Where there is none it takes the fill value; a lens that folds inside the
  picture is warned of. Colour profile and EXIF are kept and the orientation
  is applied. Alpha is warped too, with colours averaged by their opacity.
  `jaxlens undistort` is the way back.

Examples:
  jaxlens distort portrait.png --kappa -0.2 0.05 --output barrel.png
  jaxlens distort photos/ --kappa 0.3 --output distorted/ --crop
  jaxlens distort a.tif b.tif --kappa 5e-2 --output out/ --antialias"""


@dataclass(frozen=True)
class Arguments(WarpArguments):
    """Make the picture that a lens would take."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    return warp_pictures(arguments, "distort")
