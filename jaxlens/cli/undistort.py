"""`jaxlens undistort`: a picture without its lens."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import arg

from jaxlens.cli import options
from jaxlens.cli.outputs import check_new_file
from jaxlens.cli.views import View
from jaxlens.cli.warping import WarpArguments, warp_pictures

HELP = """Remove a lens from a picture.

What it does:
  Each pixel is an ideal point x_u, and is looked up where the lens has put
  it, x_d = x_u Φ(|x_u|²). What the lens never saw takes the fill value; a
  lens that folds inside the picture is warned of. Colour profile and EXIF
  are kept and the orientation is applied. Alpha is warped too, with colours
  averaged by their opacity. `jaxlens distort` is the way back.

  --view, --fov, --size and --projection choose what the result shows;
  --camera-output keeps its camera, which has no lens any more.

Examples:
  jaxlens undistort photo.jpg --kappa -0.2 0.05 --output straight.jpg
  jaxlens undistort photos/ --kappa -0.2 0.05 --output straight/ --crop
  jaxlens undistort a.tif --kappa 0.03 --center 1210.5 803 --output b.tif
  jaxlens undistort a.jpg --lens lens.json --model own.lenses:Mine -o b.jpg
  jaxlens undistort a.jpg --lens camera.json --view valid -o b.jpg \\
      --camera-output straight.json
  jaxlens undistort a.jpg --lens fisheye.json --projection equirectangular \\
      --fov 180 --size 2048x1024 -o panorama.jpg"""


@dataclass(frozen=True)
class Arguments(WarpArguments):
    """Remove a lens from a picture."""

    view: Annotated[Optional[options.Keep], arg(help_behavior_hint="(default: same)")] = None
    """What to show: the same as before in the middle, only what was seen (no border), or all that was seen."""

    fov: Annotated[Optional[float], arg(metavar="DEGREES", help_behavior_hint="")] = None
    """The horizontal field of the result, in place of --view; its axis is then in the middle."""

    size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: the picture's)")] = None
    """The size of the result in pixels."""

    projection: options.ViewProjection = "perspective"
    """What the result is drawn on; perspective shows less than 180 degrees."""

    camera_output: Annotated[Optional[Path], arg(metavar="FILE.json", help_behavior_hint="")] = None
    """Write the camera of the results, for --lens and jaxlens.calibrations; of a folder's pictures it is one."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    size = None if arguments.size is None else options.parse_size(arguments.size, "--size")
    view = View(arguments.view or "same", arguments.fov, size, arguments.projection)
    if arguments.camera_output is not None:
        check_new_file(
            arguments.camera_output, overwrite=arguments.overwrite, suffixes=(".json",), option="--camera-output"
        )
    return warp_pictures(arguments, "undistort", view, arguments.camera_output)
