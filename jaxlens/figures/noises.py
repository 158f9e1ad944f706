"""Noise and a lens's errors: pictures, local standard deviations, and arrangements of the same errors."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxlens.experiments.noises import Spread
from jaxlens.figures.pictures import cell_aspect, place
from jaxlens.figures.style import BLACK, BLUE, MUTED, VERMILLION, WIDTH, bare, new_figure, show_image

_TITLE, _NOTE, _GAP, _MARGIN = 0.25, 0.44, 0.12, 0.05
_BAR = 0.75
_COLORS = {"noise": BLUE, "lens": VERMILLION}
_BINS = 40
# Times the expected spread, from which on single blocks are only seen on a logarithmic axis.
_UNEVEN = 4.0


def noise_panel(
    initial: np.ndarray,
    peak: float,
    errors: Mapping[str, np.ndarray],
    spreads: Mapping[str, Spread],
    names: Mapping[str, str],
) -> Figure:
    """Draws the image with each kind of errors, and the errors' standard deviations in blocks below, in one scale."""
    aspect, columns = cell_aspect(initial), 1 + len(errors)
    side = (WIDTH - 2 * _MARGIN - _BAR - (columns - 1) * _GAP) / columns
    high = side * aspect
    below = _MARGIN + _TITLE + high + _GAP
    figure = new_figure(WIDTH, below + high + _NOTE + _MARGIN, by_hand=True)
    show_image(place(figure, _MARGIN, _MARGIN + _TITLE, side, high), initial, peak, title="initial")
    most = max(float(spread.local.max()) for spread in spreads.values())
    drawn = None
    for index, (name, one) in enumerate(errors.items()):
        left = _MARGIN + (index + 1) * (side + _GAP)
        show_image(place(figure, left, _MARGIN + _TITLE, side, high), initial + one, peak, title=names[name])
        axes = place(figure, left, below, side, high)
        local = spreads[name].local
        drawn = axes.imshow(local, cmap="viridis", vmin=0, vmax=most, interpolation="nearest", aspect="auto")
        bare(axes)
        inside = f"{100 * spreads[name].inside:.1f} % in the 95 % range"
        axes.set_xlabel(f"{local.min():.1f} to {local.max():.1f}\n{inside}", color=MUTED, labelpad=3)
    text = place(figure, _MARGIN, below, side, high)
    bare(text)
    block = round(next(iter(spreads.values())).samples ** 0.5)
    text.text(
        1,
        0.98,
        f"standard deviation\nof the errors in blocks\nof {block} × {block} pixels",
        ha="right",
        va="top",
        color=MUTED,
        linespacing=1.4,
        transform=text.transAxes,
    )
    if drawn is not None:
        bar_left = _MARGIN + columns * (side + _GAP)
        bar = figure.colorbar(drawn, cax=place(figure, bar_left, below, 0.14, high))
        bar.set_label("gray levels")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def spread_chart(spreads: Mapping[str, Spread], names: Mapping[str, str]) -> Figure:
    """Draws how the blocks' standard deviations are distributed, and how those of even noise would be."""
    figure = new_figure(WIDTH, 2.9)
    for (name, spread), axes in zip(spreads.items(), figure.subplots(1, len(spreads)), strict=True):
        low, high = float(spread.local.min()), float(spread.local.max())
        width = max(high - low, spread.high - spread.low)
        ends = np.linspace(max(0.0, low - 0.15 * width), high + 0.15 * width, _BINS + 1)
        axes.hist(spread.local.ravel(), ends, color=_COLORS[name], alpha=0.75)
        at = np.linspace(ends[0], ends[-1], 801)
        expected = spread.density(at) * spread.local.size * (ends[1] - ends[0])
        axes.plot(at, expected, color=BLACK, linewidth=1.4)
        if spread.excess > _UNEVEN:
            axes.set_yscale("log")
            axes.set_ylim(0.6, 2 * max(np.histogram(spread.local, ends)[0].max(), expected.max()))
        axes.set_xlim(ends[0], ends[-1])
        axes.set_title(names[name], loc="left")
        axes.set_xlabel("standard deviation in a block  [gray levels]")
        axes.set_ylabel("blocks")
    found = tuple(Patch(color=_COLORS[name], alpha=0.75) for name in spreads)
    curve = Line2D([], [], color=BLACK, linewidth=1.4)
    labels = ["blocks found", "expected of noise that is the same everywhere (χ)"]
    together = {tuple: HandlerTuple(ndivide=None, pad=0.2)}
    handles = [found, curve]  # the annotation of `legend` knows no tuples of artists
    figure.legend(handles, labels, handler_map=together, loc="outside upper center", ncols=2)  # pyright: ignore
    return figure


def arrangement_panel(
    pairs: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]],
    table: Mapping[str, Sequence],
    names: Mapping[str, str],
    peak: float,
) -> Figure:
    """Draws the pictures of each arrangement of the same errors, with their MSE and SSIM below."""
    first = next(iter(pairs.values()))
    columns, head = len(first), 0.26
    aspect = cell_aspect(next(iter(first.values()))[0])
    side = (WIDTH - 2 * _MARGIN - head - (columns - 1) * 0.08) / columns
    high, note = side * aspect, 0.42
    figure = new_figure(WIDTH, 2 * _MARGIN + _TITLE + len(pairs) * (high + note), by_hand=True)
    rows = iter(zip(table["mse"], table["ssim"], strict=True))
    for row, (name, arrangements) in enumerate(pairs.items()):
        top = _MARGIN + _TITLE + row * (high + note)
        middle = 1 - (top + high / 2) / figure.get_size_inches()[1]
        figure.text((_MARGIN + 0.1) / WIDTH, middle, names[name], rotation=90, ha="center", va="center")
        for column, (arrangement, (_, image)) in enumerate(arrangements.items()):
            axes = place(figure, _MARGIN + head + column * (side + 0.08), top, side, high)
            mse, ssim = next(rows)
            show_image(axes, image, peak, note=f"MSE {mse:.1f}\nSSIM {ssim:.3f}".replace("-", "−"))
            if row == 0:
                axes.set_title(arrangement, pad=4, fontsize=9)
    return figure
