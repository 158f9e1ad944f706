"""Lenses recovered from points and from pictures, their errors beside the predicted standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from rich.console import Console, RenderableType

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import (
    Configuration,
    Experiment,
    Image,
    Kappa,
    Outcome,
    load_source,
    plain_table,
    progress_bar,
    write_csv,
)

if TYPE_CHECKING:
    from jaxtyping import Array
    from matplotlib.figure import Figure

Noise = Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]
_TITLES = {"points": "from points", "pictures": "from a pair of pictures"}
# From one lens to the next, the factor on the noise at which it is drawn.
_APART = 1.05


class InversionExperiment(Experiment):
    """Lenses recovered from what they did: from points, and from pairs of pictures, under noise.

    Attributes:
        image: The undistorted image.
        kappa: The lenses, all of the same order.
        picture_noise: Standard deviations of the noise of gray values, as shares of the peak.
        picture_seeds: Distorted pictures of each lens and noise level.
        gain: Of the distorted picture's gray values, unknown to the fit.
        offset: Likewise, as a share of the peak.
        point_noise: Standard deviations of the noise of a coordinate, in pixels.
        point_seeds: Sets of points of each lens and noise level.
        points: In a set, spread evenly over the distorted picture.
    """

    image: Image
    kappa: list[Kappa] = Field(min_length=1, max_length=7)
    picture_noise: Noise
    picture_seeds: int = Field(default=5, ge=2, le=1000)
    gain: float = Field(default=0.9, gt=0)
    offset: float = 0.05
    point_noise: Noise
    point_seeds: int = Field(default=200, ge=2, le=10000)
    points: int = Field(default=200, ge=4, le=100_000)

    @model_validator(mode="after")
    def _check(self) -> InversionExperiment:
        if len({len(one) for one in self.kappa}) > 1:
            raise ValueError("'kappa' must hold vectors of one length")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: a row of `table.csv` is a lens, what it was recovered from, and a noise level."""
        import jax
        import jax.numpy as jnp

        source = load_source(configuration, self.image)
        pixels = source.gray
        found: list[Recovery] = []
        levels = len(self.point_noise) + len(self.picture_noise)
        with progress_bar(progress, self.name, len(self.kappa) * levels) as advance:
            for index, kappa in enumerate(self.kappa):
                key = jax.random.fold_in(jax.random.key(self.seed), index)
                truth = jnp.asarray(kappa, pixels.dtype)
                for noise in self.point_noise:
                    found.append(
                        from_points(truth, noise, key, *pixels.shape, count=self.points, seeds=self.point_seeds)
                    )
                    advance(1)
                for noise in self.picture_noise:
                    found.append(
                        from_pictures(
                            truth,
                            noise,
                            key,
                            pixels,
                            peak=source.peak,
                            gain=self.gain,
                            offset=self.offset,
                            seeds=self.picture_seeds,
                        )
                    )
                    advance(1)
        write_csv(folder, _columns(found))
        figures.save(error_chart(found), folder / "errors.svg")
        return Outcome([source.facts], {"failed_fits": sum(one.failed for one in found)}, _report(self, found))


def _columns(found: list[Recovery]) -> dict[str, list]:
    order = len(found[0].kappa)
    columns: dict[str, list] = {
        "from": [one.method for one in found],
        **{f"kappa{i + 1}": [one.kappa[i] for one in found] for i in range(order)},
        "noise": [one.noise for one in found],
        "unit": [one.unit for one in found],
        "fits": [one.fits for one in found],
        "failed": [one.failed for one in found],
    }
    for i in range(order):
        columns[f"rms_error{i + 1}"] = [one.errors[i] for one in found]
        columns[f"predicted{i + 1}"] = [one.predicted[i] for one in found]
    return columns


