"""How figures look, and how they are written so that the same figure is the same bytes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib
import numpy as np
import PIL.Image
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxlens.figures.palette import FAINT, MUTED

# Of pictures: 1120 pixels for a column of 800, which high-resolution screens show sharp.
_DPI = 160
# Of JPEG files, Pillow's scale: letters on a picture stay crisp.
_QUALITY = 85
# What of lines is written as lines, and which of its metadata change from day to day, or with matplotlib's version.
_UNDATED = {
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.labelsize": 9.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.grid": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "grid.color": FAINT,
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.6,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    # Paths, so that no reader needs the font; ids from a fixed salt, so that they do not change.
    "svg.fonttype": "path",
    "svg.hashsalt": "jaxlens",
}


@contextmanager
def style() -> Iterator[None]:
    """Sets matplotlib's parameters while figures are drawn and written, from its defaults and not the user's."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        for key, value in _STYLE.items():
            matplotlib.rcParams[key] = value  # pyright: ignore[reportArgumentType]
        yield


def new_figure(width: float, height: float, *, by_hand: bool = False) -> Figure:
    """Returns a figure of a size in inches, outside of pyplot's list; it lays itself out, unless done by hand."""
    figure = Figure(figsize=(width, height), layout=None if by_hand else "constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Writes a figure, without dates or versions, in the format that the file's name ends in.

    Args:
        figure: What is drawn.
        path: `.svg` or `.pdf` for line art. `.jpg` for photographs and other smooth shades. `.png` for what is drawn
            and has too many lines for SVG: gray where nothing in it has a colour, and of 256 colours where they do.
    """
    suffix = path.suffix.lower()
    if suffix in _UNDATED:
        figure.savefig(path, dpi=_DPI, metadata=_UNDATED[suffix])
        return
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    gray = bool((pixels == pixels[..., :1]).all())
    picture = PIL.Image.fromarray(np.ascontiguousarray(pixels[..., 0] if gray else pixels))
    if suffix == ".png":
        picture = picture if gray else _fewer_colours(picture)
        picture.save(path, optimize=True, dpi=(_DPI, _DPI))
    else:
        # Colours as fine as the grays, so that coloured lines and letters stay sharp.
        picture.save(path, quality=_QUALITY, subsampling=0, optimize=True, dpi=(_DPI, _DPI))


def _fewer_colours(picture: PIL.Image.Image) -> PIL.Image.Image:
    """Returns a picture of 256 colours, unless they move its own by a level in the mean: smooth shades show bands."""
    indexed = picture.quantize(256, PIL.Image.Quantize.MAXCOVERAGE, dither=PIL.Image.Dither.NONE)
    moved = np.abs(np.asarray(indexed.convert("RGB"), np.int16) - np.asarray(picture)).mean()
    return indexed if moved < 1 else picture


def plain(text: str) -> str:
    """Returns text of unknown origin so that matplotlib does not take it for a formula."""
    return text.replace("$", r"\$")


def kappa_label(kappa: Sequence[float] | np.ndarray) -> str:
    """Returns coefficients as people write them: `κ = (0, 1)`."""
    inner = ", ".join(f"{float(value):.3g}".replace("-", "−") for value in kappa)
    return f"κ = ({inner})" if len(kappa) > 1 else f"κ = {inner}"


def pair_label(kappa: Sequence[float] | np.ndarray) -> str:
    """Returns coefficients for an axis: `0, 1`."""
    return ", ".join(f"{float(value):.3g}".replace("-", "−") for value in kappa)


def show_image(axes: Axes, pixels: np.ndarray, peak: float, *, title: str = "", note: str = "") -> None:
    """Draws an image, black to `peak`, without ticks; a title above it and a smaller note below."""
    shown = np.clip(pixels / peak, 0, 1)
    axes.imshow(shown, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    bare(axes)
    if title:
        axes.set_title(title, pad=4)
    if note:
        axes.set_xlabel(note, color=MUTED, labelpad=3)


def bare(axes: Axes) -> None:
    """Takes ticks and frame off."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
