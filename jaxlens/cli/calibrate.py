"""`jaxlens calibrate`: a camera from pictures of a chessboard."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.estimation import (
    FitArguments,
    check_fit_arguments,
    deliver,
    fitting,
    model_lens,
    start_calibration,
)
from jaxlens.cli.inputs import check_file, gray_values, list_files, read_picture
from jaxlens.cli.messages import CommandError, UsageError, say

if TYPE_CHECKING:
    import numpy as np

    from jaxlens.images import Picture

HELP = """Calibrate a camera: its matrix, its lens and the poses of a board.

What it does:
  Finds the inner corners of a chessboard in the pictures (by OpenCV:
  pip install 'jaxlens[calibrate]'), or reads them from a CSV file with the
  columns view, corner, board_x, board_y, x, y. Pictures in which no board is
  found are named and left out; so are those that cannot be read, and then the
  exit code is 1. --board counts inner corners. A view need not show them all:
  leave their rows out of the table. Corners that lie far from where the others
  say are named, and so is how well the camera is known in the picture.

Examples:
  jaxlens calibrate photos/ --board 9x6 --output camera.json
  jaxlens calibrate photos/*.jpg --board 9x6 --square 25 --output camera.json
  jaxlens calibrate --corners corners.csv --image-size 640x480 --plots fit/
  jaxlens calibrate photos/ --board 9x6 --start camera.json --fix cx cy k3"""


# Half the window in which a corner is refined, and when that ends.
_WINDOW = (5, 5)
_STEPS, _SMALLEST = 30, 1e-3
# Tangent of the widest angle to which the curve of a lens is drawn, 84°.
_WIDEST = 10.0
# Corners without which a view has no pose.
_FEWEST = 4
# Medians of the residuals beyond which a corner is named (by normal noise, one corner in 2²⁵ is so far off), and how
# many are named.
_FAR, _NAMED = 5, 10


@dataclass(frozen=True)
class Arguments(FitArguments):
    """Calibrate a camera from pictures of a chessboard."""

    files: Annotated[options.Paths, Positional, options.words(options.Paths, "FILE..."), arg(help_behavior_hint="")] = (
        field(default_factory=options.Paths)
    )
    """Pictures of the board, or folders of them, which are not searched deeper; not with --corners."""

    model: Annotated[str, arg(metavar="NAME")] = "brown-conrady"
    """The lens: radial (1 + κ1 r² + κ2 r⁴ + …), division, or brown-conrady (OpenCV's k1 k2 p1 p2 k3 and so on).
    Or package.module:Class, a lens of your own: that module is looked for in the current folder, too, and is run."""

    board: Annotated[Optional[str], arg(metavar="COLUMNSxROWS", help_behavior_hint="")] = None
    """The board's inner corners, such as 9x6."""

    square: Annotated[float, arg(metavar="SIZE")] = 1.0
    """The side of a square, in the unit that the poses shall have."""

    corners: Annotated[Optional[Path], arg(metavar="FILE.csv", help_behavior_hint="")] = None
    """A table of corners that were found elsewhere; its columns are listed above."""

    image_size: Annotated[Optional[str], arg(metavar="WIDTHxHEIGHT", help_behavior_hint="")] = None
    """The pictures' size in pixels, with --corners."""

    fix: Annotated[options.Names, options.words(options.Names, "NAME..."), arg(help_behavior_hint="")] = field(
        default_factory=options.Names
    )
    """Parameters that are not fitted, such as cx cy k3.
    They keep their value in --start; without it, cx and cy are in the middle, and coefficients zero."""

    max_pixels: options.MaxPixels = None


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_fit_arguments(arguments)
    options.check_max_pixels(arguments.max_pixels)
    if bool(arguments.files) == (arguments.corners is not None):
        raise UsageError("pass pictures of the board, with --board, or --corners FILE.csv, with --image-size")
    _check_fixed(arguments)
    found = _enough(_from_table(arguments) if arguments.corners is not None else _from_pictures(arguments))
    names, views, size = found.names, found.views, found.size
    matrix = _start_matrix(arguments, size)
    import numpy as np

    from jaxlens.fitting import Boards, calibrate

    with fitting():
        boards = Boards.from_views(views)
        fit = calibrate(
            model_lens(arguments),
            boards,
            size,
            camera_matrix=matrix,
            fixed=arguments.fix,
            loss=arguments.loss,
        )
        figures = None
        if arguments.plots is not None:
            from jaxlens.figures.fits import curve_figure, residual_figure, uncertainty_figure, views_figure

            assert fit.frame is not None
            assert fit.per_view_rms is not None
            seen = np.asarray(boards.weights) > 0
            observed = np.asarray(boards.observed)[seen]
            figures = {
                "residuals": residual_figure(observed, np.asarray(fit.residuals)[seen], fit, "pixels"),
                "views": views_figure(names, np.asarray(fit.per_view_rms)),
                "uncertainty": uncertainty_figure(fit, observed),
            }
            on_plane = fit.lens.invert(fit.frame.normalize(observed))
            # The curve is drawn over the plane z = 1, which ends at a right angle from the axis.
            if bool(np.all(on_plane.valid)) and float(np.max(np.abs(on_plane.points))) < _WIDEST:
                figures["curve"] = curve_figure(fit, np.asarray(on_plane.points), "pixels")
        deliver(arguments, fit, size, figures, notes=_outliers(found, np.asarray(fit.residuals)))
    return 1 if found.unread else 0


def _check_fixed(arguments: Arguments) -> None:
    """Refuses to hold what the camera does not have, or what nobody has said.

    Raises:
        UsageError: --fix names no parameter, or one that --start does not give.
    """
    from jaxlens.fitting import calibrated_parameters

    known = calibrated_parameters(model_lens(arguments))
    calibration = start_calibration(arguments)
    guessed = () if calibration is not None and calibration.center is not None else ("fx", "fy")
    for name in arguments.fix:
        if name not in known:
            raise UsageError(f"--fix {name}: the parameters are {', '.join(known)}")
        if name in guessed:
            raise UsageError(f"--fix {name} would hold a first guess; pass --start LENS.json, a camera that has it")


def _start_matrix(arguments: Arguments, size: tuple[int, int]) -> "np.ndarray | None":
    """The camera matrix of --start; None if it has none.

    Raises:
        UsageError: the camera is for pictures of another shape.
    """
    calibration = start_calibration(arguments)
    if calibration is None or calibration.center is None:
        return None
    import jax
    import numpy as np

    from jaxlens.calibrations import CalibrationError

    try:
        with jax.enable_x64(True):
            return np.asarray(calibration.frame(size[1], size[0]).camera_matrix())
    except CalibrationError as error:
        raise UsageError(f"--start {str(arguments.start)!r}: {error}") from error


@dataclass(frozen=True)
class _Found:
    """Views of a board.

    Attributes:
        names: Of the views.
        views: Points on the board and where they are seen.
        size: Width and height of the pictures.
        unread: How many pictures could not be read.
    """

    names: list[str]
    views: list
    size: tuple[int, int]
    unread: int = 0


def _from_table(arguments: Arguments) -> _Found:
    """The views of a CSV file, in the order of their numbers."""
    assert arguments.corners is not None
    check_file(arguments.corners)
    if arguments.image_size is None:
        raise UsageError("--corners needs --image-size WIDTHxHEIGHT: a table does not say how large its pictures are")
    size = options.parse_size(arguments.image_size, "--image-size")
    from jaxlens.calibrations import CalibrationError, read_corners

    try:
        names, views = read_corners(arguments.corners)
    except CalibrationError as error:
        raise UsageError(str(error)) from error
    return _Found(names, views, size)


def _from_pictures(arguments: Arguments) -> _Found:
    """The views of pictures in which the board is found."""
    if arguments.board is None:
        raise UsageError("--board COLUMNSxROWS is needed: how many inner corners the board has, such as 9x6")
    if arguments.image_size is not None:
        raise UsageError("--image-size goes with --corners; pictures have a size of their own: leave it out")
    if not 0 < arguments.square < math.inf:
        raise UsageError(f"--square is a length above 0, got {arguments.square}")
    board = options.parse_size(arguments.board, "--board")
    if min(board) < 3:
        raise UsageError(f"--board counts inner corners, three a side at least; got {arguments.board}")
    files = list_files(arguments.files)
    import numpy as np

    columns, rows = np.meshgrid(np.arange(board[0]), np.arange(board[1]))
    on_board = arguments.square * np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)
    names, views, size, first, unread = [], [], None, None, 0
    for path in files:
        try:
            picture = read_picture(path, arguments.max_pixels)
        except CommandError as error:
            say(f"{error}: left out")
            unread += 1
            continue
        here = (picture.pixels.shape[1], picture.pixels.shape[0])
        if size is not None and here != size:
            raise UsageError(
                f"{str(path)!r} is {here[0]} × {here[1]}, and {str(first)!r} {size[0]} × {size[1]}: one "
                "camera takes pictures of one size; calibrate them apart"
            )
        size, first = here, first or path
        corners = _find_corners(picture, board)
        if corners is None:
            say(f"no board of {board[0]} × {board[1]} inner corners in {str(path)!r}: left out")
            continue
        names.append(path.name)
        views.append((on_board, corners))
    if size is None:
        raise CommandError("no picture could be read" if len(files) > 1 else "the picture could not be read")
    if not views:
        raise CommandError(f"none of the {len(files)} pictures shows a board; is --board {arguments.board} right?")
    return _Found(names, views, size, unread)


def _enough(found: _Found) -> _Found:
    """Leaves out, by name, views with too few corners to tell where the board was.

    Raises:
        CommandError: no view has enough.
    """
    kept = []
    for name, view in zip(found.names, found.views, strict=True):
        if len(view[0]) < _FEWEST:
            say(f"view {name!r} has {len(view[0])} corners, and a pose takes {_FEWEST} at least: left out")
        else:
            kept.append((name, view))
    if not kept:
        raise CommandError(f"no view has {_FEWEST} corners or more, which a pose takes")
    names, views = zip(*kept, strict=True)
    return _Found(list(names), list(views), found.size, found.unread)


def _outliers(found: _Found, residuals: "np.ndarray") -> list[str]:
    """Sentences that name the corners which lie far from where the others say, the farthest first."""
    import numpy as np

    lengths = np.concatenate([np.hypot(*residuals[i, : len(view[0])].T) for i, view in enumerate(found.views)])
    places = [(i, corner) for i, view in enumerate(found.views) for corner in range(len(view[0]))]
    far = np.flatnonzero(lengths > _FAR * np.median(lengths))
    if not far.size:
        return []
    notes = [f"{far.size} of {lengths.size} corners lie more than {_FAR} times the median residual off:"]
    for index in far[np.argsort(-lengths[far])][:_NAMED]:
        view, corner = places[index]
        x, y = found.views[view][0][corner]
        notes.append(f"  view {found.names[view]!r}, corner ({x:g}, {y:g}) of the board: {lengths[index]:.3g} px")
    return notes + ([f"  and {far.size - _NAMED} more"] if far.size > _NAMED else [])


def _find_corners(picture: "Picture", board: tuple[int, int]) -> "np.ndarray | None":
    """The inner corners of a chessboard, `(n, 2)`, row by row; None if it is not found."""
    try:
        import cv2
    except ImportError:
        raise UsageError(
            "finding a board takes OpenCV: pip install 'jaxlens[calibrate]'; or find the corners elsewhere, and pass "
            "--corners FILE.csv"
        ) from None
    import numpy as np

    values, _ = gray_values(picture)
    low, high = float(values.min()), float(values.max())
    gray = np.round((values - low) * (255 / max(high - low, 1e-12))).astype(np.uint8)
    found, corners = cv2.findChessboardCorners(
        gray, board, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if found:
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _SMALLEST)
        corners = cv2.cornerSubPix(gray, corners, _WINDOW, (-1, -1), criteria)
    else:
        # Slower, and finds boards that are out of focus or in uneven light.
        found, corners = cv2.findChessboardCornersSB(gray, board)
    return np.asarray(corners, np.float64).reshape(-1, 2) if found else None