def _report(experiment: InversionExperiment, found: list[Recovery]) -> list[RenderableType]:
    order = len(found[0].kappa)
    header = ["from", "κ", "noise", *(f"κ{i + 1}: RMS error\n(of predicted)" for i in range(order))]
    rows = []
    for one in found:
        row = [one.method, ", ".join(f"{value:g}" for value in one.kappa), f"{one.noise:g} {one.unit}"]
        for error, predicted in zip(one.errors, one.predicted, strict=True):
            noisy = one.noise > 0 and predicted > 0
            row.append(f"{error:.2g} ({error / predicted:.2f})" if noisy else f"{error:.2g}")
        rows.append(row)
    return [plain_table(experiment.heading, header, rows)]


@dataclass(frozen=True)
class Recovery:
    """How well a lens came back.

    Attributes:
        method: What it was recovered from, `points` or `pictures`.
        kappa: The lens.
        noise: Of the data.
        unit: Of the noise.
        fits: How many data sets were made.
        failed: Fits that did not converge; they are in none of the figures below.
        errors: For each coefficient the root of the mean squared error.
        predicted: For each the root of the mean predicted variance.
    """

    method: str
    kappa: tuple[float, ...]
    noise: float
    unit: str
    fits: int
    failed: int
    errors: tuple[float, ...]
    predicted: tuple[float, ...]


def from_points(
    kappa: Float[Array, " order"], noise: float, key: Array, height: int, width: int, *, count: int, seeds: int
) -> Recovery:
    """Recovers a lens from points, all sets of them under one `vmap`.

    Args:
        kappa: The lens.
        noise: Standard deviation of a coordinate, in pixels.
        key: Of the random numbers.
        height: Of the picture over which observed points are spread.
        width: Of it.
        count: Points in a set.
        seeds: Sets.
    """
    import jax

    fits = jax.jit(_fits_of_points, static_argnames=("height", "width", "count"))(
        kappa, noise, jax.random.split(key, seeds), height=height, width=width, count=count
    )
    return _recovery("points", kappa, noise, "px", fits.values, fits.standard_errors, fits.status)


def _fits_of_points(
    kappa: Float[Array, " order"], noise: float | Float[Array, ""], keys: Array, *, height: int, width: int, count: int
) -> jl.fitting.Fit:
    """Makes a set of points for each key, and fits each; one program for every lens and level of noise."""
    import jax
    import jax.numpy as jnp

    frame, lens = jl.Frame.half_diagonal(height, width), jl.RadialPolynomial(kappa)
    size = jnp.asarray([width - 1, height - 1], kappa.dtype)

    def once(key: Array) -> jl.fitting.Fit:
        places, errors = jax.random.split(key)
        observed = jax.random.uniform(places, (count, 2), kappa.dtype) * size[None]
        ideal = lens.invert(frame.normalize(observed)).points
        observed = observed + noise * jax.random.normal(errors, (count, 2), kappa.dtype)
        return jl.fitting.fit_points(jl.RadialPolynomial(jnp.zeros_like(kappa)), ideal, observed, frame=frame)

    return jax.vmap(once)(keys)


def from_pictures(
    kappa: Float[Array, " order"],
    noise: float,
    key: Array,
    source: Float[np.ndarray, "height width"],
    *,
    peak: float,
    gain: float,
    offset: float,
    seeds: int,
) -> Recovery:
    """Recovers a lens from pairs of pictures, one after another.

    Args:
        kappa: The lens.
        noise: Standard deviation of a gray value of the distorted picture, as a share of the peak.
        key: Of the random numbers.
        source: The picture without the lens.
        peak: The largest gray value.
        gain: Of the distorted picture.
        offset: Of it, as a share of the peak.
        seeds: Pairs; without noise one is enough, for all are alike.
    """
    import jax
    import jax.numpy as jnp

    clean = gain * jl.distort_image(source, jl.RadialPolynomial(kappa)) + offset * peak
    start, values, errors, status = jl.RadialPolynomial(jnp.zeros_like(kappa)), [], [], []
    for one in jax.random.split(key, seeds if noise > 0 else 1):
        distorted = clean + noise * peak * jax.random.normal(one, clean.shape, clean.dtype)
        fit = jl.fitting.fit_images(start, source, distorted, throw=False)
        values.append(fit.values)
        errors.append(fit.standard_errors)
        status.append(fit.status)
    return _recovery("pictures", kappa, noise, "× peak", jnp.stack(values), jnp.stack(errors), jnp.stack(status))


