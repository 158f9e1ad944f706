"""What `jaxlens deform` computes."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlens.cli.errors import CommandError, UsageError
from jaxlens.cli.fits import load_columns
from jaxlens.cli.meshes import load_mesh, store_mesh
from jaxlens.cli.messages import say
from jaxlens.cli.pictures import describe, read_picture, write_picture
from jaxlens.cli.pixels import Sampling, pull_back
from jaxlens.deformations import FreeForm, FreeForm3D, rectification
from jaxlens.frames import Frame
from jaxlens.lenses import RadialPolynomial
from jaxlens.maps import CoordinateMap
from jaxlens.surfaces import Mesh, deform_mesh
from jaxlens.warping import source_coordinates

if TYPE_CHECKING:
    from jaxlens.cli.deform import Arguments

# Pixels at which it is looked whether a deformation has gaps.
_SAMPLED = 1_000_000


def deform_picture_file(arguments: "Arguments", degrees: tuple[int, ...], size: tuple[int, int] | None) -> None:
    """Deforms a picture as `jaxlens deform` is told.

    Raises:
        CommandError: a file cannot be read or written.
        UsageError: control points or corners that make no deformation.
    """
    lattice = None if arguments.control is None else _read_control(arguments, degrees)
    picture = read_picture(arguments.file, arguments.max_pixels)
    height, width = picture.pixels.shape[:2]
    frame = _shares(height, width)
    shape: tuple[int, int] = (height, width)
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

    def place(dtype: type[np.floating]) -> tuple[CoordinateMap, Frame]:
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), (mapping, frame))

    pixels = pull_back(picture.pixels, place, Sampling(method=arguments.method), size=shape)
    if lattice is not None:
        _tell_of_gaps(mapping, height, width)
    warped = replace(picture, pixels=pixels)
    write_picture(arguments.output, warped, overwrite=arguments.overwrite, quality=arguments.quality)
    say(f"wrote {str(arguments.output)!r} ({describe(warped)})")


def deform_mesh_file(arguments: "Arguments", degrees: tuple[int, ...]) -> None:
    """Deforms a mesh as `jaxlens deform` is told.

    Raises:
        CommandError: a file cannot be read or written, or a vertex has nowhere to go.
        UsageError: control points that make no deformation.
    """
    lattice = None if arguments.control is None else _read_control(arguments, degrees)
    with jax.enable_x64(True):
        mesh = load_mesh(arguments.file)
        if lattice is not None:
            mapping = _boxed(lattice, mesh, arguments.continuity)
        elif arguments.kappa is not None:
            mapping = RadialPolynomial(list(arguments.kappa))
        else:
            from jaxlens.cli.calibrations import load_calibration

            assert arguments.lens is not None
            mapping = load_calibration(arguments.lens).lens()
        try:
            moved = deform_mesh(mesh, mapping)
        except ValueError as error:
            raise CommandError(f"cannot deform {str(arguments.file)!r}: {error}") from error
        folded = int(jnp.sum(moved.folded))
        if folded:
            say(f"warning: {folded} of {len(mesh.faces)} triangles are turned over by the deformation")
        store_mesh(arguments.output, moved.mesh, overwrite=arguments.overwrite)
    say(f"wrote {str(arguments.output)!r} ({len(mesh.vertices)} vertices, {len(mesh.faces)} triangles)")


def _read_control(arguments: "Arguments", degrees: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The control points, shares of the rectangle or box, and their weights."""
    assert arguments.control is not None
    path = repr(str(arguments.control))
    counts = [degree + 1 for degree in degrees]
    names, axes = ("column", "row", "layer")[: len(degrees)], ("x", "y", "z")[: len(degrees)]
    columns = load_columns(arguments.control, (*names, *axes), optional=("weight",))
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


def _free_form(make: Callable[..., Any], lattice: tuple[np.ndarray, np.ndarray], continuity: int | None) -> Any:
    points, weights = lattice
    try:
        deformation = make(points, weights=None if (weights == 1).all() else weights)
        return deformation if continuity is None else deformation.freeze(continuity)
    except ValueError as error:
        raise UsageError(f"--control: {error}") from error


def _boxed(lattice: tuple[np.ndarray, np.ndarray], mesh: Mesh, continuity: int | None) -> FreeForm3D:
    """The deformation of a mesh's bounding box."""
    vertices = np.asarray(mesh.vertices)
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    # A flat mesh has a box without thickness: along it, shares are lengths.
    extent = np.where(extent > 0, extent, 1)
    points, weights = lattice
    make = partial(FreeForm3D, origin=low, axes=np.diag(extent))
    return _free_form(make, (low + extent * points, weights), continuity)


def _shares(height: int, width: int) -> Frame:
    """The frame of shares of a picture: 0 is its left or upper edge, half a pixel before the first pixel's centre."""
    return Frame([-0.5, -0.5], [width, height])


def _sides(corners: np.ndarray) -> tuple[int, int]:
    """Height and width of an upright rectangle whose sides are as long as the longer of opposite ones."""
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    width, height = max(sides[0], sides[2]), max(sides[1], sides[3])
    return max(round(float(height)), 1), max(round(float(width)), 1)


def _tell_of_gaps(mapping: CoordinateMap, height: int, width: int) -> None:
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
