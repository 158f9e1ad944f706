"""The sweep: one image, many lenses, every metric for each; on request beside Table 1."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from rich.console import Console, RenderableType

from jaxlens.diagnostics import multiplicity
from jaxlens.experiments.config import Configuration
from jaxlens.experiments.kinds.outcome import Outcome, progress_bar
from jaxlens.experiments.reports import comparison, extremes
from jaxlens.experiments.schema import SweepExperiment
from jaxlens.experiments.sources import Source, load_source
from jaxlens.experiments.sweeping import deform_all, estimated_bytes, lanes_within, sweep
from jaxlens.experiments.tables import kappa_columns, write_csv
from jaxlens.figures import charts
from jaxlens.figures.coverages import coverage_chart
from jaxlens.figures.pictures import deformed_panel, error_panel
from jaxlens.figures.style import kappa_label, save
from jaxlens.lenses import RadialPolynomial
from jaxlens.warping import distortion_map

# Lenses that are drawn, and dots that a chart bears.
_MOST_PICTURES = 6
_MOST_DOTS = 12


def perform_sweep(
    configuration: Configuration, experiment: SweepExperiment, folder: Path, progress: Console
) -> Outcome:
    """Carries out a sweep."""
    source = load_source(configuration, experiment.image)
    kappa = np.asarray(experiment.lenses.coefficients(), np.float64)
    with progress_bar(progress, experiment.name, len(kappa)) as advance:
        scores = sweep(
            source.pixels,
            kappa,
            peak=source.peak,
            warp=experiment.warp,
            memory_mb=experiment.memory_mb,
            advance=advance,
        )
    write_csv(folder, kappa_columns(kappa) | scores)
    _draw_pictures(source, kappa, scores, experiment, folder)
    _draw_metrics(kappa, scores, experiment, folder)
    facts: dict[str, object] = {
        "lenses": len(kappa),
        "lanes": lanes_within(experiment.memory_mb, source.pixels),
        "estimated_mb_per_lens": round(estimated_bytes(source.pixels) / 1e6, 1),
    }
    report: list[RenderableType]
    if experiment.compare is not None:
        report = comparison(kappa, scores, peak=source.peak, title=experiment.title or experiment.name)
    else:
        report = extremes(kappa, scores, title=experiment.title or experiment.name)
    return Outcome([source.facts], facts, report)


def _draw_pictures(
    source: Source, kappa: np.ndarray, scores: dict[str, np.ndarray], experiment: SweepExperiment, folder: Path
) -> None:
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


def _draw_metrics(kappa: np.ndarray, scores: dict[str, np.ndarray], experiment: SweepExperiment, folder: Path) -> None:
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