def _recovery(
    method: str, kappa: Array, noise: float, unit: str, values: Array, errors: Array, status: Array
) -> Recovery:
    order = kappa.shape[0]
    good = np.asarray(status) == jl.fitting.FitStatus.CONVERGED
    deviations = (np.asarray(values)[:, :order] - np.asarray(kappa))[good]
    predicted = np.asarray(errors)[:, :order][good]
    return Recovery(
        method,
        tuple(float(value) for value in kappa),
        noise,
        unit,
        len(good),
        int(np.sum(~good)),
        tuple(float(value) for value in np.sqrt(np.mean(deviations**2, axis=0))),
        tuple(float(value) for value in np.sqrt(np.mean(predicted**2, axis=0))),
    )


def chance(fits: int) -> tuple[float, float]:
    """Returns the ends of the 95 % interval of a standard error, over the RMS of so many independent normal errors."""
    ratio = np.geomspace(0.01, 10, 4001)
    from .noise import chi_square_above

    # The sum of squared errors over the variance is distributed as χ².
    above = chi_square_above(fits / ratio**2, fits)
    low, high = np.interp([0.025, 0.975], above, ratio)
    return float(low), float(high)


def error_chart(found: Sequence[Recovery]) -> Figure:
    """Draws the errors of each coefficient against the noise, with the predicted standard errors as lines."""
    from matplotlib.lines import Line2D
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    methods = [method for method in _TITLES if any(one.method == method for one in found)]
    kappas = list(dict.fromkeys(one.kappa for one in found))
    order = len(kappas[0])
    figure = figures.new_figure(figures.WIDTH, 0.9 + 2.5 * order)
    places = figure.subplots(order, len(methods), squeeze=False, sharex="col")
    for column, method in enumerate(methods):
        for index in range(order):
            axes = places[index, column]
            for place, (color, kappa) in enumerate(zip(figures.PALETTE, kappas, strict=False)):
                rows = [one for one in found if one.method == method and one.kappa == kappa and one.noise > 0]
                # A little apart, so that no interval hides another.
                noise = np.array([one.noise for one in rows]) * _APART ** (place - 0.5 * (len(kappas) - 1))
                axes.plot(noise, [one.predicted[index] for one in rows], "-", color=color, linewidth=1.2)
                errors = np.array([one.errors[index] for one in rows])
                low, high = (errors * factor for factor in chance(rows[0].fits)) if rows else (errors, errors)
                axes.errorbar(
                    noise, errors, (errors - low, high - errors), fmt="o", color=color, markersize=5, elinewidth=0.9
                )
            levels = sorted({one.noise for one in found if one.method == method and one.noise > 0})
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xticks(levels, [f"{level:g}" for level in levels])
            axes.xaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.1g}"))
            axes.grid(axis="y")
            axes.set_title(f"κ{'₁₂₃₄₅₆₇₈'[index]}, {_TITLES[method]}", loc="left")
            axes.set_ylabel(f"error of κ{'₁₂₃₄₅₆₇₈'[index]}")
        units = [one.unit for one in found if one.method == method]
        places[-1, column].set_xlabel(f"noise [{units[0]}]")
    handles = [
        Line2D([], [], color=color, marker="o", markersize=5, label=figures.kappa_label(kappa))
        for color, kappa in zip(figures.PALETTE, kappas, strict=False)
    ]
    handles += [
        Line2D(
            [],
            [],
            color=figures.MUTED,
            linestyle="none",
            marker="o",
            markersize=5,
            label="RMS error found, 95 % interval",
        ),
        Line2D([], [], color=figures.MUTED, label="standard error predicted"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, columnspacing=1.2)
    return figure
