"""`jaxlens geodesic`: how far the points of a face, or any surface, are from one of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.depth_maps import View, check_view, load_surface
from jaxlens.cli.inputs import check_file, is_mesh
from jaxlens.cli.messages import CommandError, UsageError, say
from jaxlens.cli.outputs import check_new_folder, make_folder, write_figure, write_picture, write_text
from jaxlens.cli.progress import progress_of

HELP = """Measure distances along a surface, from its most prominent point or another.

What it does:
  FILE is a mesh (OBJ, PLY, STL), seen from the front, or a picture of depths:
  a floating TIFF holds them in pixels, NaN where there is no surface; of any
  other picture the grays are heights. Written to the folder: the shortest
  distance along the surface (geodesic.tif), the length of the curve above
  each straight ray (radial.tif; Eqs. 1 and 2), curves of equal distance
  (curves.csv, pixels) and a drawing (distances.png). Lengths are in the mesh's
  units, or in pixels; NaN is no surface, infinity is out of reach. A surface
  of more than --max-points is taken coarser: it has fewer pixels in the TIFF
  files, while lengths and curves stay in those of the picture.
  The most prominent point is what stands out most from its surroundings in
  the middle of the surface. On the depth map of a face it is the tip of the
  nose. In a photograph it is a bright spot, wherever the light puts one: give
  --source there.

Examples:
  jaxlens geodesic head.obj --output distances/
  jaxlens geodesic depth.tif --source 250 270 --step 10 --output distances/
  jaxlens geodesic face.png --relief 120 --output distances/"""


@dataclass(frozen=True)
class Arguments(View):
    """Measure distances along a surface."""

    file: Annotated[Path, Positional, arg(metavar="FILE", help_behavior_hint="")]
    """A mesh, or a picture of depths."""

    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])]
    """The folder for the four files, which is made if need be."""

    source: Annotated[
        Optional[options.Numbers],
        options.numbers("X Y", count=2, largest=1e6),
        arg(help_behavior_hint="(default: the most prominent point)"),
    ] = None
    """The point to measure from, in pixels."""

    relief: Annotated[Optional[float], arg(metavar="PIXELS", help_behavior_hint="")] = None
    """Of a picture: how high white stands over black.
    By default it is a quarter of the shorter side; the values of a floating picture are pixels as they are."""

    step: Annotated[Optional[float], arg(metavar="LENGTH", help_behavior_hint="(default: about twelve curves)")] = None
    """How much farther the next curve of equal distance is than the one before."""

    max_points: Annotated[Optional[int], arg(metavar="N", help_behavior_hint="(default: 1 million)")] = None
    """Take a surface with more points coarser, so that it has at most as many; the time grows faster than they do."""

    overwrite: options.Overwrite = False
    max_pixels: options.MaxPixels = None


# Points that take a minute or two where the surface is as rough as noise, and much less where it is smooth.
_MAX_POINTS = 1_000_000
# More curves than that nobody can tell apart, and they take hours.
_MOST_CURVES = 2000
_FILES = ("geodesic.tif", "radial.tif", "curves.csv", "distances.png")


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_file(arguments.file)
    options.check_max_pixels(arguments.max_pixels)
    check_view(arguments)
    for name in ("relief", "step"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < 1e9:
            raise UsageError(f"--{name} is a length above 0, got {value:g}")
    if arguments.max_points is not None and arguments.max_points < 16:
        raise UsageError(f"--max-points is at least 16, got {arguments.max_points}")
    check_new_folder(arguments.output, _FILES, overwrite=arguments.overwrite)
    import jax

    with jax.enable_x64(True):
        _measure(arguments)
    return 0


def _measure(arguments: Arguments) -> None:
    import numpy as np

    from jaxlens.figures.contours import contour_lines
    from jaxlens.figures.distances import distance_maps, measure_distances
    from jaxlens.figures.style import style
    from jaxlens.images import Picture

    most = _MAX_POINTS if arguments.max_points is None else arguments.max_points
    loaded = load_surface(arguments.file, arguments, arguments.max_pixels, relief=arguments.relief, max_points=most)
    surface, factors = loaded.depth_map, np.asarray(loaded.factors)
    height, width = surface.shape
    coarse = (width, height) != loaded.size
    if coarse:
        say(
            f"{str(arguments.file)!r} has {loaded.size[0]} × {loaded.size[1]} points, more than --max-points {most}: "
            f"its surface is taken at {width} × {height}"
        )
    # The first pixel's centre is half a pixel from the edge that both grids share.
    source = None if arguments.source is None else (np.asarray(arguments.source) + 0.5) / factors - 0.5
    try:
        with progress_of("distances along the surface") as progress:
            found = measure_distances(surface, source=source, normals=loaded.normals, progress=progress)
    except ValueError as error:
        where = f" (at {width} × {height})" if coarse else ""
        raise CommandError(f"{str(arguments.file)!r}{where}: {error}") from error
    reached = found.geodesic[np.isfinite(found.geodesic)]
    farthest = float(reached.max())
    if farthest == 0:
        raise CommandError(f"{str(arguments.file)!r}: no pixel but the source can be reached")
    unit = "units" if is_mesh(arguments.file) else "pixels"
    step = _round_step(farthest / 12) if arguments.step is None else arguments.step
    if farthest / step > _MOST_CURVES:
        raise CommandError(
            f"--step {step:g} asks for {farthest / step:.0f} curves up to the farthest point, {farthest:.6g} {unit} "
            f"away, more than {_MOST_CURVES}; pass at least {farthest / _MOST_CURVES:.3g}"
        )
    levels = step * np.arange(1, int(farthest / step) + 1)
    lines = ["distance,curve,x,y"]
    for level, curves in zip(levels, contour_lines(found.geodesic, levels), strict=True):
        scaled = [(curve + 0.5) * factors - 0.5 for curve in curves]
        lines += [f"{level:.9g},{i},{x:.3f},{y:.3f}" for i, curve in enumerate(scaled) for x, y in curve]
    origin, place = ("the most prominent point",) * 2 if source is None else ("the source", "as given")
    with style():
        figure = distance_maps(found, step, unit, origin=origin)
    folder = arguments.output
    make_folder(folder)
    for name, values in (("geodesic.tif", found.geodesic), ("radial.tif", found.radial)):
        write_picture(folder / name, Picture(values.astype(np.float32)), overwrite=arguments.overwrite)
    write_text(folder / "curves.csv", "\n".join(lines) + "\n", overwrite=arguments.overwrite)
    write_figure(folder / "distances.png", figure, overwrite=arguments.overwrite)
    lost = int(np.isinf(found.geodesic).sum())
    x, y = (found.source + 0.5) * factors - 0.5
    print(f"source            pixel ({x:.2f}, {y:.2f}), {place}")  # noqa: T201
    print(f"farthest point    {farthest:.6g} {unit} along the surface")  # noqa: T201
    print(f"pixel spacing     {float(surface.spacing[0]):.6g} {unit}")  # noqa: T201
    if lost:
        say(f"warning: {lost} pixels of the surface cannot be reached from the source: the surface has several parts")
    say(f"wrote {', '.join(_FILES)} in {str(folder)!r}")


def _round_step(step: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten."""
    import math

    power = 10.0 ** math.floor(math.log10(step))
    return min((1, 2, 5, 10), key=lambda factor: abs(math.log(step / (factor * power)))) * power
