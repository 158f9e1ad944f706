"""Figures 3 and 4: straight lines under k = ±0.3, in the three ways in which the paper writes a lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field
from rich.console import Console

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import Configuration, Experiment, Outcome, Value, plain_table, write_rows

if TYPE_CHECKING:
    from jaxtyping import Array
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEADER = ("setting", "k", "distortion", "bend_of_curve_px", "bend_of_picture_px")
Setting = Literal["lens", "section 2.4", "division"]
SETTINGS: tuple[Setting, ...] = ("lens", "section 2.4", "division")
HALF = float(np.sqrt(0.5))
"""Half the side of a square whose half diagonal is one, as in Eq. 10."""
_SAMPLES = 801
# The line whose bend is measured: half way out; between its middle and points as far up and down.
_PROBE = 0.5 * HALF
# A row of a picture with less light than this does not show the line.
_DARK = 0.1
_HEAD, _NOTE, _GAP, _MARGIN = 0.55, 0.27, 0.14, 0.05
_HEADINGS: dict[Setting, tuple[str, str]] = {
    "lens": ("a lens: ideal → observed", r"$x_d = x_u\,(1 + k\,|x_u|^2)$"),
    "section 2.4": (
        "Section 2.4: output → source",
        r"$x_{\mathrm{source}} = x_{\mathrm{out}}\,(1 + k\,|x_{\mathrm{out}}|^2)$",
    ),
    "division": ("division model (Eq. 5)", r"$x_u = x_d\,/\,(1 - k\,|x_d|^2)$"),
}


class GridsExperiment(Experiment):
    """Line grids through one-parameter lenses: the paper's Figures 3 and 4.

    Attributes:
        k: The coefficients.
        lines: Of the grid, along each side.
        size: Side of the raster grid, in pixels.
    """

    k: list[float] = Field(default=[-0.3, 0.3], min_length=1, max_length=6)
    lines: int = Field(default=11, ge=2, le=101)
    size: int = Field(default=401, ge=16, le=2048)

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        size, lines = self.size, self.lines
        straight = straight_picture(lines, size)
        drawn, pictures, names = {}, {}, {}
        table: list[tuple[Value, ...]] = []
        for setting in SETTINGS:
            for k in self.k:
                curve, raster = bend_of_curve(setting, k, size), bend_of_picture(setting, k, size)
                drawn[setting, k] = curves(setting, k, lines)
                pictures[setting, k] = np.asarray(picture(setting, k, straight))
                names[setting, k] = curve.name
                table.append((setting, k, curve.name, curve.pixels, raster.pixels))
        write_rows(folder, _HEADER, table)
        figures.save(curve_panel(drawn, names, self.k, lines), folder / "grids.svg")
        figures.save(picture_panel(pictures, names, self.k), folder / "rasters.png")
        rows = [[str(one), f"{k:+g}", str(name), f"{a:+.3f}", f"{b:+.3f}"] for one, k, name, a, b in table]
        header = ["", "k", "distortion", "bend of curve, px", "bend of picture, px"]
        return Outcome([], {}, [plain_table(self.heading, header, rows)])


@dataclass(frozen=True)
class Bend:
    """How much a vertical line to the right of the centre bends.

    Attributes:
        pixels: How much further out its middle lies than its ends: positive is barrel; NaN where the output does not
            show it.
    """

    pixels: float

    @property
    def name(self) -> str:
        """Barrel, pincushion or straight."""
        if np.isnan(self.pixels):
            return "not shown"
        return "straight" if abs(self.pixels) < 1e-3 else "barrel" if self.pixels > 0 else "pincushion"


def lens_of(setting: Setting, k: float) -> jl.RadialLens:
    """Returns the lens of a setting."""
    return jl.Division(k) if setting == "division" else jl.RadialPolynomial([k])


def forward(setting: Setting, k: float) -> jl.CoordinateMap:
    """Returns the map that takes source points to output points; NaN where the output shows none."""
    lens = lens_of(setting, k)
    return lens.inverse() if setting == "section 2.4" else jl.OneToOne(lens)


def curves(setting: Setting, k: float, lines: int) -> list[Float[np.ndarray, "samples 2"]]:
    """Returns a grid's lines in the output, normalized coordinates, first the vertical and then the horizontal ones."""
    import jax.numpy as jnp

    along = jnp.linspace(-HALF, HALF, _SAMPLES)
    mapping, found = forward(setting, k), []
    for vertical in (True, False):
        for at in np.linspace(-HALF, HALF, lines):
            across = jnp.full_like(along, at)
            points = jnp.stack([across, along] if vertical else [along, across], axis=-1)
            found.append(np.asarray(mapping(points)))
    return found


def straight_picture(lines: int, size: int) -> Float[Array, "size size"]:
    """Returns a picture of a grid: dark lines on white."""
    import jax.numpy as jnp

    x, y = _normalized(size)
    at = jnp.linspace(-HALF, HALF, lines)[:, None, None]
    distance = jnp.min(jnp.minimum(jnp.abs(x[None] - at), jnp.abs(y[None] - at)), axis=0)
    pixel = 2 * HALF / size
    return jnp.clip(distance / pixel - 0.75, 0, 1)


