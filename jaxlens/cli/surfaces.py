"""What the commands about surfaces share: meshes and pictures as depth maps, and figures as files."""

# Optional[X] for the same reason as in `jaxlens.cli.options`.
# ruff: noqa: UP045

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional

from tyro.conf import arg

from jaxlens.cli.errors import CommandError, UsageError
from jaxlens.cli.fits import parse_size
from jaxlens.cli.meshes import is_mesh, load_mesh

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Array
    from matplotlib.figure import Figure

    from jaxlens.images import Picture
    from jaxlens.surfaces import DepthMap

_SIZE = (512, 512)
# The height of white over black, as a share of the picture's shorter side.
_RELIEF = 0.25


@dataclass(frozen=True, kw_only=True)
class View:
    """How a mesh is seen, and how a picture is a surface."""

    size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: 512x512)")] = None
    """Of a mesh: pixels of its picture."""

    projection: Literal["orthographic", "perspective"] = "orthographic"
    """Of a mesh."""

    field_of_view: Annotated[float, arg(metavar="DEGREES")] = 30.0
    """Of a mesh in perspective: the angle that the picture's height spans."""


def check_view(view: View) -> None:
    """Refuses a view that is none.

    Raises:
        UsageError: an option's value is out of bounds.
    """
    if view.size is not None:
        parse_size(view.size, "--size")
    if not 0 < view.field_of_view < 180:
        raise UsageError(f"--field-of-view is between 0 and 180 degrees, got {view.field_of_view:g}")


def load_surface(
    path: Path, view: View, max_pixels: int | None, *, relief: float | None = None
) -> "tuple[DepthMap, Array | None]":
    """Reads a surface, and the normals to light it by: a mesh, as it is seen; or a picture of depths, without any.

    Args:
        path: A mesh or a picture. A floating picture holds depths in pixels, NaN where there is no surface; of
            any other the grays are heights.
        view: How a mesh is seen.
        max_pixels: The largest picture accepted.
        relief: The height in pixels of white over black; a quarter of the shorter side by default, and for a floating
            picture one, so that its values are the depths.

    Raises:
        CommandError: it cannot be read, or it shows no surface.
    """
    import numpy as np

    from jaxlens.cli.pictures import read_picture
    from jaxlens.surfaces import DepthMap, from_mesh, normals_from_mesh

    try:
        if is_mesh(path):
            width, height = _SIZE if view.size is None else parse_size(view.size, "--size")
            mesh, options = load_mesh(path), {"projection": view.projection, "field_of_view": view.field_of_view}
            return from_mesh(mesh, height, width, **options), normals_from_mesh(mesh, height, width, **options)
        picture = read_picture(path, max_pixels)
        gray, white = gray_values(picture)
        if not np.isfinite(gray).any():
            raise CommandError(f"{str(path)!r} shows no surface: none of its pixels is finite")
        floating = picture.pixels.dtype.kind == "f"
        height = relief if relief is not None else (white if floating else _RELIEF * min(gray.shape))
        return DepthMap(gray * (height / white)), None
    except ValueError as error:
        raise CommandError(f"{str(path)!r}: {error}") from error


def gray_values(picture: "Picture") -> "tuple[np.ndarray, float]":
    """Returns a picture's gray values, the mean of its channels without alpha, and that of white."""
    import numpy as np

    pixels = picture.pixels
    if pixels.dtype.kind == "f":
        white = float(np.max(pixels, where=np.isfinite(pixels), initial=1.0))
    else:
        white = float(np.iinfo(pixels.dtype).max)
    if pixels.ndim == 3:
        pixels = pixels[..., :-1] if picture.has_alpha else pixels
        pixels = pixels.mean(axis=-1, dtype=np.float64)
    return np.asarray(pixels, np.float64), white


def save_figure(path: Path, figure: "Figure", *, overwrite: bool) -> None:
    """Writes a figure as PNG, whole or not at all.

    Raises:
        CommandError: it exists, or cannot be written.
    """
    from jaxlens.experiments.figures.style import save, style
    from jaxlens.files import atomic_write

    try:
        with atomic_write(path, overwrite=overwrite) as temporary, style():
            save(figure, temporary.parent, temporary.stem)
    except FileExistsError:
        raise CommandError(f"{str(path)!r} exists; pass --overwrite to replace it") from None
    except OSError as error:
        raise CommandError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
