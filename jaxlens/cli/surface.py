"""`jaxlens surface`: a picture as a landscape, or a mesh as a shaded picture and a depth map."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.depth_maps import View, check_view, load_surface
from jaxlens.cli.inputs import check_file, gray_values, is_mesh, read_picture
from jaxlens.cli.messages import UsageError, say
from jaxlens.cli.outputs import check_new_file, write_figure, write_picture

# Those of jaxlens.figures.surfaces, which imports matplotlib; a test holds them together.
Drawing = Literal["mesh", "filled", "isolines"]

HELP = """Draw a picture as a landscape, or show a mesh from the front.

What it does:
  A picture becomes a surface, its light places high, as in Figures 1 and 8 of
  the paper. A mesh (OBJ, PLY, STL) is lit from the upper left and seen along
  −z; --depth writes its depth map, a float TIFF in pixels, as jaxlens geodesic
  reads them, NaN where there is nothing.

Examples:
  jaxlens surface portrait.jpg --output landscape.png
  jaxlens surface portrait.jpg --style filled --smoothing 4 --output filled.png
  jaxlens surface head.obj --size 600x800 --output head.png --depth depth.tif"""


@dataclass(frozen=True)
class Arguments(View):
    """Draw a picture as a landscape, or show a mesh from the front."""

    file: Annotated[Path, Positional, arg(metavar="FILE", help_behavior_hint="")]
    """A picture, or a mesh (OBJ, PLY, STL)."""

    output: Annotated[Path, arg(metavar="FILE.png", aliases=["-o"])]
    """The drawing."""

    style: Drawing = "mesh"
    """Of a landscape: a net, the picture's own grays under a light, or lines of equal height."""

    smoothing: Annotated[float, arg(metavar="PIXELS")] = 11.5
    """Of a landscape: the standard deviation of the Gaussian that heights are smoothed with."""

    perspective: Annotated[float, arg(metavar="0-0.7")] = 0.22
    """Of a landscape: 1 / the viewer's distance in half diagonals; 0 is parallel projection."""

    azimuth: Annotated[float, arg(metavar="DEGREES")] = 25.0
    """Of a landscape: how far it is turned, seen from above."""

    elevation: Annotated[float, arg(metavar="DEGREES")] = 50.0
    """Of a landscape: how high the viewer stands; 90 looks straight down."""

    depth: Annotated[Optional[Path], arg(metavar="FILE.tif", help_behavior_hint="")] = None
    """Of a mesh: write its depth map, too."""

    overwrite: options.Overwrite = False
    max_pixels: options.MaxPixels = None


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_file(arguments.file)
    options.check_max_pixels(arguments.max_pixels)
    check_view(arguments)
    check_new_file(arguments.output, overwrite=arguments.overwrite, suffixes=(".png",))
    if arguments.depth is not None:
        check_new_file(arguments.depth, overwrite=arguments.overwrite, suffixes=(".tif", ".tiff"), option="--depth")
    if not 0 <= arguments.perspective < 0.7:
        raise UsageError(f"--perspective is from 0 to below 0.7, got {arguments.perspective:g}")
    for name, low, high, unit in (
        ("smoothing", 0, 10_000, "pixels"),
        ("azimuth", -360, 360, "degrees"),
        ("elevation", -360, 360, "degrees"),
    ):
        value = getattr(arguments, name)
        if not low <= value <= high:
            raise UsageError(f"--{name} is from {low} to {high} {unit}, got {value:g}")
    if is_mesh(arguments.file):
        _show_mesh(arguments)
    else:
        if arguments.depth is not None:
            raise UsageError("--depth is for meshes; leave it out")
        _draw_landscape(arguments)
    say(f"wrote {str(arguments.output)!r}")
    return 0


def _draw_landscape(arguments: Arguments) -> None:
    import numpy as np

    from jaxlens.figures.surfaces import surface_figure

    gray, white = gray_values(read_picture(arguments.file, arguments.max_pixels))
    missing = ~np.isfinite(gray)
    if missing.any():
        say(f"warning: {missing.sum()} pixels of {str(arguments.file)!r} are not finite, and are drawn as black")
        gray = np.where(missing, 0, gray)
    figure = surface_figure(
        gray,
        white,
        drawings=(arguments.style,),
        smoothing=arguments.smoothing,
        perspective=arguments.perspective,
        azimuth=arguments.azimuth,
        elevation=arguments.elevation,
    )
    write_figure(arguments.output, figure, overwrite=arguments.overwrite)


def _show_mesh(arguments: Arguments) -> None:
    import numpy as np

    from jaxlens.images import Picture
    from jaxlens.surfaces import shade

    loaded = load_surface(arguments.file, arguments, arguments.max_pixels)
    surface, normals = loaded.depth_map, loaded.normals
    pixels = np.round(255 * np.clip(np.asarray(shade(surface, normals=normals)), 0, 1)).astype(np.uint8)
    write_picture(arguments.output, Picture(pixels), overwrite=arguments.overwrite)
    if arguments.depth is not None:
        spacing = float(surface.spacing[0])
        depth = np.where(np.asarray(surface.mask), np.asarray(surface.depth) / spacing, np.nan).astype(np.float32)
        write_picture(arguments.depth, Picture(depth), overwrite=arguments.overwrite)
        say(f"wrote {str(arguments.depth)!r}; a pixel is {spacing:.6g} of the mesh's units")
