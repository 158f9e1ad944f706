"""The conclusion's remark: pincushion distortion makes self-calibration under-estimate the focal length.

A rotating camera with a lens finds its focal length from its pictures, before and after the lens is taken out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from rich.console import Console, RenderableType
from rich.text import Text

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import Configuration, Experiment, Outcome, Table, plain_table, progress_bar, write_csv

if TYPE_CHECKING:
    from jaxtyping import Array
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Of the sets of rotations.
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# A millionth, in percent.
_MILLIONTH = 1e-4


class Rotations(Table):
    """A set of rotations of a camera.

    Attributes:
        name: What figures and tables call it.
        turns: Rotation vectors [pan, tilt, roll] in degrees, from one picture to the next: about the camera's y, x
            and z axis (y down, x right, z forward).
    """

    name: str
    turns: list[Annotated[list[float], Field(min_length=3, max_length=3)]] = Field(min_length=1)


class RotationExperiment(Experiment):
    """The focal length that a rotating camera with a distorting lens finds for itself, as the conclusion claims.

    Attributes:
        k: Coefficients of the lens x_d = x_u (1 + k r²), r in half diagonals; positive is pincushion.
        focal_length: Of the camera, in half diagonals of its picture.
        aspect: Width over height of the picture.
        rotations: The sets.
        points: Of the calibration from which a lens is fitted, spread evenly over the picture.
        noise: Standard deviation of a coordinate of these points, in half diagonals.
        seeds: Calibrations of each lens.
    """

    k: list[float] = Field(min_length=2)
    focal_length: float = Field(default=1.5, gt=0)
    aspect: float = Field(default=4 / 3, gt=0)
    rotations: list[Rotations] = Field(min_length=1, max_length=7)
    points: int = Field(default=200, ge=4, le=100_000)
    noise: float = Field(default=0.001, gt=0)
    seeds: int = Field(default=20, ge=2, le=1000)

    @model_validator(mode="after")
    def _check(self) -> RotationExperiment:
        if any(b <= a for a, b in itertools.pairwise(self.k)):
            raise ValueError(f"'k' must grow, got {self.k}")
        names = [one.name for one in self.rotations]
        if len(set(names)) < len(names):
            raise ValueError("'rotations' must have different names")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: a row of `table.csv` is a set of rotations and a lens."""
        with progress_bar(progress, self.name, 1) as advance:
            found = focal_length_biases(self)
            advance(1)
        k = np.asarray(self.k)
        write_csv(
            folder,
            {
                "rotations": [one.name for one in found for _ in k],
                "k": [value for _ in found for value in k],
                "bias": np.concatenate([one.raw for one in found]),
                "bias_lens_known": np.concatenate([one.known for one in found]),
                "rms_bias_lens_fitted": np.concatenate([one.fitted_rms for one in found]),
            },
        )
        figures.save(_bias_chart(k, found, self.noise), folder / "bias.svg")
        return Outcome([], _facts(k, found), _report(self, k, found))


@dataclass(frozen=True, eq=False)
class Biases:
    """Relative errors of self-calibrated focal lengths, estimate / truth − 1, one entry a lens.

    Attributes:
        name: Of the set of rotations.
        raw: With the lens in place; infinite where no focal length fits.
        known: After undistorting with the lens itself.
        fitted: `(lenses, seeds)`, after undistorting with lenses fitted to noisy points.
    """

    name: str
    raw: Float[np.ndarray, " lenses"]
    known: Float[np.ndarray, " lenses"]
    fitted: Float[np.ndarray, "lenses seeds"]

    @property
    def fitted_rms(self) -> Float[np.ndarray, " lenses"]:
        """The root of the mean square over the seeds."""
        return np.sqrt(np.mean(self.fitted**2, axis=1))


def rotations_of(turns: Sequence[Sequence[float | int]], dtype: str) -> Float[Array, "views 3 3"]:
    """Returns the matrices of rotation vectors [pan, tilt, roll] in degrees."""
    pan, tilt, roll = np.radians(np.asarray(turns, np.float64)).T
    return jl.fitting.rotation_matrix(np.stack([tilt, pan, roll], axis=1).astype(dtype))


