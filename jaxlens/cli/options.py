"""What `jaxlens distort` and `jaxlens undistort` are told."""

# Optional[X], where the style is X | None: tyro checks the latter with typeguard, whose import would take a third of
# the time in which the help is to appear.
# ruff: noqa: UP045

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Optional

from tyro.conf import Positional, arg

from jaxlens.cli.errors import UsageError
from jaxlens.cli.values import Numbers, Paths, numbers, paths

# Those of jaxlens.sampling, which imports JAX; a test holds them together.
Method = Literal["nearest", "bilinear", "bicubic", "bicubic_opencv"]
Border = Literal["constant", "edge", "reflect", "wrap"]


@dataclass(frozen=True)
class WarpArguments:
    """A lens, and pictures to put through it."""

    files: Annotated[Paths, Positional, paths("FILE..."), arg(help_behavior_hint="")]
    """Pictures (PNG, JPEG, TIFF, WebP, BMP, PNM, GIF, AVIF), or folders of them, which are not searched deeper."""

    output: Annotated[str, arg(metavar="PATH", aliases=["-o"])]
    """For one picture its new file, whose suffix is its format, or a folder that exists or ends in a slash.
    For several pictures, or a folder of them, a folder, which is made if need be."""

    kappa: Annotated[
        Optional[Numbers], numbers("K1 [K2 ...]", largest=1e6), arg(aliases=["-k"], help_behavior_hint="")
    ] = None
    """The lens Φ(r²) = 1 + κ1 r² + κ2 r⁴ + …, r in half-diagonals from its centre; κ < 0 is barrel, > 0 pincushion."""

    lens: Annotated[Optional[Path], arg(metavar="FILE", help_behavior_hint="")] = None
    """A calibration that jaxlens fit or jaxlens calibrate wrote, whose lens is taken in place of --kappa."""

    method: Method = "bilinear"
    """How to read between pixels; bicubic is Keys's kernel, bicubic_opencv that of OpenCV."""

    border: Border = "constant"
    """What lies outside the picture: the fill value, its last pixels repeated, its mirror image, or its other side."""

    fill: Annotated[
        Optional[Numbers],
        numbers("VALUE [VALUE ...]", nan=True),
        arg(help_behavior_hint="(default: black, or transparent)"),
    ] = None
    """The value of pixels without a source: one number for all channels, or one for each.
    It is on the picture's own scale: 8 bits end at 255, 16 bits at 65535, and NaN is for floating pictures.
    In a picture with alpha the fill is opaque, unless its alpha is given last."""

    crop: Annotated[bool, arg(help_behavior_hint="")] = False
    """Keep only the largest upright rectangle without border."""

    antialias: Annotated[bool, arg(help_behavior_hint="")] = False
    """Average where the lens shrinks the picture."""

    center: Annotated[
        Optional[Numbers],
        numbers("X Y", count=2, largest=1e6),
        arg(help_behavior_hint="(default: half of its width and height)"),
    ] = None
    """The lens's centre in pixels from the centre of the first one, to the right and down."""

    quality: Annotated[Optional[int], arg(metavar="1-100", help_behavior_hint="(default: 95, WebP lossless)")] = None
    """How good JPEG and WebP files are; the better, the larger."""

    overwrite: Annotated[bool, arg(help_behavior_hint="")] = False
    """Replace files that exist."""

    max_pixels: Annotated[Optional[int], arg(metavar="COUNT", help_behavior_hint="(default: 200 million)")] = None
    """Refuse pictures with more pixels, before they are decoded."""


def check_options(options: WarpArguments) -> None:
    """Refuses, without reading a file, what no picture could be warped with.

    Raises:
        UsageError: an option's value is out of bounds.
    """
    if not options.output:
        raise UsageError("--output is empty; a variable in your script may be unset")
    if options.kappa is not None and options.lens is not None:
        raise UsageError(f"--kappa and --lens {str(options.lens)!r} are two lenses; leave one of them out")
    if options.kappa is None and options.lens is None:
        raise UsageError("a lens is needed: pass --kappa K1 [K2 ...], or --lens FILE.json")
    if options.lens is not None:
        if options.center is not None:
            raise UsageError("--center goes with --kappa; a calibration has a centre of its own: leave it out")
        check_file(options.lens)
    check_quality(options.quality)
    if options.fill is not None and len(options.fill) > 4:
        raise UsageError(f"--fill takes one number, or one for each channel, got {len(options.fill)}")
    check_max_pixels(options.max_pixels)


def check_quality(quality: int | None) -> None:
    """Refuses a quality that no file has.

    Raises:
        UsageError: it is out of bounds.
    """
    if quality is not None and not 1 <= quality <= 100:
        raise UsageError(f"--quality is from 1 to 100, got {quality}")


def check_max_pixels(max_pixels: int | None) -> None:
    """Refuses a limit that no picture meets.

    Raises:
        UsageError: it is below one.
    """
    if max_pixels is not None and max_pixels < 1:
        raise UsageError(f"--max-pixels is at least 1, got {max_pixels}")


def check_path(path: Path) -> None:
    """Refuses a path where there is nothing.

    Raises:
        UsageError: there is no such file or folder, or it cannot be looked at.
    """
    try:
        path.stat()
    except FileNotFoundError:
        raise UsageError(f"there is no file {str(path)!r}; check the name, and the folder you are in") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"cannot look at {str(path)!r}: {reason}") from None


def check_file(path: Path) -> None:
    """Refuses a path where there is no file.

    Raises:
        UsageError: as `check_path`, or there is a folder.
    """
    check_path(path)
    if path.is_dir():
        raise UsageError(f"{str(path)!r} is a folder; name a file in it")
