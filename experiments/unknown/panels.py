"""Pictures that come near Table 1: how they look, what separates them from it, and what it tells of them."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxlens.experiments import READINGS, Reading, paper
from jaxlens.figures import BLUE, FAINT, GREEN, MUTED, VERMILLION, WIDTH, bare, new_figure, place, show_image

from .exact import Exact
from .portraits import PARAMETERS, bounds
from .search import LABELS, Found

_MARKS: dict[Reading, tuple[str, str]] = {
    "functional inverse": (BLUE, "o"),
    "reciprocal": (VERMILLION, "s"),
    "direct": (GREEN, "^"),
}
_TITLE, _NOTE, _GAP, _MARGIN = 0.28, 0.26, 0.12, 0.06


def picture_panel(pictures: Mapping[Reading, Sequence[tuple[np.ndarray, float]]]) -> Figure:
    """Draws, a row a reading, different pictures that come about as near to the table as the first.

    Args:
        pictures: For each reading gray levels with square pixels, and the RMS distance from the table in decibels.
    """
    columns = max(len(several) for several in pictures.values())
    room = WIDTH - 2 * _MARGIN - (columns - 1) * _GAP
    side = min(room / columns, 1.9)
    step = _TITLE + side + _NOTE
    width = 2 * _MARGIN + columns * side + (columns - 1) * _GAP
    figure = new_figure(width, 2 * _MARGIN + len(pictures) * step, by_hand=True)
    for row, (reading, several) in enumerate(pictures.items()):
        top = _MARGIN + row * step + _TITLE
        figure.text(_MARGIN / width, 1 - (top - 0.09) / figure.get_size_inches()[1], reading, fontsize=10)
        for column, (picture, rms) in enumerate(several):
            height, wide = picture.shape
            scale = side / max(height, wide)
            left = _MARGIN + column * (side + _GAP) + 0.5 * (side - scale * wide)
            axes = place(figure, left, top + 0.5 * (side - scale * height), scale * wide, scale * height)
            show_image(axes, picture, paper.PEAK, note=f"{rms:.2f} dB")
    return figure


def residual_chart(found: Mapping[bool, Mapping[Reading, Found]], noise: float) -> Figure:
    """Draws what separates the nearest pictures from each figure of the table.

    Args:
        found: The nearest picture of each reading; first as the table is printed, then with its last rows exchanged.
        noise: Drawn as a band about zero.
    """
    figure = new_figure(WIDTH, 4.6)
    places = figure.subplots(2, 1, sharex=True, sharey=True)
    positions = np.arange(len(LABELS))
    offsets = np.linspace(-0.22, 0.22, len(READINGS))
    titles = {False: "the table as printed", True: "labels of its last two rows, (3, 2) and (3, 1), exchanged"}
    for axes, (exchanged, nearest) in zip(places, found.items(), strict=True):
        axes.axhspan(-noise, noise, color=FAINT, alpha=0.5, linewidth=0)
        axes.axhline(0, color=MUTED, linewidth=0.8)
        for offset, reading in zip(offsets, READINGS, strict=True):
            color, marker = _MARKS[reading]
            values = nearest[reading].residuals
            axes.vlines(positions + offset, 0, values, color=color, linewidth=1.1)
            axes.plot(positions + offset, values, marker, color=color, markersize=5.5, label=reading)
        axes.set_title(titles[exchanged], loc="left")
        axes.set_ylabel("ours / theirs  [dB]")
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        for edge in (5.5, 10.5):
            axes.axvline(edge, color=FAINT, linewidth=0.8)
    names = [label.removeprefix("RMSE ").removeprefix("MAE ") for label in LABELS]
    places[-1].set_xticks(positions, [name.replace(" ", "") for name in names])
    for middle, name in ((2.5, "RMSE at κ₁, κ₂"), (8, "MAE at κ₁, κ₂")):
        places[-1].text(
            middle, -0.2, name, transform=places[-1].get_xaxis_transform(), ha="center", va="top", color=MUTED
        )
    handles, labels = places[0].get_legend_handles_labels()
    band = Line2D([], [], color=FAINT, linewidth=7)
    figure.legend([*handles, band], [*labels, f"± {noise:g} dB"], loc="outside upper center", ncols=4)
    return figure


def knowledge_chart(found: Mapping[Reading, Found], noise: float) -> Figure:
    """Draws what was expected of each parameter, and what it came out as, with standard errors."""
    figure = new_figure(WIDTH, 4.2)
    axes = figure.subplots()
    middle, spread, lower, upper = bounds()
    positions = np.arange(len(PARAMETERS))
    axes.barh(positions, 2.0, left=-1.0, height=0.82, color=FAINT, alpha=0.6, linewidth=0, label="expected, ± 1 σ")
    for offset, (reading, one) in zip(np.linspace(-0.24, 0.24, len(found)), found.items(), strict=True):
        color, marker = _MARKS[reading]
        errors = one.knowledge(noise).narrowed
        axes.errorbar(
            (one.parameters - middle) / spread,
            positions + offset,
            xerr=errors,
            fmt=marker,
            color=color,
            markersize=5,
            elinewidth=1.4,
            label=reading,
        )
    for index, (low, high) in enumerate(zip((lower - middle) / spread, (upper - middle) / spread, strict=True)):
        for bound in (low, high):
            if abs(bound) < 3:
                label = None if "bound" in axes.get_legend_handles_labels()[1] else "bound"
                axes.plot([bound, bound], [index - 0.41, index + 0.41], color=MUTED, linewidth=1.2, label=label)
    axes.set_yticks(positions, [one.meaning for one in PARAMETERS])
    axes.invert_yaxis()
    axes.axvline(0, color=MUTED, linewidth=0.8, zorder=0)
    axes.set_xlabel("departure from the expectation  [its standard deviations]")
    axes.tick_params(axis="y", length=0, labelcolor="black")
    axes.spines["left"].set_visible(False)
    figure.legend(loc="outside upper center", ncols=5, columnspacing=1.3)
    return figure


def profile_chart(
    views: Sequence[float], profiles: Mapping[Reading, Sequence[Found]], best: Mapping[Reading, Found]
) -> Figure:
    """Draws how near to the table a picture comes whose face has a given size, the rest fitted anew."""
    figure = new_figure(WIDTH, 2.9)
    axes = figure.subplots()
    for reading, several in profiles.items():
        color, marker = _MARKS[reading]
        own = best[reading]
        points = sorted([*zip(views, (one.rms for one in several), strict=True), (np.exp(own.parameters[0]), own.rms)])
        axes.plot(*np.array(points).T, "-", color=color, linewidth=1.3)
        axes.plot(views, [one.rms for one in several], marker, color=color, markersize=6, label=reading)
        axes.plot(np.exp(own.parameters[0]), own.rms, "*", color=color, markersize=12, markeredgecolor="white")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("height of the picture  [head heights]; small: a large face")
    axes.set_ylabel("RMS distance from\nthe table  [dB]")
    axes.grid(axis="y")
    star = Line2D([], [], color=MUTED, marker="*", linestyle="none", markersize=11)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend([*handles, star], [*labels, "height fitted, too"], loc="outside upper center", ncols=4)
    return figure


def exact_panel(found: Sequence[tuple[Exact, float, Reading]]) -> Figure:
    """Draws pictures with exactly the table's figures: before, after, and the change.

    Args:
        found: The pictures, their widths over their heights, and how Eq. 11 is read.
    """
    columns, side = 3, 1.75
    width = 2 * _MARGIN + columns * side + (columns - 1) * _GAP
    figure = new_figure(width, 2 * _MARGIN + _TITLE + len(found) * (side + _NOTE), by_hand=True)
    for row, (one, aspect, reading) in enumerate(found):
        top = _MARGIN + _TITLE + row * (side + _NOTE)
        high, wide = side / max(1.0, aspect), side * min(1.0, aspect)
        changed = one.after - one.before
        limit = float(np.percentile(np.abs(changed), 99.5))
        for column, title in enumerate(("a face", "with the table's figures", "the change")):
            left = _MARGIN + column * (side + _GAP) + 0.5 * (side - wide)
            axes = place(figure, left, top + 0.5 * (side - high), wide, high)
            if column < 2:
                image = one.after if column else one.before
                axes.imshow(image, cmap="gray", vmin=0, vmax=paper.PEAK, aspect="auto", interpolation="antialiased")
            else:
                axes.imshow(changed, cmap="PuOr", vmin=-limit, vmax=limit, aspect="auto", interpolation="antialiased")
            bare(axes)
            if row == 0:
                axes.set_title(title, pad=4)
            note = (reading, f"off by {one.off:.0e} dB at most", f"RMS {one.change:.1f} gray levels")[column]
            axes.set_xlabel(note, color=MUTED, labelpad=3)
    return figure
