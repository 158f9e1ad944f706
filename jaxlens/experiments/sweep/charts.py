"""Metrics against lenses: dots for a few, lines along one coefficient, heat maps over two."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jaxlens.experiments import paper
from jaxlens.figures.palette import BLUE, VERMILLION, WIDTH
from jaxlens.figures.style import new_figure, pair_label
from jaxlens.metrics import METRICS

# A lens of Table 1 on a heat map.
_DOT = {
    "marker": "o",
    "linestyle": "none",
    "color": "white",
    "markeredgecolor": "black",
    "markersize": 6,
    "markeredgewidth": 0.9,
}
_HEAT = ("psnr", "rmse", "mae", "ssim")


def heading(metric: str) -> str:
    """Returns a metric's name with its unit."""
    known = METRICS[metric]
    return f"{known.label}  [{known.unit}]" if known.unit else known.label


def metric_chart(kappa: np.ndarray, scores: Mapping[str, np.ndarray], *, compare: bool) -> Figure:
    """Draws SNR, PSNR, RMSE and MAE of each lens as dots; beside them, on request, those of Table 1.

    RMSE and MAE of row (2, 3), which Table 1 copies from row (1, 2), are crossed out, and the RMSE that the
    row's own PSNR implies is drawn instead.
    """
    figure = new_figure(WIDTH, 4.9)
    places = figure.subplots(2, 2, sharex=True)
    positions = np.arange(len(kappa))
    rows = [paper.row_of([float(value) for value in one]) if compare else None for one in kappa]
    for axes, metric in zip(places.flat, paper.METRICS, strict=True):
        axes.set_title(heading(metric), loc="left")
        axes.plot(positions, _finite(scores[metric]), "-o", color=BLUE, markersize=6.5, linewidth=1, label="ours")
        if any(rows):
            _draw_paper(axes, positions, rows, metric)
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        axes.margins(x=0.08, y=0.15)
    for axes in places[-1]:
        axes.set_xticks(positions, [pair_label(one) for one in kappa])
        axes.set_xlabel("κ₁, κ₂" if kappa.shape[1] == 2 else "κ")
    if any(rows):
        handles: dict[str, Artist] = {}
        for axes in places.flat:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=len(handles))
    return figure


def _draw_paper(axes: Axes, positions: np.ndarray, rows: Sequence[paper.Row | None], metric: str) -> None:
    def value(row: paper.Row | None) -> float:
        return np.nan if row is None else getattr(row, metric)

    def copied(row: paper.Row | None) -> bool:
        return metric in ("rmse", "mae") and row is not None and row.copied

    trusted = [np.nan if copied(row) else value(row) for row in rows]
    axes.plot(
        positions,
        trusted,
        "D",
        color=VERMILLION,
        markersize=6,
        markerfacecolor="white",
        markeredgewidth=1.5,
        label="paper",
    )
    doubtful = [(place, row) for place, row in zip(positions, rows, strict=True) if copied(row)]
    for place, row in doubtful:
        axes.plot(
            place, value(row), "x", color=VERMILLION, markersize=7, markeredgewidth=1.5, label="paper, copied from 1, 2"
        )
        if metric == "rmse" and row is not None:
            axes.plot(
                place,
                paper.implied_rmse(row.psnr),
                "*",
                color=VERMILLION,
                markersize=9,
                markeredgewidth=0,
                label="implied by its PSNR",
            )


def metric_lines(values: np.ndarray, name: str, scores: Mapping[str, np.ndarray]) -> Figure:
    """Draws SNR, PSNR, RMSE and MAE along one coefficient."""
    figure = new_figure(WIDTH, 4.6)
    places = figure.subplots(2, 2, sharex=True)
    for axes, metric in zip(places.flat, paper.METRICS, strict=True):
        axes.set_title(heading(metric), loc="left")
        axes.plot(values, _finite(scores[metric]), color=BLUE)
        axes.grid(axis="y")
    for axes in places[-1]:
        axes.set_xlabel(name)
    return figure


def heat_maps(
    values: Sequence[np.ndarray], names: Sequence[str], scores: Mapping[str, np.ndarray], *, compare: bool
) -> Figure:
    """Draws PSNR, RMSE, MAE and SSIM over two coefficients; on request with the places of Table 1's lenses."""
    first, second = values
    figure = new_figure(WIDTH, 6.0)
    places = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, metric in zip(places.flat, _HEAT, strict=True):
        field = _finite(scores[metric]).reshape(len(first), len(second)).T
        axes.set_title(heading(metric), loc="left")
        if np.isfinite(field).any():
            _draw_field(figure, axes, first, second, field)
        if compare:
            _mark_table_1(axes, first, second)
    if compare:
        dot = Line2D([], [], **_DOT, label="lenses of Table 1")
        figure.legend(handles=[dot], loc="outside upper right", handletextpad=0.3)
    for axes in places[-1]:
        axes.set_xlabel(names[0])
    for axes in places[:, 0]:
        axes.set_ylabel(names[1])
    return figure


def _draw_field(figure: Figure, axes: Axes, first: np.ndarray, second: np.ndarray, field: np.ndarray) -> None:
    """Colours over all but the outermost hundredths of the values: an unchanged image would take all the contrast."""
    low, high = np.nanpercentile(field, [1, 99])
    beyond = (bool(np.nanmin(field) < low), bool(np.nanmax(field) > high))
    drawn = axes.pcolormesh(
        first, second, field, cmap="viridis", vmin=low, vmax=high, shading="nearest", rasterized=True
    )
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    bar = figure.colorbar(drawn, ax=axes, shrink=0.95, pad=0.03, extend=extend)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    if min(field.shape) > 2 and high > low:
        levels = [level for level in MaxNLocator(6).tick_values(low, high) if low < level < high]
        lines = axes.contour(first, second, field, levels=levels, colors="white", linewidths=0.8)
        axes.clabel(lines, fontsize=8, fmt="%.4g")


def _mark_table_1(axes: Axes, first: np.ndarray, second: np.ndarray) -> None:
    for row in paper.TABLE_1:
        x, y = row.kappa
        if first.min() <= x <= first.max() and second.min() <= y <= second.max():
            axes.plot(x, y, **_DOT, clip_on=False, zorder=5)


def _finite(column: np.ndarray) -> np.ndarray:
    """A column with NaN for infinities, which cannot be drawn (an unchanged image has an infinite PSNR)."""
    column = np.asarray(column, np.float64)
    return np.where(np.isfinite(column), column, np.nan)
