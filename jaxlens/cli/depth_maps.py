"""Meshes and pictures as depth maps, for the commands about surfaces."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional

from tyro.conf import arg

from jaxlens.cli.inputs import gray_values, is_mesh, read_mesh, read_picture
from jaxlens.cli.messages import CommandError, UsageError
from jaxlens.cli.options import parse_size

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Array

    from jaxlens.surfaces import DepthMap

_SIZE = (512, 512)
# The height of white over black, as a share of the picture's shorter side.
_RELIEF = 0.25


@dataclass(frozen=True, kw_only=True)
class View:
    """How a mesh is seen, and how a picture is a surface."""

    size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: 512x512)")] = None
    """Of a mesh: the size of its picture in pixels."""

    projection: Literal["orthographic", "perspective"] = "orthographic"
    """Of a mesh: how it is seen."""

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


@dataclass(frozen=True)
class Surface:
    """A surface, perhaps with fewer points than its picture has pixels.

    Attributes:
        depth_map: The surface, in units of the mesh, or of the picture's pixels.
        normals: What a mesh is lit by; None for a picture of depths.
        size: Width and height of the picture, in pixels.
    """

    depth_map: "DepthMap"
    normals: "Array | None"
    size: tuple[int, int]

    @property
    def factors(self) -> tuple[float, float]:
        """How many of the picture's pixels one of the surface's is, across and down."""
        height, width = self.depth_map.shape
        return self.size[0] / width, self.size[1] / height


def load_surface(
    path: Path, view: View, max_pixels: int | None, *, relief: float | None = None, max_points: int | None = None
) -> Surface:
    """Reads a surface: a mesh, as it is seen; or a picture of depths.

    Args:
        path: A mesh or a picture. A floating picture holds depths in pixels, NaN where there is no surface; of
            any other the grays are heights.
        view: How a mesh is seen.
        max_pixels: The largest picture accepted.
        relief: The height in pixels of white over black; a quarter of the shorter side by default, and for a floating
            picture one, so that its values are the depths.
        max_points: A picture with more pixels is reduced to this number, by means over areas; a mesh is seen in fewer.

    Raises:
        CommandError: it cannot be read, or it shows no surface.
    """
    import numpy as np

    from jaxlens.surfaces import DepthMap, from_mesh, normals_from_mesh

    try:
        if is_mesh(path):
            size = _SIZE if view.size is None else parse_size(view.size, "--size")
            width, height = _within(size, max_points)
            mesh, options = read_mesh(path), {"projection": view.projection, "field_of_view": view.field_of_view}
            normals = normals_from_mesh(mesh, height, width, **options)
            return Surface(from_mesh(mesh, height, width, **options), normals, size)
        picture = read_picture(path, max_pixels)
        gray, white = gray_values(picture)
        if not np.isfinite(gray).any():
            raise CommandError(f"{str(path)!r} shows no surface: none of its pixels is finite")
        floating = picture.pixels.dtype.kind == "f"
        rise = relief if relief is not None else (white if floating else _RELIEF * min(gray.shape))
        size = (gray.shape[1], gray.shape[0])
        width, height = _within(size, max_points)
        heights = _reduced(gray * (rise / white), height, width)
        return Surface(DepthMap(heights, spacing=(size[0] / width, size[1] / height)), None, size)
    except ValueError as error:
        raise CommandError(f"{str(path)!r}: {error}") from error


def _within(size: tuple[int, int], most: int | None) -> tuple[int, int]:
    """Width and height of the same shape, as nearly as may be, and of at most so many pixels."""
    width, height = size
    if most is None or width * height <= most:
        return size
    # The shorter side first: of a narrow strip it stays one pixel at least.
    shrink = (most / (width * height)) ** 0.5
    short = max(1, int(min(size) * shrink))
    long = max(1, min(int(max(size) * shrink), most // short))
    return (long, short) if width >= height else (short, long)


def _reduced(values: "np.ndarray", height: int, width: int) -> "np.ndarray":
    """The means over areas, of what is finite there; NaN where that is less than half."""
    import numpy as np

    if values.shape == (height, width):
        return values
    down, across = (_shares(few, many) for few, many in zip((height, width), values.shape, strict=True))
    known = np.isfinite(values)
    part = down @ known.astype(np.float64) @ across.T
    total = down @ np.where(known, values, 0) @ across.T
    seen = part >= 0.5
    return np.where(seen, total / np.where(seen, part, 1), np.nan)


def _shares(few: int, many: int) -> "np.ndarray":
    """By how much each of many intervals, all of one length, covers each of a few of the same total length."""
    import numpy as np

    edges, fine = np.linspace(0, many, few + 1), np.arange(many)
    overlap = np.minimum(edges[1:, None], fine + 1) - np.maximum(edges[:-1, None], fine)
    return np.maximum(overlap, 0) * (few / many)
