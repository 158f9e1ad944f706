"""`jaxlens inspect`: what a camera is and how far it sees, in numbers and drawn; and how it differs from another."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.inputs import check_file
from jaxlens.cli.lenses import choose_lens, find_model
from jaxlens.cli.messages import CommandError, UsageError, say
from jaxlens.cli.outputs import check_new_file, write_figure

if TYPE_CHECKING:
    import numpy as np

    from jaxlens.calibrations import Calibration
    from jaxlens.cameras import Camera
    from jaxlens.diagnostics import Difference

HELP = """Describe a camera, or say how two cameras differ.

What it does:
  Prints the model and its parameters, the field of view, where the lens folds
  and whether every pixel has a ray, and how far the lens moves pixels. The
  figure shows straight lines through the lens, and the radius in the picture
  against the angle from the axis. With a second camera it also turns that one
  to where both agree best, says how far apart in pixels they see the same
  ray, and the figure is the map of these distances.

Examples:
  jaxlens inspect camera.json
  jaxlens inspect camera.json --output camera.svg
  jaxlens inspect before.json after.json --output moved.png"""

# At most so many pixels a side are looked at, the outermost among them: of a smaller picture, all.
_SIDE = 640
# Of the map of differences, along the longer side.
_CELLS = 160
# Points of the radius curve, and of a line across the picture; how often the gap at its end is divided by as many.
_POINTS, _REFINEMENTS = 1001, 2
# Angles nearer to one another are one.
_SAME_ANGLE = math.radians(1e-3)


@dataclass(frozen=True)
class Arguments:
    """Describe a camera, or say how two cameras differ."""

    camera: Annotated[Path, Positional, arg(metavar="CAMERA", help_behavior_hint="")]
    """A calibration by jaxlens fit or jaxlens calibrate."""

    other: Annotated[Optional[Path], Positional, arg(metavar="OTHER", help_behavior_hint="")] = None
    """Another, of the same pictures or of larger or smaller ones of the same shape."""

    output: Annotated[Optional[Path], arg(metavar="FIGURE", aliases=["-o"], help_behavior_hint="")] = None
    """Draw it: .png, .svg or .pdf."""

    no_rotation: Annotated[bool, arg(help_behavior_hint="")] = False
    """Compare as the cameras are: the other is not turned."""

    image_size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: the file's)")] = None
    """The size of the pictures, where the file does not say it or where they were resized."""

    model: options.LensModel = None
    overwrite: options.Overwrite = False


@dataclass(frozen=True)
class _Subject:
    """A camera with its file.

    Attributes:
        path: The file.
        calibration: What is in it.
        camera: For the size asked for.
        has_angles: Whether the unit of its frame is a focal length, and not half the diagonal of Eq. 10: of that
            nobody knows the angle.
    """

    path: Path
    calibration: "Calibration"
    camera: "Camera"
    has_angles: bool


@dataclass(frozen=True, eq=False)
class _Sight:
    """The rays of a picture; NaN where there is none.

    Attributes:
        pixels: `(rows, columns, 2)` over the picture, the outermost among them.
        rays: `(rows, columns, 3)` of these pixels.
        lines: `(n, 4, 3)` rays from edge to edge: the middle row and column, and both diagonals.
    """

    pixels: "np.ndarray"
    rays: "np.ndarray"
    lines: "np.ndarray"


@dataclass(frozen=True, eq=False)
class _Profile:
    """The radius towards the picture's farthest corner, up to where the lens ends.

    Attributes:
        angles: `(n,)` from the axis, in radians, increasing.
        radii: `(n,)` pixels from the principal point; none where the lens does not even see its axis.
        focal: Pixels per unit of tan(angle) in that direction.
        corner: Pixels from the principal point to the corner.
    """

    angles: "np.ndarray"
    radii: "np.ndarray"
    focal: float
    corner: float


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    paths = [path for path in (arguments.camera, arguments.other) if path is not None]
    for path in paths:
        check_file(path)
    size = None if arguments.image_size is None else options.parse_size(arguments.image_size, "--image-size")
    if arguments.no_rotation and arguments.other is None:
        raise UsageError("--no-rotation is for two cameras; name another, or leave it out")
    if arguments.output is not None:
        suffixes = (".png", ".svg", ".pdf")
        check_new_file(arguments.output, overwrite=arguments.overwrite, suffixes=suffixes)
    import jax

    with jax.enable_x64(True):
        first, *others = _read(paths, size, arguments.model)
        sight, profile = _sight(first.camera), _profile(first.camera)
        _print([*_identity(first), *_reach(first, profile, sight)])
        found = _compare(first, others[0], rotate=not arguments.no_rotation) if others else None
        if arguments.output is None:
            return 0
        from jaxlens.figures.cameras import camera_figure, difference_figure

        if found is None:
            figure = camera_figure(
                first.camera,
                sight.pixels,
                sight.rays,
                angles=profile.angles,
                radii=profile.radii,
                focal=profile.focal,
                corner=profile.corner,
                has_angles=first.has_angles,
            )
        else:
            figure = difference_figure(first.camera, found)
        write_figure(arguments.output, figure, overwrite=arguments.overwrite)
    say(f"wrote {str(arguments.output)!r}")
    return 0


def _read(paths: Sequence[Path], size: tuple[int, int] | None, model: str | None) -> list[_Subject]:
    """Returns the cameras for pictures of one size: the one asked for, or the first that a file knows."""
    if model is not None:
        find_model(model)
    found = [choose_lens(None, path, None).calibration for path in paths]
    calibrations = [one for one in found if one is not None]
    size = size or next((one.image_size for one in calibrations if one.image_size is not None), None)
    if size is None:
        raise UsageError(f"{str(paths[0])!r} does not say how large its pictures are: pass --image-size WIDTHxHEIGHT")
    import numpy as np

    from jaxlens.calibrations import CalibrationError
    from jaxlens.frames import Frame

    width, height = size
    subjects = []
    for path, calibration in zip(paths, calibrations, strict=True):
        try:
            camera = calibration.camera(height, width)
        except CalibrationError as error:
            raise UsageError(f"{str(path)!r}: {error}") from error
        if calibration.center is None:
            if camera.lens.needs_frame:
                raise UsageError(
                    f"{str(path)!r} has no frame, and {calibration.model} is written in a camera's: the file needs "
                    'a "frame" of "center" and "scale", in pixels'
                )
            say(f"{str(path)!r} has no frame: Eq. 10's is taken, whose unit is half the diagonal")
        half_diagonal = Frame.half_diagonal(height, width)
        has_angles = camera.lens.needs_frame or not np.allclose(
            [camera.frame.center, camera.frame.scale], [half_diagonal.center, half_diagonal.scale], rtol=1e-9
        )
        subjects.append(_Subject(path, calibration, camera, has_angles))
    if len({one.has_angles for one in subjects}) > 1:
        one = next(one for one in subjects if not one.has_angles)
        say(f"warning: the frame of {str(one.path)!r} is Eq. 10's, not a camera's: the focal lengths differ for that")
    return subjects


def _sight(camera: "Camera") -> "_Sight":
    import numpy as np

    width, height = camera.width, camera.height
    columns, rows = (np.unique(np.linspace(0, size - 1, min(size, _SIDE)).round()) for size in (width, height))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    left, top, right, bottom = -0.5, -0.5, width - 0.5, height - 0.5
    x, y = (left + right) / 2, (top + bottom) / 2
    starts = np.array([(left, y), (x, top), (left, top), (left, bottom)])
    ends = np.array([(right, y), (x, bottom), (right, bottom), (right, top)])
    along = np.linspace(0, 1, _POINTS)[:, None, None]
    lines = (1 - along) * starts + along * ends
    # All at once: it is compiled once.
    rays = np.asarray(camera.unproject(np.concatenate([pixels.reshape(-1, 2), lines.reshape(-1, 2)])))
    count = pixels[..., 0].size
    return _Sight(pixels, rays[:count].reshape(*pixels.shape[:2], 3), rays[count:].reshape(*lines.shape[:2], 3))


def _profile(camera: "Camera") -> _Profile:
    import numpy as np

    center, scale = np.asarray(camera.frame.center), np.asarray(camera.frame.scale)
    corners = np.array([(x, y) for x in (0, camera.width - 1) for y in (0, camera.height - 1)]) - center
    corner = corners[np.argmax(np.hypot(*corners.T))]
    across = corner / scale / (np.hypot(*(corner / scale)) or 1)
    low, high = 0.0, math.pi
    angles = radii = np.empty(0)
    for _ in range(1 + _REFINEMENTS):
        here = np.linspace(low, high, _POINTS)
        rays = np.stack([np.sin(here) * across[0], np.sin(here) * across[1], np.cos(here)], axis=-1)
        radius = np.hypot(*(np.asarray(camera.project(rays)) - center).T)
        seen = int(np.argmin(np.append(np.isfinite(radius), False)))
        new = here[:seen] > angles[-1] if angles.size else np.full(seen, True)
        angles, radii = np.append(angles, here[:seen][new]), np.append(radii, radius[:seen][new])
        if seen in (0, _POINTS):
            break
        low, high = here[seen - 1], here[seen]
    return _Profile(angles, radii, float(np.hypot(*(scale * across))), float(np.hypot(*corner)))


def _print(rows: Sequence[tuple[str, str]]) -> None:
    wide = max(len(label) for label, _ in rows)
    for label, text in rows:
        print(f"{label:{wide}}  {text}")  # noqa: T201


def _identity(subject: _Subject) -> list[tuple[str, str]]:
    """What is in the file."""
    import numpy as np

    camera, estimate = subject.camera, subject.calibration.estimate
    errors = {}
    if estimate is not None:
        variances = np.diag(np.asarray(estimate.covariance, float)) if estimate.names else []
        errors = {
            name: math.sqrt(variance)
            for name, variance in zip(estimate.names, variances, strict=True)
            if variance >= 0 and math.isfinite(variance)
        }
    # The frame may have been resized; its errors are with it.
    stretch = np.asarray(camera.frame.scale) / np.asarray(subject.calibration.scale or camera.frame.scale)
    for name, factor in zip(("fx", "fy", "cx", "cy"), (*stretch, *stretch), strict=True):
        if name in errors:
            errors[name] *= factor

    def measured(name: str, value: float) -> str:
        return f"{name} = {value:.7g}" + (f" ± {errors[name]:.2g}" if name in errors else "")

    (fx, fy), (cx, cy) = (np.asarray(part).tolist() for part in (camera.frame.scale, camera.frame.center))
    parameters = [
        measured(name, value)
        for field in fields(camera.lens)
        for values in [np.asarray(getattr(camera.lens, field.name))]
        for name, value in zip(
            camera.lens.parameter_names(field.name, values.shape), values.ravel().tolist(), strict=True
        )
    ]
    unit = "focal length" if subject.has_angles else "half diagonal"
    rows = [
        ("camera", repr(str(subject.path))),
        ("model", subject.calibration.model),
        *(("" if index else "parameters", text) for index, text in enumerate(parameters)),
        (unit, f"{measured('fx', fx)}, {measured('fy', fy)} pixels"),
        ("principal point" if subject.has_angles else "centre", f"{measured('cx', cx)}, {measured('cy', cy)} pixels"),
        ("picture", f"{camera.width} × {camera.height} pixels"),
    ]
    if estimate is not None:
        rows.append(("fit", f"RMS {estimate.rms:.4g}, {estimate.degrees_of_freedom} degrees of freedom"))
    return rows


def _reach(subject: _Subject, profile: _Profile, sight: _Sight) -> list[tuple[str, str]]:
    """How far the camera sees, and what the lens does to its picture."""
    import numpy as np

    from jaxlens.lenses import WideLens

    camera, rays = subject.camera, sight.rays
    wide = isinstance(camera.lens, WideLens)
    rows = []
    if subject.has_angles:
        sees = math.degrees(float(camera.lens.field_of_view()))
        rows += [
            ("field of view", _fields(sight.lines)),
            ("lens sees", f"to {sees:.2f}° from its axis in every direction"),
        ]
    rows.append(("fold", _fold(profile, wide=wide, has_angles=subject.has_angles)))
    seen = np.isfinite(rays).all(-1)
    about = "" if seen.size == camera.width * camera.height else "about "
    blind = f"{about}{1 - seen.mean():.3%} of the pixels have no ray"
    rows.append(("inverse", "every pixel of the picture has a ray" if seen.all() else blind))
    if not wide and seen.any():
        # A lens on the plane has no rays but those in front.
        ideal = np.asarray(camera.frame.denormalize(rays[..., :2] / rays[..., 2:]))
        moved = np.hypot(*np.moveaxis(sight.pixels - ideal, -1, 0))
        rows.append(("displacement", f"at most {_largest(moved, sight.pixels)}, from its place without the lens"))
    return rows


def _largest(distances: "np.ndarray", pixels: "np.ndarray") -> str:
    import numpy as np

    index = np.unravel_index(np.nanargmax(distances), distances.shape)
    x, y = pixels[index]
    return f"{distances[index]:.4g} pixels, at ({x:g}, {y:g})"


def _fields(lines: "np.ndarray") -> str:
    """The angles between the ends of the picture's middle row and column, and of its longest diagonal."""
    across, upright, *diagonals = (_between(line) for line in lines.swapaxes(0, 1))
    found = {"horizontal": across, "vertical": upright, "diagonal": max(diagonals)}
    return ", ".join(
        f"{name} {math.degrees(angle):.2f}°{'' if whole else ' as far as seen'}"
        for name, (angle, whole) in found.items()
    )