def focal_length_biases(experiment: RotationExperiment) -> list[Biases]:
    """Measures the bias of every lens of the experiment, for each set of rotations.

    The homographies of all sets come from one program, whose compilation is most of the work.
    """
    import jax
    import jax.numpy as jnp

    dtype, sets = experiment.dtype, [one.turns for one in experiment.rotations]
    keys = jax.random.split(jax.random.key(experiment.seed), (len(experiment.k), experiment.seeds))
    found = jax.jit(_homographies, static_argnames=("aspect", "points"))(
        jnp.asarray(experiment.k, dtype),
        keys,
        rotations_of(list(itertools.chain(*sets)), dtype),
        jnp.asarray(experiment.focal_length, dtype),
        jnp.asarray(experiment.noise, dtype),
        aspect=experiment.aspect,
        points=experiment.points,
    )
    focal_length = jax.jit(
        jax.vmap(jax.vmap(lambda one: jl.self_calibration.self_calibrate_focal_length(one).focal_length))
    )
    biases, first = [], 0
    for rotations in experiment.rotations:
        last = first + len(rotations.turns)
        lengths = np.asarray(focal_length(found[:, :, first:last]), np.float64) / experiment.focal_length
        biases.append(Biases(rotations.name, lengths[:, 0] - 1, lengths[:, 1] - 1, lengths[:, 2:] - 1))
        first = last
    return biases


def _homographies(
    k: Float[Array, " lenses"],
    keys: Array,
    rotations: Float[Array, "views 3 3"],
    focal_length: Float[Array, ""],
    noise: Float[Array, ""],
    *,
    aspect: float,
    points: int,
) -> Float[Array, "lenses cases views 3 3"]:
    """Homographies with the lens in place, with the lens itself taken out, and with each of the fitted ones."""
    import jax
    import jax.numpy as jnp

    def of_lens(k: Array, keys: Array) -> Array:
        camera = jl.self_calibration.RotatingCamera(jl.RadialPolynomial(k[None]), focal_length, aspect=aspect)
        before, after, seen = jax.vmap(camera.correspondences)(rotations)
        fitted = jax.vmap(lambda key: _fitted(camera, key, points, noise))(keys)
        # No lens at all is one, too.
        kappa = jnp.concatenate([jnp.stack([0 * k, k]), fitted])

        def undistorted(kappa: Array) -> Array:
            lens = jl.RadialPolynomial(kappa[None])
            source, target = lens.invert(before).points, lens.invert(after).points
            return jax.vmap(jl.deformations.direct_linear_transform)(source, target, seen.astype(before.dtype))

        return jax.lax.map(undistorted, kappa)

    return jax.lax.map(lambda one: of_lens(*one), (k, keys))


def _fitted(
    camera: jl.self_calibration.RotatingCamera, key: Array, points: int, noise: Float[Array, ""]
) -> Float[Array, ""]:
    """The coefficient as a calibration finds it from points with noise, spread evenly over the picture."""
    import jax
    import jax.numpy as jnp

    places, errors = jax.random.split(key)
    dtype = camera.half_field.dtype
    observed = camera.half_field[None] * jax.random.uniform(places, (points, 2), dtype, -1, 1)
    ideal = camera.lens.invert(observed).points
    seen = observed + noise * jax.random.normal(errors, observed.shape, dtype)
    lens = jl.fitting.fit_points(jl.RadialPolynomial(jnp.zeros(1, dtype)), ideal, seen).lens
    assert isinstance(lens, jl.RadialPolynomial)
    return lens.coefficients[0]


def _facts(k: np.ndarray, found: list[Biases]) -> dict[str, object]:
    return {
        "short_for_every_pincushion": all(bool(np.all(one.raw[k > 0] < 0)) for one in found),
        "long_for_every_barrel": all(bool(np.all(one.raw[k < 0] > 0)) for one in found),
        "grows_with_the_lens": all(_grows(one.raw) for one in found),
        "largest_bias_lens_known": max(float(np.max(np.abs(one.known))) for one in found),
        "largest_rms_bias_lens_fitted": max(float(np.max(one.fitted_rms)) for one in found),
        "without_a_focal_length": sum(int(np.sum(np.isinf(one.raw))) for one in found),
    }


def _grows(bias: np.ndarray) -> bool:
    """Whether the bias falls from one lens to the next: away from k = 0 its size grows to both sides."""
    finite = bias[np.isfinite(bias)]
    # No focal length at all is the end of the growth: such lenses come first.
    ends_first = bool(np.all(np.isinf(bias[: len(bias) - len(finite)])))
    return ends_first and bool(np.all(np.diff(finite) < 0))


