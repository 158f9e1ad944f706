"""What `jaxlens distort` and `jaxlens undistort` share: their options, and pictures through a lens, cropped or not."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.inputs import read_picture
from jaxlens.cli.jobs import Job, plan_jobs, run_jobs
from jaxlens.cli.lenses import LensChoice, check_choice, choose_lens
from jaxlens.cli.messages import CommandError, UsageError, describe, in_options, say
from jaxlens.cli.outputs import has_quality, make_folder, write_calibration, write_picture
from jaxlens.cli.views import AS_IT_IS, Direction, View, place

if TYPE_CHECKING:
    from jaxlens.calibrations import Calibration
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


def warp_pictures(
    arguments: WarpArguments, direction: Direction, view: View = AS_IT_IS, camera_output: Path | None = None
) -> int:
    """Puts pictures through a lens.

    Args:
        arguments: The pictures, the lens, and how to sample and write.
        direction: Apply the lens, or remove it.
        view: What to show of a picture whose lens is removed.
        camera_output: Where to write the camera of the results, one for all of them.

    Returns:
        The exit code: 0, or 1 where a picture failed.

    Raises:
        UsageError: an option's value is out of bounds, or the file of the lens is no calibration.
    """
    _check(arguments)
    view.check()
    jobs = plan_jobs(arguments.files, arguments.output)
    if arguments.quality is not None and not any(has_quality(job.target) for job in jobs):
        raise UsageError(f"--quality {arguments.quality} is for JPEG and WebP, and none will be written; leave it out")
    chosen = choose_lens(arguments.kappa, arguments.lens, arguments.model, arguments.center)
    warp = _Warp(arguments, chosen, direction, view, camera_output)
    return run_jobs(jobs, warp, direction, overwrite=arguments.overwrite)


def _check(arguments: WarpArguments) -> None:
    """Refuses, without reading a file, what no picture could be warped with."""
    if not arguments.output:
        raise UsageError("--output is empty; a variable in your script may be unset")
    check_choice(arguments.kappa, arguments.lens, arguments.model, arguments.center)
    options.check_quality(arguments.quality)
    if arguments.fill is not None and len(arguments.fill) > 4:
        raise UsageError(f"--fill takes one number, or one for each channel, got {len(arguments.fill)}")
    options.check_max_pixels(arguments.max_pixels)


@dataclass
class _Warp:
    """Warps one picture after another.

    Attributes:
        arguments: How to sample and write.
        chosen: The lens.
        direction: Apply it, or remove it.
        view: What to show.
        camera_output: Where the results' camera is written, with the first of them.
        written: That camera, once it is.
        told: The warnings that were given already.
    """

    arguments: WarpArguments
    chosen: LensChoice
    direction: Direction
    view: View
    camera_output: Path | None
    written: "Calibration | None" = None
    told: set[str] = field(default_factory=set)

    def __call__(self, job: Job) -> str:
        """Warps the picture of a job; returns what was written, in words."""
        arguments = self.arguments
        picture = read_picture(job.source, arguments.max_pixels)
        try:
            warped, camera = self._warped(picture)
        except ValueError as error:
            raise CommandError(f"cannot {self.direction} {str(job.source)!r}: {in_options(error)}") from error
        if self.written not in (None, camera):
            raise CommandError(
                f"{str(job.source)!r} has a camera other than the one in {str(self.camera_output)!r}, for its size is "
                "another; run pictures of each size apart"
            )
        if job.folder is not None:
            make_folder(job.folder)
        quality = arguments.quality if has_quality(job.target) else None
        write_picture(job.target, warped, overwrite=arguments.overwrite, quality=quality)
        if self.camera_output is not None and self.written is None and camera is not None:
            write_calibration(self.camera_output, camera, overwrite=arguments.overwrite)
            self.written = camera
        return f"{str(job.target)!r} ({describe(warped)})"

    def _warped(self, picture: "Picture") -> "tuple[Picture, Calibration | None]":
        """The warped picture, and its camera if that is to be written."""
        # Here, for JAX takes its time to import: a picture that cannot be read says so at once.
        import jax

        from jaxlens import images
        from jaxlens.cli.coverage import inner_rectangle

        arguments, (height, width) = self.arguments, picture.pixels.shape[:2]
        with jax.enable_x64(True):
            placed = place(self.chosen, self.direction, height, width, self.view)
        self._warn(height, width)
        warped = images.warp(
            picture,
            placed.mapping,
            frame=placed.frame,
            output_frame=placed.output_frame,
            shape=placed.shape,
            method=arguments.method,
            border=arguments.border,
            fill=arguments.fill,
            antialias=arguments.antialias,
        )
        top, left, (tall, wide) = 0, 0, placed.shape
        if arguments.crop:
            top, left, tall, wide = inner_rectangle(self.chosen, self.direction, height, width, self.view)
        if tall == 0:
            raise ValueError(
                "no pixel of the result draws from inside the picture, and --crop would leave nothing; leave it out"
            )
        warped = replace(warped, pixels=warped.pixels[top : top + tall, left : left + wide])
        if placed.camera is None or self.camera_output is None:
            return warped, None
        from jaxlens.calibrations import Calibration

        with jax.enable_x64(True):
            camera = placed.camera.cropped(top, left, tall, wide)
            return warped, Calibration.from_lens(camera.lens, frame=camera.frame, image_size=(wide, tall))

    def _warn(self, height: int, width: int) -> None:
        """Warns, once, of pixels that the lens did not see."""
        from jaxlens.cli.coverage import find_fold

        fold = find_fold(self.chosen, self.direction, height, width, self.view)
        if fold is None:
            return
        of = f"a picture of {width} × {height}: {fold.share:.2%} of the pixels"
        at = (
            ""
            if fold.radius is None
            else f" at the radius {fold.radius:.4g} ({fold.pixels:.1f} pixels from its centre)"
        )
        message = f"warning: the lens folds{at} in {of} have no preimage and take the fill value"
        if self.view.fov is not None or self.view.projection != "perspective":
            message = f"warning: the lens does not see all of the view of {of} take the fill value"
        if message not in self.told:
            self.told.add(message)
            say(message)
