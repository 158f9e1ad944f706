"""`jaxlens fit images`: a lens from a picture without it and the same picture with it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.estimation import FitArguments, check_fit_arguments, deliver, fitting, model_lens
from jaxlens.cli.inputs import check_file, read_picture
from jaxlens.cli.messages import UsageError, describe

if TYPE_CHECKING:
    import numpy as np

    from jaxlens.images import Picture

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

    fit_center: options.FitCenter = False
    max_pixels: options.MaxPixels = None


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_fit_arguments(arguments)
    options.check_max_pixels(arguments.max_pixels)
    check_file(arguments.source)
    check_file(arguments.distorted)
    source, distorted = (read_picture(path, arguments.max_pixels) for path in (arguments.source, arguments.distorted))
    height, width = source.pixels.shape[:2]
    if distorted.pixels.shape[:2] != (height, width):
        raise UsageError(
            f"{str(arguments.source)!r} is {describe(source)}, and {str(arguments.distorted)!r} is "
            f"{describe(distorted)}: they must be of one size; resize one of them, so that a pixel of both is as large"
        )
    import jax.numpy as jnp

    from jaxlens.fitting import fit_images

    with fitting():
        first, second = (jnp.asarray(_colours(picture), float) for picture in (source, distorted))
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


def _colours(picture: "Picture") -> "np.ndarray":
    """Pixels without alpha, which is no brightness."""
    return picture.pixels[..., :-1] if picture.has_alpha else picture.pixels
