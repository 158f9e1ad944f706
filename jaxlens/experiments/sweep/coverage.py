"""What of a source lenses show: the outline that each one keeps, and the shares."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxlens.figures.palette import MUTED, PALETTE, WIDTH
from jaxlens.figures.pictures import cell_aspect
from jaxlens.figures.style import bare, kappa_label, new_figure

_STYLES = ("-", "--")


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
