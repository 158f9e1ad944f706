"""The figures of a sweep."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxlens.diagnostics import multiplicity
from jaxlens.experiments.sources import Source
from jaxlens.experiments.sweep import SweepExperiment, charts
from jaxlens.experiments.sweep.coverage import coverage_chart
from jaxlens.experiments.sweep.scoring import deform_all
from jaxlens.figures.pictures import deformed_panel, error_panel
from jaxlens.figures.style import kappa_label, save
from jaxlens.lenses import RadialPolynomial
from jaxlens.warping import distortion_map

# Lenses that are drawn, and dots that a chart bears.
_MOST_PICTURES = 6
_MOST_DOTS = 12


def draw_pictures(
    source: Source, kappa: np.ndarray, scores: dict[str, np.ndarray], experiment: SweepExperiment, folder: Path
) -> None:
    """Draws some of the deformed images, their errors, and what of the initial image each lens shows."""
    count = min(len(kappa), _MOST_PICTURES)
    chosen = np.unique(np.linspace(0, len(kappa) - 1, count).round().astype(int))
    lenses = kappa[chosen]
    pictures = deform_all(source.pixels, lenses, experiment.warp)
    titles = [kappa_label(one) for one in lenses]
    decibels = [f"PSNR {value:.2f} dB" if np.isfinite(value) else "identical" for value in scores["psnr"][chosen]]
    save(deformed_panel(source.pixels, pictures, titles, decibels, source.peak), folder / "deformed.jpg")
    means = [f"mean |error| {value:.1f}" for value in scores["mae"][chosen]]
    errors = [picture - source.pixels for picture in pictures]
    save(error_panel(errors, titles, means, source.peak), folder / "errors.jpg")
    outlines, shown = [], []
    height, width = source.pixels.shape[:2]
    for one in lenses:
        coordinates = distortion_map(RadialPolynomial(jnp.asarray(one, source.pixels.dtype)), height, width)
        outlines.append(_outline(np.asarray(coordinates)))
        shown.append(float(np.mean(np.asarray(multiplicity(coordinates, height, width)) > 0)))
    covered = [float(value) for value in scores["coverage"][chosen]]
    save(coverage_chart(source.pixels, source.peak, lenses, outlines, shown, covered), folder / "coverage.jpg")


def _outline(coordinates: np.ndarray) -> np.ndarray:
    """The source points of the output's outermost pixels, once round."""
    top, right = coordinates[0, :], coordinates[:, -1]
    bottom, left = coordinates[-1, ::-1], coordinates[::-1, 0]
    return np.concatenate([top, right, bottom, left])


def draw_metrics(kappa: np.ndarray, scores: dict[str, np.ndarray], experiment: SweepExperiment, folder: Path) -> None:
    """Draws the metrics against the lenses."""
    compare = experiment.compare is not None
    if len(kappa) <= _MOST_DOTS:
        save(charts.metric_chart(kappa, scores, compare=compare), folder / "metrics.svg")
        return
    axes = experiment.lenses.axes or []
    moving = [index for index, axis in enumerate(axes) if axis.count > 1]
    names = [f"κ{'₀₁₂₃₄₅₆₇₈₉'[index + 1]}" if index < 9 else f"κ{index + 1}" for index in moving]
    values = [np.asarray(axes[index].values()) for index in moving]
    if len(moving) == 2:
        save(charts.heat_maps(values, names, scores, compare=compare), folder / "metrics.svg")
    elif len(moving) == 1:
        save(charts.metric_lines(values[0], names[0], scores), folder / "metrics.svg")
    else:
        save(charts.metric_lines(np.arange(len(kappa)), "lens (row of the table)", scores), folder / "metrics.svg")
