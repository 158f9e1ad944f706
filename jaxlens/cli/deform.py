"""`jaxlens deform`: a picture or a mesh, dragged by a lattice, rectified, or put through a lens."""

# Optional[X] for the same reason as in `jaxlens.cli.options`.
# ruff: noqa: UP045

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli.errors import UsageError
from jaxlens.cli.fits import parse_size
from jaxlens.cli.jobs import check_picture_file, has_quality
from jaxlens.cli.meshes import is_mesh
from jaxlens.cli.options import Method, check_file, check_max_pixels, check_quality
from jaxlens.cli.values import Numbers, numbers

HELP = """Deform a picture or a mesh: free-form, in perspective, or by a lens.

What it does:
  --control drags a rectangle, or a box, by the control points of a lattice
  (Eq. 4). FILE.csv lists those that are moved: columns column, row, x, y and,
  if wanted, weight; for a mesh (OBJ, PLY, STL) column, row, layer, x, y, z.
  Columns and rows count from 0, and places are shares of the picture's width
  and height, or of the mesh's bounding box: 0 to 1, y downwards in pictures
  and upwards in meshes. All other control points stay where they are.
  --corners makes a slanted rectangle in a picture upright.
  --kappa and --lens are for meshes; for pictures there is jaxlens distort.
  What folds over is told.

Examples:
  jaxlens deform portrait.png --control smile.csv --degrees 4x4 --output out.png
  jaxlens deform head.obj --control nose.csv --continuity 1 --output out.obj
  jaxlens deform door.jpg --corners 80 60 420 90 410 700 70 640 --output door.png
  jaxlens deform head.ply --kappa 0.2 --output bent.ply"""


@dataclass(frozen=True)
class Arguments:
    """Deform a picture or a mesh."""

    file: Annotated[Path, Positional, arg(metavar="FILE", help_behavior_hint="")]
    """A picture, or a mesh (OBJ, PLY, STL)."""

    output: Annotated[Path, arg(metavar="FILE", aliases=["-o"])]
    """The new picture or mesh; its suffix is its format."""

    control: Annotated[Optional[Path], arg(metavar="FILE.csv", help_behavior_hint="")] = None
    """A table of the control points that are moved; its columns are listed above."""

    degrees: Annotated[Optional[str], arg(metavar="MxN[xL]", help_behavior_hint="(default: 3 each way)")] = None
    """Degrees of the lattice: one less than its columns, rows and layers."""

    continuity: Annotated[Optional[int], arg(metavar="K", help_behavior_hint="")] = None
    """Put the outermost K + 1 rows of control points back, so that K derivatives go over the border unbroken."""

    corners: Annotated[Optional[Numbers], numbers("X Y ...", count=8, largest=1e6), arg(help_behavior_hint="")] = None
    """Top left, top right, bottom right and bottom left corner, in pixels, of what shall become the whole picture."""

    size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: as its sides are)")] = None
    """The size of the rectified picture in pixels."""

    kappa: Annotated[Optional[Numbers], numbers("K1 [K2 ...]", largest=1e6), arg(help_behavior_hint="")] = None
    """A lens for a mesh, in half diagonals of its bounding box as seen from the front."""

    lens: Annotated[Optional[Path], arg(metavar="FILE.json", help_behavior_hint="")] = None
    """A calibration that jaxlens fit or jaxlens calibrate wrote, whose lens is taken in place of --kappa."""

    method: Method = "bilinear"
    """How to read between pixels."""

    quality: Annotated[Optional[int], arg(metavar="1-100", help_behavior_hint="(default: 95, WebP lossless)")] = None
    """How good JPEG and WebP files are; the better, the larger."""

    overwrite: Annotated[bool, arg(help_behavior_hint="")] = False
    """Replace a file that exists."""

    max_pixels: Annotated[Optional[int], arg(metavar="COUNT", help_behavior_hint="(default: 200 million)")] = None
    """Refuse pictures with more pixels, before they are decoded."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_file(arguments.file)
    check_max_pixels(arguments.max_pixels)
    check_quality(arguments.quality)
    _check_output(arguments)
    given = [name for name in ("control", "corners", "kappa", "lens") if getattr(arguments, name) is not None]
    mesh = is_mesh(arguments.file)
    allowed = ("control", "kappa", "lens") if mesh else ("control", "corners")
    if len(given) != 1 or given[0] not in allowed:
        kind = "mesh" if mesh else "picture"
        got = ", ".join(f"--{name}" for name in given) or "none"
        hint = "; for the lens use jaxlens distort" if not mesh and {"kappa", "lens"} & set(given) else ""
        options = " or ".join(f"--{name}" for name in allowed)
        raise UsageError(f"a {kind} takes one of {options}, got {got}{hint}")
    for name, owner in (("degrees", "control"), ("continuity", "control"), ("size", "corners")):
        if getattr(arguments, name) is not None and given[0] != owner:
            raise UsageError(f"--{name} goes with --{owner}; leave it out")
    if arguments.continuity is not None and arguments.continuity < 0:
        raise UsageError(f"--continuity is 0 or more, got {arguments.continuity}")
    size = None if arguments.size is None else parse_size(arguments.size, "--size")
    degrees = _degrees(arguments.degrees, 3 if mesh else 2)
    for path in (arguments.control, arguments.lens):
        if path is not None:
            check_file(path)
    if mesh:
        from jaxlens.cli.deforming import deform_mesh_file

        deform_mesh_file(arguments, degrees)
    else:
        from jaxlens.cli.deforming import deform_picture_file

        deform_picture_file(arguments, degrees, size)
    return 0


def _check_output(arguments: Arguments) -> None:
    path = arguments.output
    if path.is_dir() or not path.parent.is_dir():
        raise UsageError(f"--output {str(path)!r} must be a file in a folder that exists")
    if path.exists() and not arguments.overwrite:
        raise UsageError(f"--output {str(path)!r} exists; pass --overwrite to replace it")
    if is_mesh(path) != is_mesh(arguments.file):
        raise UsageError(f"--output {str(path)!r}: a mesh becomes a mesh, and a picture a picture")
    if not is_mesh(path):
        check_picture_file(path)
    if arguments.quality is not None and not has_quality(path):
        raise UsageError(f"--quality {arguments.quality} is for JPEG and WebP; leave it out")


def _degrees(text: str | None, dimensions: int) -> tuple[int, ...]:
    if text is None:
        return (3,) * dimensions
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) != dimensions or not all(part.isdecimal() and 1 <= int(part) <= 20 for part in parts):
        wanted = "x".join("3" * dimensions)
        raise UsageError(
            f"--degrees is {dimensions} numbers from 1 to 20 with an x between, such as {wanted}; got {text!r}"
        )
    return tuple(int(part) for part in parts)
