"""Figure 2: a free-form deformation of a part of an image, with its border free and with frozen rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, model_validator
from rich.console import Console

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import (
    ConfigError,
    Configuration,
    Crop,
    Experiment,
    Image,
    Outcome,
    Table,
    Value,
    Warp,
    load_source,
    plain_table,
    progress_bar,
    write_csv,
    write_rows,
)

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_LATTICE = ("border", "column", "row", "initial_x", "initial_y", "x", "y", "weight", "frozen")
# Points along each side of the border.
_SAMPLES = 401


class ControlPointMove(Table):
    """What becomes of one control point of a free-form deformation.

    Attributes:
        column: i, from 0 at the left to the degree m.
        row: j, from 0 at the top to the degree n.
        dx: To the right, in pixels.
        dy: Downwards, in pixels.
        weight: Of the control point, relative to those left alone.
    """

    column: int = Field(ge=0)
    row: int = Field(ge=0)
    dx: float = 0.0
    dy: float = 0.0
    weight: float = Field(default=1.0, gt=0)


class FreeFormExperiment(Experiment):
    """A free-form deformation of a part of an image, with a free border and with frozen ones: Figure 2.

    Attributes:
        image: The image.
        region: The pixels whose area is the rectangle that is deformed.
        degrees: m along x and n along y: there are m + 1 columns and n + 1 rows of control points.
        moves: The control points that do not stay in place.
        continuity: Orders of continuity across the rectangle's border, each of which freezes rows of control points;
            the deformation without any frozen is drawn besides.
        warp: How the image is sampled.
    """

    image: Image
    region: Crop
    degrees: Annotated[list[Annotated[int, Field(ge=1, le=32)]], Field(min_length=2, max_length=2)]
    moves: list[ControlPointMove] = Field(min_length=1)
    continuity: list[Annotated[int, Field(ge=0)]] = Field(default=[0, 1], max_length=3)
    warp: Warp = Warp()

    @model_validator(mode="after")
    def _check(self) -> FreeFormExperiment:
        m, n = self.degrees
        for move in self.moves:
            if move.column > m or move.row > n:
                raise ValueError(
                    f"'moves' must name control points of columns 0 to {m} and rows 0 to {n}, got column "
                    f"{move.column}, row {move.row}"
                )
        places = [(move.column, move.row) for move in self.moves]
        if len(set(places)) < len(places):
            raise ValueError("'moves' must name each control point once")
        if self.continuity and min(m, n) < 2 * max(self.continuity) + 2:
            raise ValueError(
                f"'continuity' of order {max(self.continuity)} leaves no control point free: it takes 'degrees' of at "
                f"least {2 * max(self.continuity) + 2}, got {self.degrees}"
            )
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: a row of `table.csv` is a border, one of `lattice.csv` a control point.

        Raises:
            ConfigError: the region does not fit into the image.
        """
        from . import panels

        source = load_source(configuration, self.image)
        region, (height, width) = self.region, source.pixels.shape[:2]
        bottom, right = region.top + region.height, region.left + region.width
        if bottom > height or right > width:
            raise ConfigError(
                f"{configuration.path}: region: got rows {region.top} to {bottom} and columns {region.left} to "
                f"{right}; must lie within the image's {height} rows and {width} columns"
            )
        still = lattice_of(region, self.degrees, self.dtype)
        free = moved(still, self.moves)
        found: dict[str, Deformed] = {}
        lattice: list[tuple[Value, ...]] = []
        with progress_bar(progress, self.name, 1 + len(self.continuity)) as advance:
            for order in (None, *self.continuity):
                mapping = free if order is None else free.freeze(order)
                name = _name(order)
                found[name] = deform(source.pixels, mapping, self.warp)
                frozen = np.zeros(mapping.control_points.shape[:2], bool) if order is None else free.frozen(order)
                lattice += _control_points(name, still.control_points, found[name], frozen)
                advance(1)
        names = list(next(iter(found.values())).measures)
        columns = {name: [one.measures[name] for one in found.values()] for name in names}
        write_csv(folder, {"border": list(found)} | columns)
        write_rows(folder, _LATTICE, lattice, "lattice.csv")
        lattice_panel = panels.lattice_panel(source.pixels, source.peak, still, found[_name(None)])
        figures.save(lattice_panel, folder / "lattice.jpg")
        figures.save(panels.continuity_panel(source.peak, still, found), folder / "continuity.jpg")
        header = ["", *found]
        rows = [
            [name.removesuffix("_px").replace("_", " ") + (", px" if name.endswith("_px") else "")]
            + [f"{one.measures[name]:.4g}" for one in found.values()]
            for name in names
        ]
        return Outcome([source.facts], {}, [plain_table(self.heading, header, rows)])


def _name(order: int | None) -> str:
    if order is None:
        return "border free"
    return f"{order + 1} row{'s' if order else ''} frozen (C{str(order).translate(_SUPERSCRIPTS)})"


def _control_points(
    name: str, initial: ArrayLike, deformed: Deformed, frozen: np.ndarray
) -> Iterator[tuple[Value, ...]]:
    """The rows of `lattice.csv` for one border."""
    before, after = np.asarray(initial), np.asarray(deformed.mapping.control_points)
    weights = deformed.mapping.weights
    weights = np.ones(after.shape[:2]) if weights is None else np.asarray(weights)
    for i, j in np.ndindex(*after.shape[:2]):
        state = "yes" if frozen[i, j] else "no"
        (x, y), (new_x, new_y) = before[i, j], after[i, j]
        yield name, i, j, float(x), float(y), float(new_x), float(new_y), float(weights[i, j]), state


