"""`jaxlens deform`: a picture or a mesh, dragged by a lattice, rectified, or put through a lens."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.inputs import check_file, is_mesh, read_columns, read_mesh, read_picture
from jaxlens.cli.lenses import check_choice, choose_lens
from jaxlens.cli.messages import CommandError, UsageError, describe, say
from jaxlens.cli.outputs import check_new_file, check_picture_name, has_quality, write_mesh, write_picture

if TYPE_CHECKING:
    import numpy as np

    from jaxlens.deformations import FreeForm3D
    from jaxlens.frames import Frame
    from jaxlens.maps import CoordinateMap
    from jaxlens.surfaces import Mesh

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

    corners: Annotated[
        Optional[options.Numbers], options.numbers("X Y ...", count=8, largest=1e6), arg(help_behavior_hint="")
    ] = None
    """Top left, top right, bottom right and bottom left corner, in pixels, of what shall become the whole picture."""

    size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: as its sides are)")] = None
    """The size of the rectified picture in pixels."""

    kappa: options.Kappa = None
    """A lens for a mesh, in half diagonals of its bounding box as seen from the front."""

    lens: options.Lens = None
    model: options.LensModel = None

    method: options.Method = "bilinear"
    """How to read between pixels."""

    quality: options.Quality = None
    overwrite: options.Overwrite = False
    max_pixels: options.MaxPixels = None


# Pixels at which it is looked whether a deformation has gaps.
_SAMPLED = 1_000_000


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_file(arguments.file)
    options.check_max_pixels(arguments.max_pixels)
    options.check_quality(arguments.quality)
    _check_output(arguments)
    given = [name for name in ("control", "corners", "kappa", "lens") if getattr(arguments, name) is not None]
    mesh = is_mesh(arguments.file)
    allowed = ("control", "kappa", "lens") if mesh else ("control", "corners")
    if len(given) != 1 or given[0] not in allowed:
        kind = "mesh" if mesh else "picture"
        got = ", ".join(f"--{name}" for name in given) or "none"
        hint = "; for the lens use jaxlens distort" if not mesh and {"kappa", "lens"} & set(given) else ""
        wanted = " or ".join(f"--{name}" for name in allowed)
        raise UsageError(f"a {kind} takes one of {wanted}, got {got}{hint}")
    for name, owner in (("degrees", "control"), ("continuity", "control"), ("size", "corners"), ("model", "lens")):
        if getattr(arguments, name) is not None and given[0] != owner:
            raise UsageError(f"--{name} goes with --{owner}; leave it out")
    if arguments.continuity is not None and arguments.continuity < 0:
        raise UsageError(f"--continuity is 0 or more, got {arguments.continuity}")
    size = None if arguments.size is None else options.parse_size(arguments.size, "--size")
    degrees = _degrees(arguments.degrees, 3 if mesh else 2)
    if arguments.control is not None:
        check_file(arguments.control)
    if mesh:
        if arguments.control is None:
            check_choice(arguments.kappa, arguments.lens, arguments.model)
        _deform_mesh(arguments, degrees)
    else:
        _deform_picture(arguments, degrees, size)
    return 0


def _check_output(arguments: Arguments) -> None:
    path = arguments.output
    check_new_file(path, overwrite=arguments.overwrite)
    if is_mesh(path) != is_mesh(arguments.file):
        raise UsageError(f"--output {str(path)!r}: a mesh becomes a mesh, and a picture a picture")
    if not is_mesh(path):
        check_picture_name(path)
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


def _deform_picture(arguments: Arguments, degrees: tuple[int, ...], size: tuple[int, int] | None) -> None:
    import jax
    import numpy as np

    from jaxlens import images
    from jaxlens.deformations import FreeForm, rectification
    from jaxlens.frames import Frame

    lattice = None if arguments.control is None else _read_control(arguments, degrees)
    picture = read_picture(arguments.file, arguments.max_pixels)
    height, width = picture.pixels.shape[:2]
    frame, shape = _shares(height, width), (height, width)
    with jax.enable_x64(True):
        if lattice is not None:
            mapping = _free_form(FreeForm, lattice, arguments.continuity).inverse()
        else:
            corners = np.asarray(arguments.corners).reshape(4, 2)
            shape = _sides(corners) if size is None else (size[1], size[0])
            frame = Frame([0.0, 0.0], 1.0)
            try:
                mapping = rectification(corners, *shape).inverse()
            except ValueError as error:
                raise UsageError(f"--corners: {error}") from error
        if lattice is not None:
            _tell_of_gaps(mapping, height, width)
    warped = images.warp(picture, mapping, frame=frame, shape=shape, method=arguments.method)
    write_picture(arguments.output, warped, overwrite=arguments.overwrite, quality=arguments.quality)
    say(f"wrote {str(arguments.output)!r} ({describe(warped)})")


def _deform_mesh(arguments: Arguments, degrees: tuple[int, ...]) -> None:
    import jax
    import jax.numpy as jnp

    from jaxlens.surfaces import deform_mesh

    lattice = None if arguments.control is None else _read_control(arguments, degrees)
    with jax.enable_x64(True):
        mesh = read_mesh(arguments.file)
        if lattice is not None:
            mapping = _boxed(lattice, mesh, arguments.continuity)
        else:
            mapping = choose_lens(arguments.kappa, arguments.lens, arguments.model).lens()
        try:
            moved = deform_mesh(mesh, mapping)
        except ValueError as error:
            raise CommandError(f"cannot deform {str(arguments.file)!r}: {error}") from error
        folded = int(jnp.sum(moved.folded))
        if folded:
            say(f"warning: {folded} of {len(mesh.faces)} triangles are turned over by the deformation")
        write_mesh(arguments.output, moved.mesh, overwrite=arguments.overwrite)
    say(f"wrote {str(arguments.output)!r} ({len(mesh.vertices)} vertices, {len(mesh.faces)} triangles)")


def _read_control(arguments: Arguments, degrees: tuple[int, ...]) -> "tuple[np.ndarray, np.ndarray]":
    """The control points, shares of the rectangle or box, and their weights."""
    import numpy as np

    assert arguments.control is not None
    path = repr(str(arguments.control))
    counts = [degree + 1 for degree in degrees]
    names, axes = ("column", "row", "layer")[: len(degrees)], ("x", "y", "z")[: len(degrees)]
    columns = read_columns(arguments.control, (*names, *axes), optional=("weight",))
    steps = [np.linspace(0, 1, count) for count in counts]
    points = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
    weights = np.ones(counts)
    values = [np.asarray(columns[name]) for name in (*names, *axes)]
    seen: set[tuple[int, ...]] = set()
    for line in range(len(values[0])):
        place = tuple(int(value[line]) for value in values[: len(names)])
        for name, value, count in zip(names, values, counts, strict=False):
            if value[line] != int(value[line]) or not 0 <= value[line] < count:
                raise UsageError(
                    f"{path}, row {line + 1}: {name} must be a whole number from 0 to {count - 1} (see --degrees), "
                    f"got {value[line]:g}"
                )
        if place in seen:
            raise UsageError(f"{path}, row {line + 1}: control point {place} is listed twice")
        seen.add(place)
        points[place] = [value[line] for value in values[len(names) :]]
        weights[place] = columns["weight"][line] if "weight" in columns else 1.0
    return points, weights


def _free_form(make: Callable[..., Any], lattice: "tuple[np.ndarray, np.ndarray]", continuity: int | None) -> Any:
    points, weights = lattice
    try:
        deformation = make(points, weights=None if (weights == 1).all() else weights)
        return deformation if continuity is None else deformation.freeze(continuity)
    except ValueError as error:
        raise UsageError(f"--control: {error}") from error


def _boxed(lattice: "tuple[np.ndarray, np.ndarray]", mesh: "Mesh", continuity: int | None) -> "FreeForm3D":
    """The deformation of a mesh's bounding box."""
    import numpy as np

    from jaxlens.deformations import FreeForm3D

    vertices = np.asarray(mesh.vertices)
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    # A flat mesh has a box without thickness: along it, shares are lengths.
    extent = np.where(extent > 0, extent, 1)
    points, weights = lattice
    make = partial(FreeForm3D, origin=low, axes=np.diag(extent))
    return _free_form(make, (low + extent * points, weights), continuity)


def _shares(height: int, width: int) -> "Frame":
    """The frame of shares of a picture: 0 is its left or upper edge, half a pixel before the first pixel's centre."""
    from jaxlens.frames import Frame

    return Frame([-0.5, -0.5], [width, height])


def _sides(corners: "np.ndarray") -> tuple[int, int]:
    """Height and width of an upright rectangle whose sides are as long as the longer of opposite ones."""
    import numpy as np

    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    width, height = max(sides[0], sides[2]), max(sides[1], sides[3])
    return max(round(float(height)), 1), max(round(float(width)), 1)


def _tell_of_gaps(mapping: "CoordinateMap", height: int, width: int) -> None:
    import numpy as np

    from jaxlens.warping import source_coordinates

    # On a picture of the same shape and at most a megapixel: the share is what counts.
    reduction = max(1.0, (height * width / _SAMPLED) ** 0.5)
    height, width = max(1, round(height / reduction)), max(1, round(width / reduction))
    sources = np.asarray(source_coordinates(mapping, height, width, frame=_shares(height, width))[..., 0])
    share = float(np.isnan(sources).mean())
    if share:
        say(
            f"warning: {share:.2%} of the pixels have no preimage, and are black or transparent: the lattice folds, "
            "or draws the border in"
        )
