"""`jaxlens surface`: a picture as a landscape, or a mesh as a shaded picture and a depth map."""

# Optional[X] for the same reason as in `jaxlens.cli.options`.
# ruff: noqa: UP045

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Optional

from tyro.conf import Positional, arg

from jaxlens.cli.errors import UsageError
from jaxlens.cli.meshes import is_mesh
from jaxlens.cli.messages import say
from jaxlens.cli.options import check_file, check_max_pixels
from jaxlens.cli.surfaces import View, check_view, load_surface

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

    overwrite: Annotated[bool, arg(help_behavior_hint="")] = False
    """Replace files that exist."""

    max_pixels: Annotated[Optional[int], arg(metavar="COUNT", help_behavior_hint="(default: 200 million)")] = None
    """Refuse pictures with more pixels, before they are decoded."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_file(arguments.file)
    check_max_pixels(arguments.max_pixels)
    check_view(arguments)
    for path, suffixes in ((arguments.output, (".png",)), (arguments.depth, (".tif", ".tiff"))):
        if path is not None:
            _check_output(path, suffixes, arguments.overwrite)
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


def _check_output(path: Path, suffixes: tuple[str, ...], overwrite: bool) -> None:
    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{str(path)!r} must end in {' or '.join(suffixes)}")
    if path.is_dir() or not path.parent.is_dir():
        raise UsageError(f"{str(path)!r} must be a file in a folder that exists")
    if path.exists() and not overwrite:
        raise UsageError(f"{str(path)!r} exists; pass --overwrite to replace it")


def _draw_landscape(arguments: Arguments) -> None:
    import numpy as np

    from jaxlens.cli.figures import save_figure
    from jaxlens.cli.pictures import read_picture
    from jaxlens.cli.surfaces import gray_values
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
    save_figure(arguments.output, figure, overwrite=arguments.overwrite)


def _show_mesh(arguments: Arguments) -> None:
    import numpy as np

    from jaxlens.cli.pictures import write_picture
    from jaxlens.images import Picture
    from jaxlens.surfaces import shade

    loaded = load_surface(arguments.file, arguments, arguments.max_pixels)
    surface, normals = loaded.depth_map, loaded.normals
    pixels = np.round(255 * np.clip(np.asarray(shade(surface, normals=normals)), 0, 1)).astype(np.uint8)
    write_picture(arguments.output, Picture(pixels), overwrite=arguments.overwrite, quality=None)
    if arguments.depth is not None:
        spacing = float(surface.spacing[0])
        depth = np.where(np.asarray(surface.mask), np.asarray(surface.depth) / spacing, np.nan).astype(np.float32)
        write_picture(arguments.depth, Picture(depth), overwrite=arguments.overwrite, quality=None)
        say(f"wrote {str(arguments.depth)!r}; a pixel is {spacing:.6g} of the mesh's units")
