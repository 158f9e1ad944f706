"""Figure 6 and, below each image, how often the pixels of the initial one are drawn."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jaxlens.figures.pictures import cell_aspect, place
from jaxlens.figures.style import FAINT, MUTED, WIDTH, bare, kappa_label, new_figure, show_image

_TITLE, _NOTE, _GAP, _MARGIN = 0.25, 0.44, 0.1, 0.05
# Counts of single pixels beat with the screen's; their means over squares of this side do not.
_SQUARE = 5


def multiplicity_panel(
    initial: np.ndarray, pictures: Sequence[np.ndarray], counts: Sequence[np.ndarray], kappa: np.ndarray, peak: float
) -> Figure:
    """Draws the initial and the deformed images, and below these the positions that the initial pixels moved to.

    Args:
        initial: The image.
        pictures: What each lens makes of it.
        counts: For each lens, how many output pixels draw from each pixel of the initial image.
        kappa: The lenses.
        peak: White.
    """
    columns = len(pictures) + 1
    aspect = cell_aspect(initial)
    side = (WIDTH - 2 * _MARGIN - (columns - 1) * _GAP) / columns
    high = side * aspect
    below = 2 * _MARGIN + _TITLE + high + _GAP
    figure = new_figure(WIDTH, below + high + _NOTE + _MARGIN, by_hand=True)
    show_image(place(figure, _MARGIN, _MARGIN + _TITLE, side, high), initial, peak, title="a)  initial")
    means = [_mean_over_squares(count) for count in counts]
    colors = matplotlib.colormaps["viridis"].with_extremes(bad=FAINT)
    norm = Normalize(1, max(2.0, *(float(np.nanmax(mean)) for mean in means)))
    _legend(figure, below, high, colors, norm)
    for index, (picture, count, mean, one) in enumerate(zip(pictures, counts, means, kappa, strict=True)):
        left = _MARGIN + (index + 1) * (side + _GAP)
        axes = place(figure, left, _MARGIN + _TITLE, side, high)
        show_image(axes, picture, peak, title=f"{chr(ord('b') + index)})  {kappa_label(one)}")
        axes = place(figure, left, below, side, high)
        height, width = count.shape
        axes.imshow(
            np.ma.masked_invalid(mean), cmap=colors, norm=norm, interpolation="nearest", extent=(0, width, height, 0)
        )
        bare(axes)
        several = int(np.sum(count > 1))
        number = f"{several:,}".replace(",", "\u2009")
        axes.set_xlabel(f"{number} pixels ({100 * several / count.size:.1f} %)\nat multiple positions", color=MUTED)
    return figure


def _mean_over_squares(count: np.ndarray) -> np.ndarray:
    """Means over squares of the pixels that are shown; NaN in squares that are mostly not."""
    sums, shown, pixels = (_sum_over_squares(plane) for plane in (count, count > 0, np.ones_like(count)))
    return np.where(shown >= 0.5 * pixels, sums / np.maximum(shown, 1), np.nan)


def _sum_over_squares(plane: np.ndarray) -> np.ndarray:
    rows, columns = (np.arange(0, size, _SQUARE) for size in plane.shape)
    return np.add.reduceat(np.add.reduceat(plane.astype(float), rows, axis=0), columns, axis=1)


def _legend(figure: Figure, top: float, high: float, colors: Colormap, norm: Normalize) -> None:
    """What the colours below mean, in the place below the initial image."""
    whole = figure.get_size_inches()[1]
    text, swatch, bar_height = 0.5, 0.16, max(0.3, high - 0.8)
    figure.text(
        _MARGIN / WIDTH, 1 - (top + 0.02) / whole, "positions of a pixel\nof the initial image", va="top", color=MUTED
    )
    axes = place(figure, _MARGIN + 0.03, top + text, swatch, bar_height)
    bar = figure.colorbar(ScalarMappable(norm, colors), cax=axes)
    bar.set_ticks([tick for tick in bar.get_ticks() if tick == int(tick) and 1 <= tick <= norm.vmax])
    bar.ax.tick_params(labelcolor="black")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    axes = place(figure, _MARGIN + 0.03, top + text + bar_height + 0.12, swatch, swatch)
    bare(axes)
    axes.add_patch(Rectangle((0, 0), 1, 1, color=FAINT))
    axes.text(1.45, 0.45, "not shown", va="center")
