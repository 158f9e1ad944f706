"""Panels of images: the initial one, the deformed ones, their errors. Laid out by hand, so that edges meet."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxlens.figures.palette import WIDTH
from jaxlens.figures.style import bare, new_figure, show_image

# In inches: above and below an image for its text, between two of them, and around all.
_TITLE, _NOTE, _GAP, _MARGIN = 0.25, 0.27, 0.1, 0.05
_BAR = 0.85  # for a colour bar, its ticks and its label


def deformed_panel(
    initial: np.ndarray,
    pictures: Sequence[np.ndarray],
    titles: Sequence[str],
    notes: Sequence[str],
    peak: float,
    *,
    rows: int = 2,
) -> Figure:
    """Draws the initial image, as high as all rows, and beside it what each lens makes of it."""
    rows = rows if len(pictures) > 3 else 1
    columns = -(-len(pictures) // rows)
    aspect = cell_aspect(initial)
    # Between the rows; the large image is as high as both rows and this.
    between = _NOTE + _TITLE + _GAP
    room = WIDTH - 2 * _MARGIN - columns * _GAP
    side = (room - (rows - 1) * between / aspect) / (columns + rows)
    side = max(side, 0.5 * room / columns)
    large = room - columns * side
    high = max(rows * side * aspect + (rows - 1) * between, large * aspect)
    figure = new_figure(WIDTH, _TITLE + high + _NOTE + 2 * _MARGIN, by_hand=True)
    top = _MARGIN + _TITLE
    axes = place(figure, _MARGIN, top, large, large * aspect)
    show_image(axes, initial, peak, title="initial image")
    for index, (picture, title, note) in enumerate(zip(pictures, titles, notes, strict=True)):
        row, column = divmod(index, columns)
        left = _MARGIN + large + _GAP + column * (side + _GAP)
        axes = place(figure, left, top + row * (side * aspect + between), side, side * aspect)
        show_image(axes, picture, peak, title=title, note=note)
    return figure


def error_panel(errors: Sequence[np.ndarray], titles: Sequence[str], notes: Sequence[str], peak: float) -> Figure:
    """Draws deformed minus initial, with a colour bar in gray levels: red is too bright, blue too dark."""
    planes = [error.mean(axis=-1) if error.ndim == 3 else error for error in errors]
    aspect = cell_aspect(planes[0])
    columns = 2 if len(planes) in (2, 4) else min(len(planes), 3)
    rows = -(-len(planes) // columns)
    # A single image need not fill the page.
    side = min((WIDTH - 2 * _MARGIN - _BAR - columns * _GAP) / columns, 3.4)
    step = side * aspect + _TITLE + _NOTE + _GAP
    high = rows * step - _TITLE - _NOTE - _GAP
    width = 2 * _MARGIN + _BAR + columns * (side + _GAP)
    figure = new_figure(width, _TITLE + high + _NOTE + 2 * _MARGIN, by_hand=True)
    top = _MARGIN + _TITLE
    drawn = None
    for index, (plane, title, note) in enumerate(zip(planes, titles, notes, strict=True)):
        row, column = divmod(index, columns)
        axes = place(figure, _MARGIN + column * (side + _GAP), top + row * step, side, side * aspect)
        drawn = axes.imshow(plane, cmap="RdBu_r", vmin=-peak, vmax=peak, interpolation="antialiased")
        bare(axes)
        axes.set_title(title, pad=4)
        axes.set_xlabel(note)
    if drawn is not None:
        bar = figure.colorbar(drawn, cax=place(figure, width - _MARGIN - _BAR, top, 0.14, high))
        bar.set_label("deformed − initial  [gray levels]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def cell_aspect(image: np.ndarray) -> float:
    """Returns the height over the width of the place for an image: its own, unless it is a strip."""
    return float(np.clip(image.shape[0] / image.shape[1], 0.4, 2.0))


def place(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Adds axes at a place in inches from the figure's upper left corner."""
    whole_width, whole_height = figure.get_size_inches()
    return figure.add_axes(
        (left / whole_width, 1 - (top + height) / whole_height, width / whole_width, height / whole_height)
    )