def picture(setting: Setting, k: float, image: Float[Array, "size size"]) -> Float[Array, "size size"]:
    """Returns a picture through the setting's lens; black where it has no source."""
    lens = lens_of(setting, k)
    return jl.undistort_image(image, lens) if setting == "section 2.4" else jl.distort_image(image, lens)


def bend_of_curve(setting: Setting, k: float, size: int) -> Bend:
    """Measures the bend on a line that is pushed forward."""
    import jax.numpy as jnp

    along = jnp.linspace(-HALF, HALF, _SAMPLES)
    x, y = np.asarray(forward(setting, k)(jnp.stack([jnp.full_like(along, _PROBE), along], axis=-1))).T
    return Bend(_middle_less_end(y, x, [0.0, _PROBE]) * _scale(size))


def bend_of_picture(setting: Setting, k: float, size: int) -> Bend:
    """Measures the bend on a picture of the line that is warped: the centre of its light, row by row."""
    import jax.numpy as jnp

    x, _ = _normalized(size)
    width = 2 / _scale(size)
    warped = np.asarray(picture(setting, k, jnp.exp(-0.5 * ((x - _PROBE) / width) ** 2)))
    columns = np.arange(size)
    total = warped.sum(axis=1)
    centers = np.where(total > _DARK, warped @ columns / np.where(total > _DARK, total, 1), np.nan)
    frame = jl.Frame.half_diagonal(size, size)
    rows = np.asarray(frame.denormalize(jnp.array([[0.0, 0.0], [0.0, _PROBE]])))[:, 1]
    return Bend(_middle_less_end(columns, centers, rows))


def _middle_less_end(y: np.ndarray, x: np.ndarray, at: Sequence[float] | np.ndarray) -> float:
    """The x of a curve at a first y less that at a second; NaN where the curve does not reach."""
    seen = np.isfinite(x)
    if not seen.any():
        return float("nan")
    found = np.interp(np.asarray(at), y[seen], x[seen], left=np.nan, right=np.nan)
    return float(found[0] - found[1])


def _normalized(size: int) -> tuple[Float[Array, "size size"], Float[Array, "size size"]]:
    import jax.numpy as jnp

    x, y = jnp.meshgrid(jnp.arange(float(size)), jnp.arange(float(size)))
    points = jl.Frame.half_diagonal(size, size).normalize(jnp.stack([x, y], axis=-1))
    return points[..., 0], points[..., 1]


def _scale(size: int) -> float:
    """Pixels per unit."""
    return size * HALF


def curve_panel(
    curves: Mapping[tuple[Setting, float], Sequence[np.ndarray]],
    names: Mapping[tuple[Setting, float], str],
    k: Sequence[float],
    lines: int,
) -> Figure:
    """Draws the grid's lines in the output, over the straight grid, cut at the output's frame."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    figure, places = _panel(k, names)
    at = np.linspace(-HALF, HALF, lines)
    straight = [[(one, -HALF), (one, HALF)] for one in at] + [[(-HALF, one), (HALF, one)] for one in at]
    for key, axes in places.items():
        frame = Rectangle(
            (-HALF, -HALF), 2 * HALF, 2 * HALF, fill=False, edgecolor=figures.MUTED, linewidth=0.8, clip_on=False
        )
        axes.add_collection(LineCollection(straight, colors=figures.FAINT, linewidths=0.7))
        axes.add_collection(LineCollection(list(curves[key]), colors=figures.BLUE, linewidths=1.1))
        axes.add_patch(frame)
        axes.set_xlim(-HALF, HALF)
        axes.set_ylim(HALF, -HALF)
        axes.set_aspect("equal")
    return figure


def picture_panel(
    pictures: Mapping[tuple[Setting, float], np.ndarray], names: Mapping[tuple[Setting, float], str], k: Sequence[float]
) -> Figure:
    """Draws pictures of the grid through the lenses."""
    figure, places = _panel(k, names)
    for key, axes in places.items():
        figures.show_image(axes, pictures[key], 1.0)
    return figure


def _panel(
    k: Sequence[float], names: Mapping[tuple[Setting, float], str]
) -> tuple[Figure, dict[tuple[Setting, float], Axes]]:
    """An empty panel with its headings above and, below each place, k and what it makes of straight lines."""
    side = (figures.WIDTH - 2 * _MARGIN - (len(SETTINGS) - 1) * _GAP) / len(SETTINGS)
    figure = figures.new_figure(figures.WIDTH, _MARGIN + _HEAD + len(k) * (side + _NOTE + _GAP) - _GAP, by_hand=True)
    places: dict[tuple[Setting, float], Axes] = {}
    for column, setting in enumerate(SETTINGS):
        left = _MARGIN + column * (side + _GAP)
        for row, value in enumerate(k):
            axes = figures.place(figure, left, _MARGIN + _HEAD + row * (side + _NOTE + _GAP), side, side)
            figures.bare(axes)
            sign = f"{value:+g}".replace("-", "−")
            axes.set_xlabel(f"k = {sign}: {names[setting, value]}", labelpad=4)
            places[setting, value] = axes
        title, formula = _HEADINGS[setting]
        figure.text(
            (left + side / 2) / figures.WIDTH,
            1 - _MARGIN / figure.get_size_inches()[1],
            f"{title}\n{formula}",
            ha="center",
            va="top",
            linespacing=1.5,
        )
    return figure, places