def _report(experiment: RotationExperiment, k: np.ndarray, found: list[Biases]) -> list[RenderableType]:
    shown = np.unique(np.linspace(0, len(k) - 1, min(len(k), 8)).round().astype(int))
    header = ["bias, %, by k", *(f"{k[index]:+.3g}" for index in shown)]
    rows = [[one.name, *(f"{100 * one.raw[index]:+.1f}" for index in shown)] for one in found]
    facts = _facts(k, found)
    verdict = [
        ("too short for every pincushion (k > 0)", facts["short_for_every_pincushion"]),
        ("too long for every barrel (k < 0)", facts["long_for_every_barrel"]),
        ("the more so the stronger the lens", facts["grows_with_the_lens"]),
    ]
    lines = [f"{text}: {'yes' if holds else 'no'}" for text, holds in verdict]
    return [
        plain_table(experiment.title or experiment.name, header, rows),
        Text(
            "; ".join(lines)
            + f".\nUndistorted with the lens itself, a bias of at most {facts['largest_bias_lens_known']:.1e} is left; "
            f"with a lens fitted to {experiment.points} points ± {experiment.noise:g} half diagonals, at most "
            f"{100 * float(str(facts['largest_rms_bias_lens_fitted'])):.2f} % (RMS)."
        ),
    ]


def _bias_chart(k: np.ndarray, found: Sequence[Biases], noise: float) -> Figure:
    """Draws the bias against the coefficient, and what is left of it once the lens is taken out.

    Args:
        k: Coefficients of the lenses; pincushion is positive.
        found: The biases, for each set of rotations.
        noise: Of the points that lenses were fitted to, in half diagonals.
    """
    from matplotlib.ticker import MaxNLocator

    figure = figures.new_figure(figures.WIDTH, 4.0)
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1))
    for one, color, marker in zip(found, figures.PALETTE, _MARKERS, strict=False):
        bias = 100 * np.where(np.isfinite(one.raw), one.raw, np.nan)
        left.plot(
            k, bias, "-", marker=marker, color=color, markersize=4.5, linewidth=1.3, label=figures.plain(one.name)
        )
    for axes in (left, right):
        axes.axvline(0, color=figures.MUTED, linewidth=0.8, zorder=0)
        axes.set_xlabel("k  [per squared half diagonal]")
        axes.xaxis.set_major_locator(MaxNLocator(5, symmetric=True))
        axes.grid(axis="y")
        axes.set_axisbelow(True)
    left.axhline(0, color=figures.MUTED, linewidth=0.8, zorder=0)
    left.set_title("the lens in place", loc="left")
    left.set_ylabel("estimate / true focal length − 1  [%]")
    left.text(0.96, 0.27, "pincushion, k > 0:\ntoo short", transform=left.transAxes, ha="right", color=figures.MUTED)
    left.text(0.48, 0.72, "barrel, k < 0:\ntoo long", transform=left.transAxes, ha="right", color=figures.MUTED)
    right.set_yscale("log")
    right.set_title("before and after undistortion", loc="left")
    right.set_ylabel("|estimate / truth − 1|  [%]")
    raw = [np.where(np.isfinite(one.raw), np.abs(one.raw), np.nan) for one in found]
    _band(right, k, raw, figures.VERMILLION, "the lens in place", above=False)
    _band(
        right,
        k,
        [one.fitted_rms for one in found],
        figures.BLUE,
        f"undone by a fitted lens\n(points ± {noise:g}; RMS)",
        above=False,
    )
    _band(
        right,
        k,
        [np.maximum(np.abs(one.known), 1e-17) for one in found],
        figures.GREEN,
        "undone by the lens itself",
        above=True,
    )
    right.axhspan(1e-20, _MILLIONTH, color=figures.FAINT, alpha=0.45, linewidth=0, zorder=-1)
    right.text(
        0.97,
        0.6 * _MILLIONTH,
        "below one millionth",
        transform=right.get_yaxis_transform(),
        ha="right",
        va="top",
        color=figures.MUTED,
        fontsize=8,
    )
    lowest = min(float(np.min(np.abs(one.known))) for one in found)
    right.set_ylim(max(20 * lowest, 1e-16), 1e3)
    handles, _ = left.get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 3), columnspacing=1.4)
    return figure


def _band(axes: Axes, k: np.ndarray, sets: Sequence[np.ndarray], color: str, label: str, *, above: bool) -> None:
    """The range over the sets of rotations, in percent, and their middle as a line with its name."""
    percent = 100 * np.stack(sets)
    low, high, middle = (np.nanmin(percent, axis=0), np.nanmax(percent, axis=0), np.nanmedian(percent, axis=0))
    axes.fill_between(k, low, high, color=color, alpha=0.3, linewidth=0)
    axes.plot(k, middle, "-o", color=color, markersize=4)
    place = np.nanmax(high) * 3 if above else np.nanmin(low) / 2.5
    axes.text(0.04, place, label, color=color, transform=axes.get_yaxis_transform(), va="bottom" if above else "top")
