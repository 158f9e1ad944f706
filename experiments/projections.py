"""Figure 5: integral projections of an image under barrel and pincushion distortion, and how far they moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, model_validator
from rich.console import Console

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import (
    ConfigError,
    Configuration,
    Experiment,
    Image,
    Outcome,
    Value,
    Warp,
    load_source,
    plain_table,
    write_csv,
    write_rows,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEADER = (
    "k",
    "distortion",
    "profile",
    "largest_change",
    "measured",
    "least_px",
    "most_px",
    "median_error_px",
    "within_2_px",
)
# Of the expected displacement, in pixels: what counts as near.
_NEAR = 2.0
_MEANS = {"x": "columns", "y": "rows"}
Axis = Literal["x", "y"]
AXES: tuple[Axis, ...] = ("x", "y")
"""Along which a profile runs: `x` has the mean of each column, `y` that of each row."""
# How far beyond the outermost centres a source may lie, in pixels: coordinates are rounded.
_EDGE = 1e-3
_TITLE, _GAP, _MARGIN, _TICKS = 0.25, 0.14, 0.05, 0.5
# A profile's height, as a share of the picture's side.
_STRIP = 0.42
# Of a measured displacement from one element to the next, in pixels.
_JUMP = 2.0
_COLORS = (figures.VERMILLION, figures.BLUE, figures.ORANGE)
_LABELS = {"x": "column x  [px]", "y": "row y  [px]"}


class ProjectionsExperiment(Experiment):
    """Integral projections of an image and of what one-parameter lenses make of it: Figure 5.

    Attributes:
        image: The image.
        k: Coefficients of Section 2.4, where 1 + k r² takes output to source: k > 0 is barrel.
        window: Length of the pieces of a projection that are compared, in pixels, odd.
        largest: The largest displacement that is looked for, in pixels.
        least_score: Correlation of two pieces below which they do not count as the same.
        warp: How the image is sampled.
    """

    image: Image
    k: list[float] = Field(default=[0.3, -0.3], min_length=1, max_length=3)
    window: int = Field(default=31, ge=3)
    largest: int = Field(default=16, ge=1)
    least_score: float = Field(default=0.9, ge=-1, le=1)
    warp: Warp = Warp()

    @model_validator(mode="after")
    def _check(self) -> ProjectionsExperiment:
        if self.window % 2 == 0:
            raise ValueError(f"'window' must be odd, got {self.window}")
        if len(set(self.k)) < len(self.k):
            raise ValueError("'k' must hold each coefficient once")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: `table.csv` sums up, `profiles_x.csv` and `profiles_y.csv` hold every element.

        Raises:
            ConfigError: the image is too small for the window or the displacements.
        """
        source = load_source(configuration, self.image)
        pixels = source.gray
        shorter = min(pixels.shape)
        if self.window > shorter or self.largest >= shorter - 2:
            raise ConfigError(
                f"{configuration.path}: window and largest: got {self.window} and {self.largest}; the image "
                f"has only {pixels.shape[0]} rows and {pixels.shape[1]} columns"
            )
        pictures, found = {}, {}
        for k in self.k:
            pictures[k], seen = distorted(pixels, k, self.warp)
            found[k] = profiles(
                pixels, pictures[k], seen, k, window=self.window, largest=self.largest, least_score=self.least_score
            )
        table: list[tuple[Value, ...]] = []
        rows: list[list[str]] = []
        for k, both in found.items():
            for axis, profile in both.items():
                change, measured, least, most, error, near = summary = _summary(profile)
                table.append((k, kind_of(k), axis, *summary))
                rows.append(
                    [
                        f"{k:+g} {kind_of(k)}",
                        _MEANS[axis],
                        f"{change:.1f}",
                        f"{100 * measured:.0f} %",
                        f"{least:+.1f} … {most:+.1f}",
                        f"{error:.2f}",
                        f"{100 * near:.0f} %",
                    ]
                )
        write_rows(folder, _HEADER, table)
        for axis in AXES:
            write_csv(folder, _elements(axis, found), f"profiles_{axis}.csv")
        names = {k: f"k = {k:+g}: {kind_of(k)}".replace("-", "−") for k in self.k}
        figures.save(projection_panel(pixels, source.peak, pictures, found, names), folder / "projections.jpg")
        figures.save(displacement_chart(found, names), folder / "displacement.svg")
        header = ["k", "means", "largest\nchange", "found", "displacement\npx", "median\nerror, px", "within\n2 px"]
        return Outcome([source.facts], {}, [plain_table(self.heading, header, rows)])


def kind_of(k: float) -> str:
    """Returns what Section 2.4 calls a coefficient."""
    return "none" if k == 0 else "barrel" if k > 0 else "pincushion"


