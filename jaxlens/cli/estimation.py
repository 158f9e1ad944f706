"""What `jaxlens fit` and `jaxlens calibrate` share: which lens to fit, how, and where the result goes."""

import contextlib
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional

from tyro.conf import arg

from jaxlens.cli import options
from jaxlens.cli.inputs import check_file
from jaxlens.cli.lenses import check_saved, choose_lens, coefficients, starting_lens
from jaxlens.cli.messages import CommandError, UsageError, in_options, say
from jaxlens.cli.outputs import check_new_file, make_folder, write_calibration, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxlens.calibrations import Calibration
    from jaxlens.fitting import Fit
    from jaxlens.frames import Frame
    from jaxlens.lenses import Lens

Loss = Literal["linear", "huber", "cauchy"]

# Normalized coordinates are below this: half diagonals, or tangents of angles up to 87 degrees.
_NORMALIZED = 20.0


@dataclass(frozen=True, kw_only=True)
class FitArguments:
    """How to fit, and where the result goes."""

    model: Annotated[str, arg(metavar="NAME")] = "radial"
    """The lens: radial (1 + κ1 r² + κ2 r⁴ + …), division, or brown-conrady (OpenCV's k1 k2 p1 p2 k3 and so on).
    Or package.module:Class, a lens of your own: that module is looked for in the current folder, too, and is run."""

    terms: Annotated[Optional[int], arg(metavar="N", help_behavior_hint="(default: radial 2, brown-conrady 5)")] = None
    """How many coefficients the lens has."""

    start: Annotated[
        Optional[options.Numbers | Path],
        options.numbers_or_file("K1 [K2 ...]|LENS.json", largest=1e6),
        arg(help_behavior_hint="(default: zeros, or what a search finds)"),
    ] = None
    """The coefficients from which the fit starts; those left out are zero. Or a calibration with a lens of --model."""

    loss: Loss = "linear"
    """How residuals count; huber and cauchy are for data some of which are wrong."""

    output: Annotated[Optional[Path], arg(metavar="LENS.json", aliases=["-o"], help_behavior_hint="")] = None
    """Write the lens, with its covariance, for --lens of distort and undistort."""

    plots: Annotated[Optional[Path], arg(metavar="DIR", help_behavior_hint="")] = None
    """Draw the fit into this folder, which is made if need be."""

    overwrite: options.Overwrite = False


def check_fit_arguments(arguments: FitArguments) -> None:
    """Refuses what no data could be fitted with, before anything is read.

    Raises:
        UsageError: an option's value is out of bounds, or a file is in the way.
    """
    model_lens(arguments)
    if arguments.output is not None:
        check_saved(arguments.model)
        check_new_file(arguments.output, overwrite=arguments.overwrite)
    if arguments.plots is not None and arguments.plots.exists() and not arguments.plots.is_dir():
        raise UsageError(f"--plots {str(arguments.plots)!r} is a file; name a folder")


def check_normalized(size: tuple[int, int] | None, columns: dict[str, list[float]], names: Sequence[str]) -> None:
    """Refuses pixels where no picture's size says so.

    Raises:
        UsageError: without a size, a coordinate that no normalized one reaches.
    """
    largest = max((abs(value) for name in names for value in columns[name]), default=0.0)
    if size is None and largest > _NORMALIZED:
        raise UsageError(
            f"coordinates up to {largest:.6g} look like pixels; pass --image-size WIDTHxHEIGHT, the size of the "
            "pictures that they are from, or divide them by the focal length or half the diagonal"
        )


def frame_and_unit(size: tuple[int, int] | None) -> "tuple[Frame, str]":
    """Returns the frame of points: Eq. 10's, in pixels of a picture of that size; none, and their own unit, without."""
    from jaxlens.frames import Frame

    if size is None:
        return Frame([0.0, 0.0], 1.0), "normalized units"
    return Frame.half_diagonal(size[1], size[0]), "pixels"


def model_lens(arguments: FitArguments) -> "Lens":
    """Returns the lens to start from: that of --start, or the one without distortion.

    Raises:
        UsageError: as `jaxlens.cli.lenses.starting_lens`, or --start is a file that holds no lens of --model.
    """
    calibration = start_calibration(arguments)
    if calibration is None:
        assert not isinstance(arguments.start, Path)
        return starting_lens(arguments.model, arguments.terms, arguments.start or ())
    lens = calibration.lens()
    return lens if arguments.terms is None else starting_lens(arguments.model, arguments.terms, coefficients(lens))


def start_calibration(arguments: FitArguments) -> "Calibration | None":
    """Returns the calibration that --start names; None if it names none.

    Raises:
        UsageError: there is no such file, or it holds no lens of --model.
    """
    if not isinstance(arguments.start, Path):
        return None
    check_file(arguments.start)
    return choose_lens(None, arguments.start, arguments.model).calibration


@contextlib.contextmanager
def fitting() -> Iterator[None]:
    """Fits in double precision; what a fit refuses becomes a message, and what it warns of is in its summary.

    Raises:
        CommandError: the fit failed, or the data cannot be fitted.
    """
    import jax
    from rich.console import Console

    from jaxlens.fitting import FitError, FitWarning

    # Seconds of compilation come first: on a terminal there is something to see meanwhile.
    waiting = Console(stderr=True).status("fitting …") if sys.stderr.isatty() else contextlib.nullcontext()
    with waiting, jax.enable_x64(True), warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        try:
            yield
        except (FitError, ValueError) as error:
            raise CommandError(f"cannot fit: {in_options(error)}") from error


def deliver(
    arguments: FitArguments,
    fit: "Fit",
    image_size: tuple[int, int] | None,
    figures: "dict[str, Figure] | None" = None,
    notes: Sequence[str] = (),
) -> None:
    """Prints the summary and further notes, writes the calibration and the figures.

    Raises:
        CommandError: something cannot be written.
    """
    print("\n".join([fit.summary(), *notes]))  # noqa: T201
    if arguments.output is not None:
        from jaxlens.calibrations import Calibration, CalibrationError

        try:
            calibration = Calibration.from_fit(fit, image_size=image_size)
        except CalibrationError as error:
            raise CommandError(f"cannot write {str(arguments.output)!r}: {error}") from error
        write_calibration(arguments.output, calibration, overwrite=arguments.overwrite)
        say(f"wrote {str(arguments.output)!r}")
    if arguments.plots is not None:
        _write_figures(arguments, figures or {})


def _write_figures(arguments: FitArguments, figures: "dict[str, Figure]") -> None:
    folder = arguments.plots
    assert folder is not None
    taken = [name for name in figures if (folder / f"{name}.png").exists()]
    if taken and not arguments.overwrite:
        raise CommandError(f"{str(folder / (taken[0] + '.png'))!r} exists; pass --overwrite to replace it")
    make_folder(folder)
    for name, figure in figures.items():
        write_figure(folder / f"{name}.png", figure, overwrite=arguments.overwrite)
    say(f"drew {', '.join(f'{name}.png' for name in figures)} in {str(folder)!r}")
