"""Distances on a face: ratios, shortest paths, convergence."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, NullLocator

from jaxlens import figures

from . import Convergence, Way

_MARGIN = 0.05
# Beyond this share of the ratios a colour bar ends.
_MOST = 99.0
_MARKS = ((figures.VERMILLION, "s", "--"), (figures.BLUE, "o", "-"), (figures.GREEN, "^", ":"))


def ratio_maps(found: figures.Distances) -> Figure:
    """Draws by how much the shortest way is longer than the planar distance, and the radial curve than it."""
    known = found.known
    safe = [np.where(known, one, 1) for one in (found.planar, found.radial, found.geodesic)]
    planar, radial, geodesic = safe
    ratios = (100 * (geodesic / planar - 1), 100 * np.maximum(radial / geodesic - 1, 0))
    titles = ("geodesic over planar", "radial geodesic over geodesic")
    box = figures.box_of(found)
    bar_room = 0.85
    side = (figures.WIDTH - 2 * _MARGIN - 2 * bar_room - 0.2) / 2
    high = side * figures.aspect_of(box)
    figure = figures.new_figure(figures.WIDTH, 0.3 + high + 2 * _MARGIN, by_hand=True)
    for index, (ratio, title) in enumerate(zip(ratios, titles, strict=True)):
        left = _MARGIN + index * (side + bar_room + 0.2)
        axes = figures.place(figure, left, _MARGIN + 0.3, side, high)
        levels = _levels(float(np.percentile(ratio[known], _MOST)))
        drawn = axes.contourf(
            np.where(known, ratio, np.nan), levels=levels, cmap=("viridis", "magma")[index], extend="max"
        )
        # Eyes, lips and hair, to see where one is.
        features = np.ma.masked_invalid(found.features / np.nanmax(found.features))
        axes.contour(features, levels=[0.5], colors="white", linewidths=0.6, alpha=0.7)
        axes.plot(*found.source, "+", color="white", markersize=7, markeredgewidth=1.4)
        figures.show_box(axes, box)
        axes.set_title(title, pad=5)
        bar = figure.colorbar(
            drawn, cax=figures.place(figure, left + side + 0.06, _MARGIN + 0.3 + 0.1, 0.13, high - 0.2), ticks=levels
        )
        bar.set_label("longer by  [%]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def path_panel(found: figures.Distances, ways: Sequence[Way], unit: str) -> Figure:
    """Draws shortest paths beside straight rays, and a table of their lengths."""
    box = figures.box_of(found)
    high = 4.6
    side = min(high / figures.aspect_of(box), 3.7)
    high = side * figures.aspect_of(box)
    figure = figures.new_figure(figures.WIDTH, high + 2 * _MARGIN, by_hand=True)
    axes = figures.place(figure, _MARGIN, _MARGIN, side, high)
    figures.draw_faded(axes, found, box)
    for number, way in enumerate(ways, 1):
        axes.plot(*np.stack([way.start, found.source]).T, "--", color=figures.VERMILLION, linewidth=1.1)
        axes.plot(*way.points.T, "-", color="white", linewidth=3.2)
        axes.plot(*way.points.T, "-", color=figures.BLUE, linewidth=1.7)
        axes.text(
            float(way.start[0]),
            float(way.start[1]),
            str(number),
            ha="center",
            va="center",
            fontsize=8,
            bbox={"boxstyle": "circle,pad=0.22", "facecolor": "white", "edgecolor": figures.BLUE, "linewidth": 0.9},
        )
    axes.plot(*found.source, "+", color="black", markersize=8, markeredgewidth=1.5, zorder=5)
    table = figures.place(figure, _MARGIN + side + 0.15, _MARGIN, figures.WIDTH - side - 0.25 - 2 * _MARGIN, high)
    table.set_axis_off()
    table.set_xlim(0, 1)
    table.set_ylim(len(ways) + 3.6, -2.6)
    columns = (0.3, 0.5, 0.75, 1.0)
    names = ("planar", "radial", "geodesic", "radial\nlonger by")
    for x, name in zip(columns, names, strict=True):
        table.text(x, -0.2, name, ha="right", va="center_baseline", color=figures.MUTED, linespacing=1.1)
    table.text(0.0, -1.8, figures.plain(f"way to the nose tip, in {unit}"), va="center", fontsize=10)
    table.text(0.04, -0.2, "way", ha="center", va="center_baseline", color=figures.MUTED)
    table.axhline(0.5, color=figures.FAINT, linewidth=0.8)
    for row, way in enumerate(ways):
        table.text(0.04, row + 1, str(row + 1), ha="center", va="center")
        lengths = [f"{value:.3f}" for value in (way.planar, way.radial, way.geodesic)]
        for x, text in zip(columns, [*lengths, f"{100 * (way.radial / way.geodesic - 1):.1f} %"], strict=True):
            table.text(x, row + 1, text, ha="right", va="center")
    end = len(ways) + 1.9
    for y, color, line, text in (
        (end, figures.BLUE, "-", "shortest path on the surface"),
        (end + 1, figures.VERMILLION, "--", "straight in the picture: planar, radial"),
    ):
        table.plot([0.0, 0.12], [y, y], line, color=color, linewidth=1.7)
        table.text(0.16, y, text, va="center")
    return figure


def convergence_chart(sizes: Sequence[int], found: Sequence[Convergence]) -> Figure:
    """Draws the largest and the mean error on a sphere's cap against the size of the depth map."""
    figure = figures.new_figure(figures.WIDTH, 3.4)
    places = figure.subplots(1, 2, sharey=True)
    for axes, title, which in zip(places, ("mean error", "largest error"), ("mean", "largest"), strict=True):
        for one, (color, marker, line) in zip(found, _MARKS, strict=True):
            axes.plot(sizes, getattr(one, which), line, marker=marker, color=color, markersize=6, label=one.name)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_title(title, loc="left")
        axes.set_xlabel("side of the depth map  [pixels]")
        axes.grid(axis="y")
        ends = np.array([sizes[0], sizes[-1]])
        high = max(getattr(one, which)[0] for one in found)
        low = min(getattr(one, which)[0] for one in found)
        for order, start in ((1, 1.6 * high), (2, 0.6 * low)):
            guide = start * (ends[0] / ends) ** float(order)
            axes.plot(ends, guide, color=figures.MUTED, linewidth=0.8, zorder=0)
            axes.annotate(
                f"order {order}",
                (ends[1], guide[1]),
                (4, 0),
                textcoords="offset points",
                fontsize=8,
                color=figures.MUTED,
                va="center",
                annotation_clip=False,
            )
    places[0].set_ylabel("error  [radii of the sphere]")
    handles, labels = places[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _levels(limit: float) -> np.ndarray:
    """About ten round levels from zero on."""
    ticks = np.asarray(MaxNLocator(10).tick_values(0, max(limit, 1e-9)))
    return ticks[(ticks >= 0) & (ticks <= limit * (1 + 1e-9))] if limit > 0 else np.array([0.0, 1e-9])