def _summary(profile: Profile) -> tuple[float, ...]:
    seen, error = np.isfinite(profile.measured), np.abs(profile.error)
    change = float(np.nanmax(np.abs(profile.distorted - profile.initial)))
    if not len(error):
        return change, 0.0, *[np.nan] * 4
    moved = profile.measured[seen]
    return (
        change,
        float(seen.mean()),
        float(moved.min()),
        float(moved.max()),
        float(np.median(error)),
        float(np.mean(error <= _NEAR)),
    )


def _elements(axis: Axis, found: dict[float, dict[Axis, Profile]]) -> dict[str, np.ndarray]:
    first = next(iter(found.values()))[axis]
    columns: dict[str, np.ndarray] = {axis: np.arange(len(first.initial)), "initial": first.initial}
    for k, both in found.items():
        profile = both[axis]
        columns |= {
            f"k={k:g}": profile.distorted,
            f"measured(k={k:g})": profile.measured,
            f"expected(k={k:g})": profile.expected,
        }
    return columns


@dataclass(frozen=True, eq=False)
class Profile:
    """One projection of the distorted picture against that of the initial one, element by element.

    Attributes:
        initial: Gray levels.
        distorted: Likewise; NaN where the whole row or column has no source.
        measured: How far the initial profile's features have moved along it, in pixels; NaN where not found.
        score: The correlation of the match; NaN likewise.
        expected: What the lens lets expect: the mean displacement of the pixels of the window, weighted by their
            squared slopes along the profile; NaN where there is no slope.
    """

    initial: Float[np.ndarray, " length"]
    distorted: Float[np.ndarray, " length"]
    measured: Float[np.ndarray, " length"]
    score: Float[np.ndarray, " length"]
    expected: Float[np.ndarray, " length"]

    @property
    def error(self) -> Float[np.ndarray, " length"]:
        """Measured less expected displacement, where there are both."""
        error = self.measured - self.expected
        return error[np.isfinite(error)]


