"""What `jaxlens distort` and `jaxlens undistort` share: their options, and pictures through a lens, cropped or not."""

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.inputs import read_picture
from jaxlens.cli.jobs import Job, plan_jobs, run_jobs
from jaxlens.cli.lenses import LensChoice, check_choice, choose_lens
from jaxlens.cli.messages import CommandError, UsageError, describe, in_options, say
from jaxlens.cli.outputs import has_quality, make_folder, write_picture

if TYPE_CHECKING:
    from jaxlens.images import Picture


@dataclass(frozen=True)
class WarpArguments:
    """A lens, and pictures to put through it."""

    files: Annotated[options.Paths, Positional, options.words(options.Paths, "FILE..."), arg(help_behavior_hint="")]
    """Pictures (PNG, JPEG, TIFF, WebP, BMP, PNM, GIF, AVIF), or folders of them, which are not searched deeper."""

    output: Annotated[str, arg(metavar="PATH", aliases=["-o"])]
    """For one picture its new file, whose suffix is its format, or a folder that exists or ends in a slash.
    For several pictures, or a folder of them, a folder, which is made if need be."""

    kappa: options.Kappa = None
    """The lens Φ(r²) = 1 + κ1 r² + κ2 r⁴ + …, r in half-diagonals from its centre; κ < 0 is barrel, > 0 pincushion."""

    lens: options.Lens = None
    model: options.LensModel = None

    method: options.Method = "bilinear"
    """How to read between pixels; bicubic is Keys's kernel, bicubic_opencv that of OpenCV."""

    border: options.Border = "constant"
    """What lies outside the picture: the fill value, its last pixels repeated, its mirror image, or its other side."""

    fill: Annotated[
        Optional[options.Numbers],
        options.numbers("VALUE [VALUE ...]", nan=True),
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
        Optional[options.Numbers],
        options.numbers("X Y", count=2, largest=1e6),
        arg(help_behavior_hint="(default: half of its width and height)"),
    ] = None
    """The lens's centre in pixels from the centre of the first one, to the right and down."""

    quality: options.Quality = None
    overwrite: options.Overwrite = False
    max_pixels: options.MaxPixels = None


def warp_pictures(arguments: WarpArguments, direction: Literal["distort", "undistort"]) -> int:
    """Puts pictures through a lens.

    Args:
        arguments: The pictures, the lens, and how to sample and write.
        direction: Apply the lens, or remove it.

    Returns:
        The exit code: 0, or 1 where a picture failed.

    Raises:
        UsageError: an option's value is out of bounds, or the file of the lens is no calibration.
    """
    _check(arguments)
    jobs = plan_jobs(arguments.files, arguments.output)
    if arguments.quality is not None and not any(has_quality(job.target) for job in jobs):
        raise UsageError(f"--quality {arguments.quality} is for JPEG and WebP, and none will be written; leave it out")
    chosen = choose_lens(arguments.kappa, arguments.lens, arguments.model, arguments.center)
    do = partial(_do, arguments, chosen, direction, set())
    return run_jobs(jobs, do, direction, overwrite=arguments.overwrite)


def _check(arguments: WarpArguments) -> None:
    """Refuses, without reading a file, what no picture could be warped with."""
    if not arguments.output:
        raise UsageError("--output is empty; a variable in your script may be unset")
    check_choice(arguments.kappa, arguments.lens, arguments.model, arguments.center)
    options.check_quality(arguments.quality)
    if arguments.fill is not None and len(arguments.fill) > 4:
        raise UsageError(f"--fill takes one number, or one for each channel, got {len(arguments.fill)}")
    options.check_max_pixels(arguments.max_pixels)


def _do(
    arguments: WarpArguments, chosen: LensChoice, direction: Literal["distort", "undistort"], told: set[str], job: Job
) -> str:
    picture = read_picture(job.source, arguments.max_pixels)
    try:
        warped = _warped(picture, arguments, chosen, direction, told)
    except ValueError as error:
        raise CommandError(f"cannot {direction} {str(job.source)!r}: {in_options(error)}") from error
    if job.folder is not None:
        make_folder(job.folder)
    quality = arguments.quality if has_quality(job.target) else None
    write_picture(job.target, warped, overwrite=arguments.overwrite, quality=quality)
    return f"{str(job.target)!r} ({describe(warped)})"


def _warped(
    picture: "Picture",
    arguments: WarpArguments,
    chosen: LensChoice,
    direction: Literal["distort", "undistort"],
    told: set[str],
) -> "Picture":
    # Here, for JAX takes its time to import: a picture that cannot be read says so at once.
    import jax

    from jaxlens import images
    from jaxlens.cli.coverage import find_fold, inner_rectangle, mapping_of

    height, width = picture.pixels.shape[:2]
    fold = find_fold(chosen, direction, height, width)
    if fold is not None:
        at = ""
        if fold.radius is not None:
            at = f" at the radius {fold.radius:.4g} ({fold.pixels:.1f} pixels from its centre)"
        message = (
            f"warning: the lens folds{at} in a picture of {width} × {height}: {fold.share:.2%} of the pixels have no "
            "preimage and take the fill value"
        )
        if message not in told:
            told.add(message)
            say(message)
    with jax.enable_x64(True):
        lens, frame = chosen.place(height, width)
        mapping = mapping_of(lens, direction)
    warped = images.warp(
        picture,
        mapping,
        frame=frame,
        method=arguments.method,
        border=arguments.border,
        fill=arguments.fill,
        antialias=arguments.antialias,
    )
    if not arguments.crop:
        return warped
    top, left, tall, wide = inner_rectangle(chosen, direction, height, width)
    if tall == 0:
        raise ValueError(
            "no pixel of the result draws from inside the picture, and --crop would leave nothing; leave it out"
        )
    return replace(warped, pixels=warped.pixels[top : top + tall, left : left + wide])
