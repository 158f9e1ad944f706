"""`jaxlens fit images`: a lens from a picture without it and the same picture with it."""

# Optional[X] for the same reason as in `jaxlens.cli.options`.
# ruff: noqa: UP045

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli.errors import CommandError
from jaxlens.cli.fits import FitArguments, check_fit_arguments, deliver, fitting, model_lens
from jaxlens.cli.options import check_file, check_max_pixels

HELP = """Find the lens that turns one picture into another.

What it does:
  Compares gray values, from coarse to fine, and fits a gain and an offset of
  them, too. Only places that both pictures show count. Use --loss cauchy
  where something covers a part of one of them.

Examples:
  jaxlens fit images portrait.png distorted.png --output lens.json
  jaxlens fit images a.png b.jpg --fit-center --loss cauchy --plots fit/"""


@dataclass(frozen=True)
class Arguments(FitArguments):
    """Find the lens that turns one picture into another."""

    source: Annotated[Path, Positional, arg(metavar="SOURCE", help_behavior_hint="")]
    """The picture without the lens."""

    distorted: Annotated[Path, Positional, arg(metavar="DISTORTED", help_behavior_hint="")]
    """The picture with it."""

    fit_center: Annotated[bool, arg(help_behavior_hint="")] = False
    """Fit the lens's centre of distortion, too."""

    max_pixels: Annotated[Optional[int], arg(metavar="COUNT", help_behavior_hint="(default: 200 million)")] = None
    """Refuse pictures with more pixels, before they are decoded."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_fit_arguments(arguments)
    check_max_pixels(arguments.max_pixels)
    check_file(arguments.source)
    check_file(arguments.distorted)
    from jaxlens.cli.pictures import describe, read_picture

    source, distorted = (read_picture(path, arguments.max_pixels) for path in (arguments.source, arguments.distorted))
    height, width = source.pixels.shape[:2]
    if distorted.pixels.shape[:2] != (height, width):
        raise CommandError(
            f"{str(arguments.source)!r} is {describe(source)}, and {str(arguments.distorted)!r} is "
            f"{describe(distorted)}: resize one of them, so that a pixel of both is as large"
        )
    import jax.numpy as jnp

    from jaxlens.fitting import fit_images

    with fitting():
        first, second = (jnp.asarray(_colours(picture.pixels), float) for picture in (source, distorted))
        fit = fit_images(
            model_lens(arguments),
            first,
            second,
            center=arguments.fit_center,
            search=arguments.start is None,
            loss=arguments.loss,
        )
        figures = None
        if arguments.plots is not None:
            import numpy as np

            from jaxlens.figures.fits import curve_figure, pictures_figure
            from jaxlens.warping import pixel_grid

            assert fit.frame is not None
            corners = np.asarray(fit.frame.normalize(pixel_grid(height, width, float)))[:: height - 1, :: width - 1]
            figures = {
                "pictures": pictures_figure(fit, first, second),
                "curve": curve_figure(fit, corners.reshape(-1, 2), "pixels"),
            }
        deliver(arguments, fit, (width, height), figures)
    return 0


def _colours(pixels):
    """Pixels without alpha, which is no brightness."""
    return pixels[..., :-1] if pixels.ndim == 3 and pixels.shape[2] in (2, 4) else pixels