def distorted(
    pixels: Float[np.ndarray, "height width"], k: float, warp: Warp
) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Returns the picture that Section 2.4 makes, 1 + k r² taking output to source, and which pixels have a source."""
    lens, (height, width) = _lens(k, pixels), pixels.shape
    picture = jl.undistort_image(
        pixels, lens, method=warp.method, border=warp.border, fill=warp.fill, antialias=warp.antialias
    )
    x, y = np.moveaxis(np.asarray(jl.undistortion_map(lens, height, width)), -1, 0)
    # Further out the border's value would be mixed in.
    seen = (x >= -_EDGE) & (x <= width - 1 + _EDGE) & (y >= -_EDGE) & (y <= height - 1 + _EDGE)
    return np.asarray(picture), seen


def profiles(
    pixels: Float[np.ndarray, "height width"],
    picture: Float[np.ndarray, "height width"],
    seen: Bool[np.ndarray, "height width"],
    k: float,
    *,
    window: int,
    largest: int,
    least_score: float,
) -> dict[Axis, Profile]:
    """Compares the projections of a picture and of its distorted one, over the pixels that have a source."""
    before, after = jl.profiles.integral_projections(pixels), jl.profiles.integral_projections(picture, mask=seen)
    pairs = {
        "x": (before.vertical, after.vertical, after.vertical_valid),
        "y": (before.horizontal, after.horizontal, after.horizontal_valid),
    }
    expected, found = _expected(pixels, k, window), {}
    for axis in AXES:
        reference, other, there = pairs[axis]
        result = jl.profiles.profile_displacement(reference, other, window=window, largest=largest)
        good = np.asarray(result.valid) & (np.asarray(result.score) >= least_score)
        found[axis] = Profile(
            np.asarray(reference),
            np.where(there, other, np.nan),
            np.where(good, result.displacement, np.nan),
            np.where(good, result.score, np.nan),
            expected[axis],
        )
    return found


def _expected(pixels: Float[np.ndarray, "height width"], k: float, window: int) -> dict[Axis, np.ndarray]:
    height, width = pixels.shape
    from jaxlens.warping import pixel_grid

    frame, grid = jl.Frame.half_diagonal(height, width), pixel_grid(height, width, pixels.dtype)
    # Section 2.4 maps output to source: features go where its inverse takes them.
    inverse = _lens(k, pixels).invert(frame.normalize(grid))
    moved = np.asarray(frame.denormalize(inverse.points) - grid)
    found: dict[Axis, np.ndarray] = {}
    for index, axis in enumerate(AXES):
        # Along x (index 0) runs the array's second axis.
        weight = np.where(inverse.valid, np.gradient(pixels, axis=1 - index) ** 2, 0)
        total, slope = (
            np.convolve(one.sum(axis=index), np.ones(window), "same") for one in (weight * moved[..., index], weight)
        )
        there = slope > 1e-9 * slope.max()
        found[axis] = np.where(there, total / np.where(there, slope, 1), np.nan)
    return found


def _lens(k: float, pixels: Float[np.ndarray, "height width"]) -> jl.RadialPolynomial:
    return jl.RadialPolynomial(np.asarray([k], pixels.dtype))


def projection_panel(
    initial: np.ndarray,
    peak: float,
    pictures: Mapping[float, np.ndarray],
    found: Mapping[float, Mapping[Axis, Profile]],
    names: Mapping[float, str],
) -> Figure:
    """Draws each picture with the means of its columns below it and those of its rows to its right.

    The initial picture's profiles lie in gray under those of the distorted ones.
    """
    aspect, columns = figures.cell_aspect(initial), 1 + len(pictures)
    step = (figures.WIDTH - 2 * _MARGIN - _TICKS) / columns
    side = (step - _GAP) / (1 + _STRIP)
    strip = side * _STRIP
    figure = figures.new_figure(figures.WIDTH, 2 * _MARGIN + _TITLE + side * aspect + 0.05 + strip, by_hand=True)
    top = _MARGIN + _TITLE
    first = next(iter(found.values()))
    shown: list[tuple[np.ndarray, str, Mapping[Axis, Profile] | None, str]] = [
        (initial, "initial", None, figures.MUTED),
        *((pictures[k], names[k], found[k], color) for k, color in zip(pictures, _COLORS, strict=False)),
    ]
    drawn = [one for both in found.values() for one in both.values()]
    most = 1.06 * max(float(np.nanmax(line)) for one in drawn for line in (one.initial, one.distorted))
    for index, (picture, title, profile, color) in enumerate(shown):
        left = _MARGIN + _TICKS + index * step
        figures.show_image(figures.place(figure, left, top, side, side * aspect), picture, peak, title=title)
        below = figures.place(figure, left, top + side * aspect + 0.05, side, strip)
        beside = figures.place(figure, left + side + 0.05, top, strip, side * aspect)
        for axis, axes in zip(AXES, (below, beside), strict=True):
            at = np.arange(len(first[axis].initial))
            _line(
                axes, axis, at, first[axis].initial, color=figures.MUTED if profile is None else "#A0A0A0", filled=True
            )
            if profile is not None:
                _line(axes, axis, at, profile[axis].distorted, color=color)
        below.set_xlim(-0.5, initial.shape[1] - 0.5)
        below.set_ylim(most, 0)
        beside.set_ylim(initial.shape[0] - 0.5, -0.5)
        beside.set_xlim(0, most)
        for axes, hidden in ((below, "top"), (beside, "left")):
            axes.spines[["top", "right", "bottom", "left"]].set_visible(False)
            axes.spines[hidden].set_visible(True)
            axes.set_xticks([])
            axes.set_yticks([])
        if index == 0:
            level = _round_level(most)
            below.set_yticks([0, level], ["0", f"{level:g}"])
            below.set_ylabel("gray levels", labelpad=2, fontsize=8.5)
            axes = figures.place(figure, left + side + 0.05, top + side * aspect + 0.05, strip, strip)
            figures.bare(axes)
            text = "means of\n↑ rows\n← columns"
            axes.text(0.1, 0.85, text, va="top", color=figures.MUTED, fontsize=8, linespacing=1.3)
    return figure


def displacement_chart(found: Mapping[float, Mapping[Axis, Profile]], names: Mapping[float, str]) -> Figure:
    """Draws how far the profiles' features have moved, and how far the lens should have moved them."""
    from matplotlib.lines import Line2D

    figure = figures.new_figure(figures.WIDTH, 3.1)
    expected = Line2D([], [], color=figures.MUTED, linewidth=1.2, linestyle=(0, (4, 2)), label="expected of the lens")
    for axis, axes in zip(AXES, figure.subplots(1, 2, sharey=True), strict=True):
        for (k, both), color in zip(found.items(), _COLORS, strict=False):
            profile = both[axis]
            at = np.arange(len(profile.initial))
            axes.plot(at, profile.expected, color=color, linewidth=1.2, linestyle=(0, (4, 2)))
            # A jump between neighbours is another match, not a path.
            broken = np.diff(profile.measured, prepend=np.nan)
            line = np.where(np.abs(broken) > _JUMP, np.nan, profile.measured)
            axes.plot(at, line, color=color, linewidth=2, label=names[k])
        axes.set_xlabel(_LABELS[axis])
        axes.set_title("means of columns, along x" if axis == "x" else "means of rows, along y", loc="left")
        axes.set_xlim(0, len(next(iter(found.values()))[axis].initial) - 1)
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        if axis == "x":
            axes.set_ylabel("displacement  [px]")
            handles = [*axes.get_legend_handles_labels()[0], expected]
            figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _line(axes: Axes, axis: Axis, at: np.ndarray, values: np.ndarray, *, color: str, filled: bool = False) -> None:
    if filled and axis == "x":
        axes.fill_between(at, values, color=figures.FAINT, linewidth=0)
    elif filled:
        axes.fill_betweenx(at, values, color=figures.FAINT, linewidth=0)
    pair = (at, values) if axis == "x" else (values, at)
    axes.plot(*pair, color=color, linewidth=0.9 if filled else 1.4)


def _round_level(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is below a number."""
    power = 10 ** np.floor(np.log10(max(most, 1e-12)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= most))