def _between(rays: "np.ndarray") -> tuple[float, bool]:
    """The angle between the first and the last ray that is seen, by way of the middle one, and whether all are seen."""
    import numpy as np

    seen = np.flatnonzero(np.isfinite(rays).all(-1))
    if not seen.size:
        return 0.0, False
    first, middle, last = rays[seen[[0, len(seen) // 2, -1]]]
    halves = (2 * math.atan2(math.dist(one, middle), math.dist(one, -middle)) for one in (first, last))
    return sum(halves), len(seen) == len(rays)


def _fold(profile: _Profile, *, wide: bool, has_angles: bool) -> str:
    """Where the lens ends, towards the farthest corner."""
    if not profile.angles.size:
        return "the lens does not see its own axis"
    end = profile.angles[-1]
    if end > (math.pi if wide else math.pi / 2) - _SAME_ANGLE:
        return "none"
    corner = f"towards the corner, which is at {profile.corner:.1f}"
    if has_angles:
        return (
            f"{math.degrees(end):.2f}° from the axis, {profile.radii[-1]:.1f} pixels from the principal point {corner}"
        )
    return f"{profile.radii[-1]:.1f} pixels from the centre {corner}; there from {profile.focal * math.tan(end):.1f}"


def _compare(first: _Subject, second: _Subject, *, rotate: bool) -> "Difference":
    """Measures the difference, and prints it."""
    import jaxlie
    import numpy as np

    from jaxlens.diagnostics import difference

    camera = first.camera
    longer = max(camera.height, camera.width)
    rows, columns = (max(2, round(_CELLS * side / longer) + 1) for side in (camera.height, camera.width))
    found = difference(camera, second.camera, shape=(rows, columns), rotate=rotate)
    distances = np.asarray(found.distances)
    seen = np.isfinite(distances)
    if not seen.any():
        raise CommandError(f"{str(first.path)!r} and {str(second.path)!r} see no ray in common: there is no difference")
    turn = math.degrees(float(np.linalg.norm(jaxlie.SO3.from_matrix(found.rotation).log())))
    print()  # noqa: T201
    _print(
        [
            *_identity(second),
            (
                "difference",
                f"RMS {float(found.rms):.4g} pixels, at most {_largest(distances, np.asarray(found.pixels))}",
            ),
            ("", f"after turning the second by {turn:.4g}°" if rotate else "as they are, neither turned"),
            *([] if seen.all() else [("seen by both", f"{seen.mean():.2%} of the picture")]),
        ]
    )
    return found
