"""Figure 6: an image, what lenses make of it, and how many of its pixels land on several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field
from rich.console import Console

import jaxlens as jl
from jaxlens import experiments, figures
from jaxlens.experiments import (
    Configuration,
    Experiment,
    Image,
    Kappa,
    Outcome,
    Warp,
    kappa_columns,
    load_source,
    plain_table,
    progress_bar,
    write_csv,
)

if TYPE_CHECKING:
    from matplotlib.colors import Colormap, Normalize
    from matplotlib.figure import Figure

_TITLE, _NOTE, _GAP, _MARGIN = 0.25, 0.44, 0.1, 0.05
# Counts of single pixels beat with the screen's; their means over squares of this side do not.
_SQUARE = 5


class PanelsExperiment(Experiment):
    """One image and what lenses make of it, with the count of its pixels that land on several: Figure 6.

    Attributes:
        image: The undistorted image.
        kappa: The lenses.
        warp: How it is sampled.
    """

    image: Image
    kappa: list[Kappa] = Field(min_length=1, max_length=11)
    warp: Warp = Warp()

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        source = load_source(configuration, self.image)
        kappa = np.asarray(self.kappa, np.float64)
        height, width = source.pixels.shape[:2]
        pictures = experiments.deform_all(source.pixels, kappa, self.warp)
        counts = []
        with progress_bar(progress, self.name, len(kappa)) as advance:
            for one in kappa:
                lens = jl.RadialPolynomial(one.astype(source.pixels.dtype))
                counts.append(
                    np.asarray(jl.diagnostics.multiplicity(jl.distortion_map(lens, height, width), height, width))
                )
                advance(1)
        columns: dict[str, np.ndarray] = {
            "source_pixels": np.array([count.size for count in counts]),
            "not_shown": np.array([np.sum(count == 0) for count in counts]),
            "shown_once": np.array([np.sum(count == 1) for count in counts]),
            "multiple_positions": np.array([np.sum(count > 1) for count in counts]),
            "most_positions": np.array([count.max() for count in counts]),
        }
        write_csv(folder, kappa_columns(kappa) | columns)
        figures.save(multiplicity_panel(source.pixels, pictures, counts, kappa, source.peak), folder / "panels.jpg")
        rows = [
            [", ".join(f"{value:g}" for value in one)]
            + [f"{int(column[index]):,}".replace(",", " ") for column in columns.values()]
            for index, one in enumerate(kappa)
        ]
        report = plain_table(self.heading, ["κ", *(name.replace("_", "\n") for name in columns)], rows)
        return Outcome([source.facts], {}, [report])


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
    import matplotlib
    from matplotlib.colors import Normalize

    columns = len(pictures) + 1
    aspect = figures.cell_aspect(initial)
    side = (figures.WIDTH - 2 * _MARGIN - (columns - 1) * _GAP) / columns
    high = side * aspect
    below = 2 * _MARGIN + _TITLE + high + _GAP
    figure = figures.new_figure(figures.WIDTH, below + high + _NOTE + _MARGIN, by_hand=True)
    figures.show_image(figures.place(figure, _MARGIN, _MARGIN + _TITLE, side, high), initial, peak, title="a)  initial")
    means = [_mean_over_squares(count) for count in counts]
    colors = matplotlib.colormaps["viridis"].with_extremes(bad=figures.FAINT)
    norm = Normalize(1, max(2.0, *(float(np.nanmax(mean)) for mean in means)))
    _legend(figure, below, high, colors, norm)
    for index, (picture, count, mean, one) in enumerate(zip(pictures, counts, means, kappa, strict=True)):
        left = _MARGIN + (index + 1) * (side + _GAP)
        axes = figures.place(figure, left, _MARGIN + _TITLE, side, high)
        figures.show_image(axes, picture, peak, title=f"{chr(ord('b') + index)})  {figures.kappa_label(one)}")
        axes = figures.place(figure, left, below, side, high)
        height, width = count.shape
        axes.imshow(
            np.ma.masked_invalid(mean), cmap=colors, norm=norm, interpolation="nearest", extent=(0, width, height, 0)
        )
        figures.bare(axes)
        several = int(np.sum(count > 1))
        number = f"{several:,}".replace(",", "\u2009")
        axes.set_xlabel(
            f"{number} pixels ({100 * several / count.size:.1f} %)\nat multiple positions", color=figures.MUTED
        )
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
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Rectangle

    whole = figure.get_size_inches()[1]
    text, swatch, bar_height = 0.5, 0.16, max(0.3, high - 0.8)
    figure.text(
        _MARGIN / figures.WIDTH,
        1 - (top + 0.02) / whole,
        "positions of a pixel\nof the initial image",
        va="top",
        color=figures.MUTED,
    )
    axes = figures.place(figure, _MARGIN + 0.03, top + text, swatch, bar_height)
    bar = figure.colorbar(ScalarMappable(norm, colors), cax=axes)
    bar.set_ticks([tick for tick in bar.get_ticks() if tick == int(tick) and 1 <= tick <= norm.vmax])
    bar.ax.tick_params(labelcolor="black")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    axes = figures.place(figure, _MARGIN + 0.03, top + text + bar_height + 0.12, swatch, swatch)
    figures.bare(axes)
    axes.add_patch(Rectangle((0, 0), 1, 1, color=figures.FAINT))
    axes.text(1.45, 0.45, "not shown", va="center")
