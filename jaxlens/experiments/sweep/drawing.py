"""The figures of a sweep: pictures, their errors, what of the source the lenses show."""

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxlens.diagnostics import multiplicity
from jaxlens.experiments.sources import Source
from jaxlens.experiments.sweep import SweepExperiment, charts
from jaxlens.experiments.sweep.scoring import deform_all
from jaxlens.figures.palette import MUTED, PALETTE, WIDTH
from jaxlens.figures.pictures import cell_aspect, deformed_panel, error_panel
from jaxlens.figures.style import bare, kappa_label, new_figure, save
from jaxlens.lenses import RadialPolynomial
from jaxlens.warping import distortion_map

# Lenses that are drawn, and dots that a chart bears.
_MOST_PICTURES = 6
_MOST_DOTS = 12
_STYLES = ("-", "--")


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


def coverage_chart(
    initial: np.ndarray,
    peak: float,
    kappa: np.ndarray,
    outlines: Sequence[np.ndarray],
    shown: Sequence[float],
    covered: Sequence[float],
) -> Figure:
    """Draws, over the faded initial image, the part of it that fills the output's frame under each lens.

    Args:
        initial: The image.
        peak: Its white.
        kappa: The lenses.
        outlines: `(points, 2)` source pixels of the output's frame, for each lens; NaN where nothing is seen.
        shown: The share of source pixels that some output pixel draws from.
        covered: The share of output pixels that have a source.
    """
    height, width = initial.shape[:2]
    figure = new_figure(WIDTH, max(3.6, 3.4 * cell_aspect(initial)))
    picture, table = figure.subplots(1, 2, width_ratios=[1, 0.95])
    faded = 1 - 0.45 * (1 - np.clip(initial / peak, 0, 1))
    picture.imshow(faded, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    bare(picture)
    picture.set_title("part of the initial image\nthat fills the output's frame", pad=6)
    table.set_axis_off()
    table.set_xlim(0, 1)
    table.set_ylim(len(kappa) + 0.5, -1.6)
    table.text(0.68, -0.6, "output\nwith a source", ha="right", va="center", color=MUTED)
    table.text(0.98, -0.6, "initial image\nshown", ha="right", va="center", color=MUTED)
    for index, (one, outline) in enumerate(zip(kappa, outlines, strict=True)):
        color = PALETTE[index % len(PALETTE)]
        line = _STYLES[index // len(PALETTE) % len(_STYLES)]
        # White below all the lines parts them from the picture.
        picture.plot(outline[:, 0], outline[:, 1], line, color="white", linewidth=3, zorder=2)
        picture.plot(outline[:, 0], outline[:, 1], line, color=color, linewidth=1.7, zorder=3)
        table.add_line(Line2D([0.0, 0.1], [index + 0.5] * 2, color=color, linestyle=line, linewidth=2.6))
        label = kappa_label(one).removeprefix("κ = ")
        table.text(0.13, index + 0.5, label, va="center", fontsize=9.5 if len(label) < 16 else 7)
        table.text(0.68, index + 0.5, f"{100 * covered[index]:.1f} %", ha="right", va="center")
        table.text(0.98, index + 0.5, f"{100 * shown[index]:.1f} %", ha="right", va="center")
    table.text(0.13, -0.6, "κ", va="center", color=MUTED)
    picture.set_xlim(-0.5, width - 0.5)
    picture.set_ylim(height - 0.5, -0.5)
    return figure


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
