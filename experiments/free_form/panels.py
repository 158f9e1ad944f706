"""Free-form deformation: the rectangle with its coordinates and lattice, and what freezing its border does."""

from collections.abc import Mapping

import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from jaxlens import figures
from jaxlens.deformations import FreeForm

from . import Deformed

_TITLE, _NOTE, _GAP, _MARGIN = 0.25, 0.62, 0.12, 0.05
_BAR = 0.95
# Points along a line of equal s or t; colours of a change of area.
_SAMPLES, _STEPS = 121, 21
_HALO = [withStroke(linewidth=2.5, foreground="black")]
_ARROW = {
    "arrowstyle": "-|>",
    "color": "white",
    "linewidth": 1.4,
    "shrinkA": 0,
    "shrinkB": 0,
    "mutation_scale": 8,
    "path_effects": _HALO,
}


def lattice_panel(initial: np.ndarray, peak: float, still: FreeForm, deformed: Deformed) -> Figure:
    """Draws the initial image with the rectangle's coordinates and lattice, and both after control points moved."""
    aspect = figures.cell_aspect(initial)
    side = (figures.WIDTH - 2 * _MARGIN - _GAP) / 2
    figure = figures.new_figure(figures.WIDTH, 2 * _MARGIN + _TITLE + side * aspect + 0.3, by_hand=True)
    places = [figures.place(figure, _MARGIN + i * (side + _GAP), _MARGIN + _TITLE, side, side * aspect) for i in (0, 1)]
    figures.show_image(places[0], initial, peak, title="initial: the regular lattice moves nothing")
    figures.show_image(places[1], deformed.picture, peak, title="control points moved, border free")
    for axes, mapping in zip(places, (still, deformed.mapping), strict=True):
        _draw_isolines(axes, mapping)
        _draw_lattice(axes, mapping, still)
        axes.set_xlim(-0.5, initial.shape[1] - 0.5)
        axes.set_ylim(initial.shape[0] - 0.5, -0.5)
    _draw_axes(places[0], still)
    _draw_legend(figure)
    return figure


def continuity_panel(peak: float, still: FreeForm, found: Mapping[str, Deformed]) -> Figure:
    """Draws, a column a border, the deformed image and below it the change of area at each pixel of the initial one."""
    first = next(iter(found.values()))
    aspect, columns = figures.cell_aspect(first.picture), len(found)
    side = (figures.WIDTH - 2 * _MARGIN - _BAR - (columns - 1) * _GAP) / columns
    (left_edge, top_edge), (right_edge, bottom_edge) = np.asarray(still.lower), np.asarray(still.upper)
    map_high = side * float(np.clip((bottom_edge - top_edge) / (right_edge - left_edge), 0.4, 2.0))
    below = _MARGIN + _TITLE + side * aspect + _GAP
    figure = figures.new_figure(figures.WIDTH, below + map_high + _NOTE + _MARGIN, by_hand=True)
    # Symmetric about no change; a fold has no logarithm, and a colour of its own.
    changes = {name: np.log2(np.where(one.determinant > 0, one.determinant, np.nan)) for name, one in found.items()}
    most = max(1.0, *(float(np.nanmax(np.abs(change), initial=0)) for change in changes.values()))
    # In steps, of which the middle one is no change.
    colors = matplotlib.colormaps["PuOr"].with_extremes(bad="black")
    norm = BoundaryNorm(np.linspace(-most, most, _STEPS + 1), colors.N)
    for index, (name, one) in enumerate(found.items()):
        left = _MARGIN + index * (side + _GAP)
        axes = figures.place(figure, left, _MARGIN + _TITLE, side, side * aspect)
        figures.show_image(axes, one.picture, peak, title=name)
        _draw_rectangle(axes, still)
        axes = figures.place(figure, left, below, side, map_high)
        axes.imshow(changes[name], cmap=colors, norm=norm, interpolation="nearest", aspect="auto")
        _draw_isolines(axes, still, color=figures.MUTED)
        axes.set_xlim(left_edge, right_edge)
        axes.set_ylim(bottom_edge, top_edge)
        figures.bare(axes)
        axes.set_xlabel(_note(one), color=figures.MUTED, labelpad=4, linespacing=1.3)
    bar_left = _MARGIN + columns * (side + _GAP)
    where = figures.place(figure, bar_left, below, 0.14, map_high)
    bar = figure.colorbar(ScalarMappable(norm, colors), cax=where, spacing="proportional")
    ticks = [tick for tick in range(-9, 10) if abs(tick) <= most]
    bar.set_ticks(ticks, labels=[f"× {2**tick}" if tick >= 0 else f"× 1/{2**-tick}" for tick in ticks])
    bar.minorticks_off()
    bar.set_label("change of area", labelpad=-2)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def _note(one: Deformed) -> str:
    measures = one.measures
    folded = f", {measures['folded_px']} px folded" if measures["folded_px"] else ""
    return (
        f"jump at the border {measures['jump_at_border_px']:.1f} px\n"
        f"jump of slope there {measures['slope_jump_at_border']:.2f}\n"
        f"{measures['gap_px']} px torn, {measures['covered_px']} covered{folded}"
    )


