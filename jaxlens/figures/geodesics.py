"""Distances on a face: maps with curves of equal distance, ratios, shortest paths, convergence."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, NullLocator

from jaxlens.experiments.geodesic_distances import Convergence, Distances, Way
from jaxlens.figures.contours import contour_lines
from jaxlens.figures.pictures import place
from jaxlens.figures.style import (
    BLUE,
    FAINT,
    GREEN,
    MUTED,
    VERMILLION,
    WIDTH,
    bare,
    new_figure,
    plain,
)

_TITLE, _GAP, _MARGIN, _BAR = 0.44, 0.08, 0.05, 0.95
_TITLES = (
    ("planar", "straight in the picture's plane"),
    ("radial geodesic (Eqs. 1, 2)", "on the surface above that line"),
    ("geodesic", "the shortest on the surface"),
)
# Beyond this share of the ratios a colour bar ends.
_MOST = 99.0
_MARKS = ((VERMILLION, "s", "--"), (BLUE, "o", "-"), (GREEN, "^", ":"))


def distance_maps(found: Distances, step: float, unit: str, *, origin: str = "the nose tip") -> Figure:
    """Draws the three distances from a point as curves of equal distance over the shaded surface."""
    maps = (found.planar, found.radial, found.geodesic)
    box = _box(found)
    side, high = _cells(box, len(maps))
    figure = new_figure(WIDTH, _TITLE + high + 2 * _MARGIN, by_hand=True)
    farthest = max(float(np.max(one[np.isfinite(one)])) for one in maps)
    levels = step * np.arange(1, int(farthest / step) + 1)
    colors = matplotlib.colormaps["plasma"]
    norm = Normalize(0, 1.12 * farthest)  # plasma's last yellows are too light
    for index, (values, (title, note)) in enumerate(zip(maps, _TITLES, strict=True)):
        axes = place(figure, _MARGIN + index * (side + _GAP), _MARGIN + _TITLE, side, high)
        _draw_faded(axes, found, box)
        curves = contour_lines(values, levels)
        lines = [curve for level in curves for curve in level]
        shades = [colors(norm(level)) for level, several in zip(levels, curves, strict=True) for _ in several]
        axes.add_collection(LineCollection(lines, colors=shades, linewidths=1.1))
        axes.plot(*found.source, "+", color="black", markersize=7, markeredgewidth=1.4)
        axes.text(0.5, 1 + 0.25 / high, title, transform=axes.transAxes, ha="center", va="baseline", fontsize=10)
        axes.text(
            0.5, 1 + 0.07 / high, note, transform=axes.transAxes, ha="center", va="baseline", fontsize=8, color=MUTED
        )
    axes = place(figure, WIDTH - _MARGIN - _BAR + 0.12, _MARGIN + _TITLE + 0.1, 0.13, high - 0.2)
    stops = step * np.arange(0, len(levels) + 1)
    shades = ListedColormap([colors(norm(stop)) for stop in stops])
    bar = figure.colorbar(
        ScalarMappable(BoundaryNorm(np.append(stops, stops[-1] + step) - step / 2, len(stops)), shades), cax=axes
    )
    every = max(1, round(len(stops) / 8))
    bar.set_ticks(stops[::every].tolist(), labels=[f"{stop:.3g}" for stop in stops[::every]])
    bar.ax.minorticks_off()
    bar.set_label(plain(f"distance from {origin}  [{unit}]"))
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def ratio_maps(found: Distances) -> Figure:
    """Draws by how much the shortest way is longer than the planar distance, and the radial curve than it."""
    known = found.known
    safe = [np.where(known, one, 1) for one in (found.planar, found.radial, found.geodesic)]
    planar, radial, geodesic = safe
    ratios = (100 * (geodesic / planar - 1), 100 * np.maximum(radial / geodesic - 1, 0))
    titles = ("geodesic over planar", "radial geodesic over geodesic")
    box = _box(found)
    bar_room = 0.85
    side = (WIDTH - 2 * _MARGIN - 2 * bar_room - 0.2) / 2
    high = side * _aspect(box)
    figure = new_figure(WIDTH, 0.3 + high + 2 * _MARGIN, by_hand=True)
    for index, (ratio, title) in enumerate(zip(ratios, titles, strict=True)):
        left = _MARGIN + index * (side + bar_room + 0.2)
        axes = place(figure, left, _MARGIN + 0.3, side, high)
        levels = _levels(float(np.percentile(ratio[known], _MOST)))
        drawn = axes.contourf(
            np.where(known, ratio, np.nan), levels=levels, cmap=("viridis", "magma")[index], extend="max"
        )
        # Eyes, lips and hair, to see where one is.
        features = np.ma.masked_invalid(found.features / np.nanmax(found.features))
        axes.contour(features, levels=[0.5], colors="white", linewidths=0.6, alpha=0.7)
        axes.plot(*found.source, "+", color="white", markersize=7, markeredgewidth=1.4)
        _frame(axes, box)
        axes.set_title(title, pad=5)
        bar = figure.colorbar(
            drawn, cax=place(figure, left + side + 0.06, _MARGIN + 0.3 + 0.1, 0.13, high - 0.2), ticks=levels
        )
        bar.set_label("longer by  [%]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def path_panel(found: Distances, ways: Sequence[Way], unit: str) -> Figure:
    """Draws shortest paths beside straight rays, and a table of their lengths."""
    box = _box(found)
    high = 4.6
    side = min(high / _aspect(box), 3.7)
    high = side * _aspect(box)
    figure = new_figure(WIDTH, high + 2 * _MARGIN, by_hand=True)
    axes = place(figure, _MARGIN, _MARGIN, side, high)
    _draw_faded(axes, found, box)
    for number, way in enumerate(ways, 1):
        axes.plot(*np.stack([way.start, found.source]).T, "--", color=VERMILLION, linewidth=1.1)
        axes.plot(*way.points.T, "-", color="white", linewidth=3.2)
        axes.plot(*way.points.T, "-", color=BLUE, linewidth=1.7)
        axes.text(
            float(way.start[0]),
            float(way.start[1]),
            str(number),
            ha="center",
            va="center",
            fontsize=8,
            bbox={"boxstyle": "circle,pad=0.22", "facecolor": "white", "edgecolor": BLUE, "linewidth": 0.9},
        )
    axes.plot(*found.source, "+", color="black", markersize=8, markeredgewidth=1.5, zorder=5)
    table = place(figure, _MARGIN + side + 0.15, _MARGIN, WIDTH - side - 0.25 - 2 * _MARGIN, high)
    table.set_axis_off()
    table.set_xlim(0, 1)
    table.set_ylim(len(ways) + 3.6, -2.6)
    columns = (0.3, 0.5, 0.75, 1.0)
    names = ("planar", "radial", "geodesic", "radial\nlonger by")
    for x, name in zip(columns, names, strict=True):
        table.text(x, -0.2, name, ha="right", va="center_baseline", color=MUTED, linespacing=1.1)
    table.text(0.0, -1.8, plain(f"way to the nose tip, in {unit}"), va="center", fontsize=10)
    table.text(0.04, -0.2, "way", ha="center", va="center_baseline", color=MUTED)
    table.axhline(0.5, color=FAINT, linewidth=0.8)
    for row, way in enumerate(ways):
        table.text(0.04, row + 1, str(row + 1), ha="center", va="center")
        lengths = [f"{value:.3f}" for value in (way.planar, way.radial, way.geodesic)]
        for x, text in zip(columns, [*lengths, f"{100 * (way.radial / way.geodesic - 1):.1f} %"], strict=True):
            table.text(x, row + 1, text, ha="right", va="center")
    end = len(ways) + 1.9
    for y, color, line, text in (
        (end, BLUE, "-", "shortest path on the surface"),
        (end + 1, VERMILLION, "--", "straight in the picture: planar, radial"),
    ):
        table.plot([0.0, 0.12], [y, y], line, color=color, linewidth=1.7)
        table.text(0.16, y, text, va="center")
    return figure


def convergence_chart(sizes: Sequence[int], found: Sequence[Convergence]) -> Figure:
    """Draws the largest and the mean error on a sphere's cap against the size of the depth map."""
    figure = new_figure(WIDTH, 3.4)
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
            axes.plot(ends, guide, color=MUTED, linewidth=0.8, zorder=0)
            axes.annotate(
                f"order {order}",
                (ends[1], guide[1]),
                (4, 0),
                textcoords="offset points",
                fontsize=8,
                color=MUTED,
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


Box = tuple[float, float, float, float]


def _box(found: Distances) -> Box:
    """Left, right, top and bottom of what is drawn: the surface, and a little more, in pixels."""
    rows, columns = np.nonzero(np.isfinite(found.picture))
    pad = 0.03 * max(np.ptp(rows), np.ptp(columns))
    return columns.min() - pad, columns.max() + pad, rows.min() - pad, rows.max() + pad


def _aspect(box: Box) -> float:
    left, right, top, bottom = box
    return float(np.clip((bottom - top) / (right - left), 0.5, 2.0))


def _cells(box: Box, count: int) -> tuple[float, float]:
    side = (WIDTH - 2 * _MARGIN - _BAR - (count - 1) * _GAP) / count
    return side, side * _aspect(box)


def _draw_faded(axes: Axes, found: Distances, box: Box) -> None:
    """The shaded surface, light, on white."""
    picture = found.picture / np.nanmax(found.picture)
    axes.imshow(0.45 + 0.55 * picture, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    _frame(axes, box)


def _frame(axes: Axes, box: Box) -> None:
    bare(axes)
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[3], box[2])
    axes.set_aspect("equal")