@dataclass(frozen=True, eq=False)
class Deformed:
    """What a deformation, written in pixels, makes of a picture.

    Attributes:
        mapping: The deformation: where points of the picture go.
        picture: The picture, pulled back through the inverse.
        determinant: `(H, W)`, the change of area at each pixel of the initial picture; NaN outside the rectangle.
        gap: `(H, W)`, pixels of the new picture that nothing is moved to.
        covered: `(H, W)`, pixels of the new picture outside the rectangle that are moved over.
        measures: Numbers by name.
    """

    mapping: jl.deformations.FreeForm
    picture: Float[np.ndarray, "height width *channels"]
    determinant: Float[np.ndarray, "height width"]
    gap: Bool[np.ndarray, "height width"]
    covered: Bool[np.ndarray, "height width"]
    measures: dict[str, float | int]


def lattice_of(region: Crop, degrees: Sequence[int], dtype: str) -> jl.deformations.FreeForm:
    """Returns the deformation that moves nothing, of the area that a rectangle of pixels covers."""
    import jax.numpy as jnp

    # Pixel centres lie at integers: the area begins half a pixel before the first of them.
    lower = jnp.asarray([region.left - 0.5, region.top - 0.5], dtype)
    return jl.deformations.FreeForm.identity(
        *degrees, lower=lower, upper=lower + jnp.asarray([region.width, region.height], dtype)
    )


def moved(still: jl.deformations.FreeForm, moves: Sequence[ControlPointMove]) -> jl.deformations.FreeForm:
    """Returns a deformation whose control points are moved, and weighted."""
    import jax.numpy as jnp

    control_points, weights = still.control_points, jnp.ones(still.control_points.shape[:2], still.control_points.dtype)
    for move in moves:
        step = jnp.asarray([move.dx, move.dy], control_points.dtype)
        control_points = control_points.at[move.column, move.row].add(step)
        weights = weights.at[move.column, move.row].set(move.weight)
    equal = all(move.weight == 1 for move in moves)
    return jl.deformations.FreeForm(
        control_points, weights=None if equal else weights, lower=still.lower, upper=still.upper
    )


def deform(
    pixels: Float[np.ndarray, "height width *channels"], mapping: jl.deformations.FreeForm, warp: Warp
) -> Deformed:
    """Deforms a picture, and looks at the deformation at every pixel and along its border."""
    import jax

    at_pixels = jax.jit(_at_pixels, static_argnames="warp")(pixels, mapping, warp=warp)
    seen = {name: np.asarray(value) for name, value in at_pixels.items()}
    jump, slope = (float(value) for value in jax.jit(_at_border)(mapping, _border_of(mapping)))
    determinant = np.where(seen["inside"], seen["determinant"], np.nan)
    gap, covered = ~seen["valid"], seen["covered"]
    measures: dict[str, float | int] = {
        "largest_displacement_px": max(float(seen["displacement"].max()), jump),
        "jump_at_border_px": jump,
        "slope_jump_at_border": slope,
        "smallest_determinant": float(np.nanmin(determinant)),
        "largest_determinant": float(np.nanmax(determinant)),
        "folded_px": int(np.sum(determinant <= 0)),
        "gap_px": int(gap.sum()),
        "covered_px": int(covered.sum()),
        "round_trip_px": float(seen["round_trip"].max()),
    }
    return Deformed(mapping, seen["picture"], determinant, gap, covered, measures)


def _at_pixels(image: Array, mapping: jl.deformations.FreeForm, *, warp: Warp) -> dict[str, Array]:
    """The picture, and at each pixel: of the initial picture the forward map's, of the new one its inverse's."""
    import jax.numpy as jnp

    from jaxlens.warping import pixel_grid

    height, width = image.shape[:2]
    pixels = pixel_grid(height, width, mapping.lower.dtype)
    inverse = mapping.invert(pixels)
    inside = mapping.contains(pixels)
    return {
        "picture": jl.remap(
            image, inverse.masked(), method=warp.method, border=warp.border, fill=warp.fill, antialias=warp.antialias
        ),
        "inside": inside,
        "displacement": _length(mapping(pixels) - pixels),
        "determinant": mapping.jacobian_determinant(pixels),
        "valid": inverse.valid,
        "covered": inverse.valid & mapping.contains(inverse.points) & ~inside,
        "round_trip": jnp.where(inverse.valid, _length(mapping(inverse.points) - pixels), 0),
    }


def _border_of(mapping: jl.deformations.FreeForm) -> Float[np.ndarray, "sides points 2"]:
    along = np.linspace(0, 1, _SAMPLES)
    zero, one = np.zeros_like(along), np.ones_like(along)
    unit = np.stack([np.stack(side, axis=-1) for side in ((along, zero), (along, one), (zero, along), (one, along))])
    lower, upper = np.asarray(mapping.lower), np.asarray(mapping.upper)
    # Both ends are the corners to the last bit, so that the border lies in the rectangle.
    return (lower * (1 - unit) + upper * unit).astype(lower.dtype)


def _at_border(mapping: jl.deformations.FreeForm, border: Float[Array, "sides points 2"]) -> tuple[Array, Array]:
    """How far the border's points are moved at most, and how much the derivative there differs from that outside."""
    import jax.numpy as jnp

    change = mapping.jacobian(border) - jnp.eye(2, dtype=border.dtype)[None, None]
    return jnp.max(_length(mapping(border) - border)), jnp.max(jnp.abs(change))


def _length(vectors: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    import jax.numpy as jnp

    return jnp.hypot(vectors[..., 0], vectors[..., 1])