def _draw_isolines(axes: Axes, mapping: FreeForm, *, color: str = figures.SKY) -> None:
    """Draws lines of equal s and of equal t where the deformation takes them, as many as the lattice has.

    As long as the lattice is regular they are its own lines.
    """
    lower, upper = np.asarray(mapping.lower), np.asarray(mapping.upper)
    along = np.linspace(0, 1, _SAMPLES)
    for axis, count in enumerate(mapping.control_points.shape[:2]):
        at = np.linspace(0, 1, count)
        unit = np.stack(np.broadcast_arrays(at[:, None], along[None, :]), axis=-1)
        unit = unit if axis == 0 else unit[..., ::-1]
        lines = np.asarray(mapping(jnp.asarray(lower * (1 - unit) + upper * unit)))
        widths = [1.8, *[0.9] * (count - 2), 1.8]
        axes.add_collection(LineCollection(list(lines), colors=color, linewidths=widths))


def _draw_lattice(axes: Axes, mapping: FreeForm, still: FreeForm) -> None:
    before, after = np.asarray(still.control_points), np.asarray(mapping.control_points)
    edges = [*np.stack([after[:-1], after[1:]], axis=2).reshape(-1, 2, 2)]
    edges += [*np.stack([after[:, :-1], after[:, 1:]], axis=2).reshape(-1, 2, 2)]
    axes.add_collection(LineCollection(edges, colors=figures.ORANGE, linewidths=0.7, linestyles=(0, (2, 2)), zorder=3))
    flat = after.reshape(-1, 2)
    axes.plot(
        *flat.T, "o", color=figures.ORANGE, markersize=3.6, markeredgecolor="black", markeredgewidth=0.5, zorder=4
    )
    far = np.abs(after - before).max(axis=-1) > 0
    for start, end in zip(before[far], after[far], strict=True):
        axes.annotate("", xy=end, xytext=start, arrowprops=_ARROW | {"linewidth": 1.0, "shrinkB": 2}, zorder=5)


def _draw_axes(axes: Axes, still: FreeForm) -> None:
    """Names the directions of s and t, and where they are 0 and 1."""
    (left, top), (right, bottom) = np.asarray(still.lower), np.asarray(still.upper)
    off = 0.055 * (right - left)
    for end in ((right, top - off), (left - off, bottom)):
        start = (left, top - off) if end[0] == right else (left - off, top)
        axes.annotate("", xy=end, xytext=start, arrowprops=_ARROW, zorder=5)
    style = {"color": "white", "path_effects": _HALO, "zorder": 6}
    axes.text((left + right) / 2, top - 1.3 * off, "s", ha="center", va="bottom", style="italic", **style)
    axes.text(left - 1.3 * off, (top + bottom) / 2, "t", ha="right", va="center", style="italic", **style)
    axes.text(left - 1.3 * off, top - 1.3 * off, "(0, 0)", ha="right", va="bottom", **style)
    axes.text(right + 0.4 * off, bottom + 0.4 * off, "(1, 1)", ha="left", va="top", **style)


def _draw_rectangle(axes: Axes, still: FreeForm) -> None:
    (left, top), (right, bottom) = np.asarray(still.lower), np.asarray(still.upper)
    x, y = [left, right, right, left, left], [top, top, bottom, bottom, top]
    axes.plot(x, y, color=figures.SKY, linewidth=0.9, linestyle=(0, (4, 3)))


def _draw_legend(figure: Figure) -> None:
    dashes = (0, (2, 2))
    points = {"marker": "o", "markersize": 4, "markeredgecolor": "black", "markeredgewidth": 0.5}
    lattice = Line2D([], [], color=figures.ORANGE, linewidth=0.9, linestyle=dashes, **points)
    lines = Line2D([], [], color=figures.SKY, linewidth=1.8)
    labels = ["lines of equal s, of equal t", "control points and their lattice"]
    figure.legend([lines, lattice], labels, loc="lower center", ncols=2, borderaxespad=0.1)
