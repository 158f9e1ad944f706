"""Metrics against lenses: dots for a few, lines along one coefficient, heat maps over two."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxlens.experiments import paper
from jaxlens.experiments.figures.style import BLUE, VERMILLION, WIDTH, new_figure, pair_label

UNITS = {"snr": "dB", "psnr": "dB", "rmse": "gray levels", "mae": "gray levels", "ssim": ""}
_HEAT = ("psnr", "rmse", "mae", "ssim")


def heading(metric: str) -> str:
    """Returns a metric's name with its unit."""
    unit = UNITS[metric]
    return f"{metric.upper()}  [{unit}]" if unit else metric.upper()


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
    figure = new_figure(WIDTH, 6.2)
    places = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, metric in zip(places.flat, _HEAT, strict=True):
        field = _finite(scores[metric]).reshape(len(first), len(second)).T
        drawn = axes.pcolormesh(first, second, field, cmap="viridis", shading="nearest", rasterized=True)
        bar = figure.colorbar(drawn, ax=axes, shrink=0.9, pad=0.03)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        axes.set_title(heading(metric), loc="left")
        if min(field.shape) > 2 and np.isfinite(field).all() and np.ptp(field) > 0:
            lines = axes.contour(first, second, field, levels=6, colors="white", linewidths=0.7)
            axes.clabel(lines, fontsize=7.5, fmt="%.4g")
        if compare:
            _mark_table_1(axes, first, second)
    for axes in places[-1]:
        axes.set_xlabel(names[0])
    for axes in places[:, 0]:
        axes.set_ylabel(names[1])
    return figure


def _mark_table_1(axes: Axes, first: np.ndarray, second: np.ndarray) -> None:
    for row in paper.TABLE_1:
        x, y = row.kappa
        if first.min() <= x <= first.max() and second.min() <= y <= second.max():
            axes.plot(
                x,
                y,
                "o",
                color="white",
                markeredgecolor="black",
                markersize=5,
                markeredgewidth=0.8,
                clip_on=False,
                zorder=5,
            )


def _finite(column: np.ndarray) -> np.ndarray:
    """A column with NaN for infinities, which cannot be drawn (an unchanged image has an infinite PSNR)."""
    column = np.asarray(column, np.float64)
    return np.where(np.isfinite(column), column, np.nan)
