"""`jaxlens calibrate`: a camera from pictures of a chessboard."""

# Optional[X] for the same reason as in `jaxlens.cli.options`.
# ruff: noqa: UP045

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from jaxlens.cli.errors import CommandError, UsageError
from jaxlens.cli.fits import FitArguments, check_fit_arguments, deliver, fitting, model_lens, parse_size
from jaxlens.cli.messages import say
from jaxlens.cli.options import check_file, check_max_pixels
from jaxlens.cli.values import Paths, paths

HELP = """Calibrate a camera: its matrix, its lens and the poses of a board.

What it does:
  Finds the inner corners of a chessboard in the pictures (by OpenCV:
  pip install 'jaxlens[calibrate]'), or reads them from a CSV file with the
  columns view, corner, board_x, board_y, x, y. Pictures in which no board is
  found are named and left out; so are those that cannot be read, and then the
  exit code is 1. --board counts inner corners.

Examples:
  jaxlens calibrate photos/ --board 9x6 --output camera.json
  jaxlens calibrate photos/*.jpg --board 9x6 --square 25 --output camera.json
  jaxlens calibrate --corners corners.csv --image-size 640x480 --plots fit/"""


@dataclass(frozen=True)
class Arguments(FitArguments):
    """Calibrate a camera from pictures of a chessboard."""

    files: Annotated[Paths, Positional, paths("FILE..."), arg(help_behavior_hint="")] = field(default_factory=Paths)
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

    max_pixels: Annotated[Optional[int], arg(metavar="COUNT", help_behavior_hint="(default: 200 million)")] = None
    """Refuse pictures with more pixels, before they are decoded."""


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    check_fit_arguments(arguments)
    check_max_pixels(arguments.max_pixels)
    if bool(arguments.files) == (arguments.corners is not None):
        raise UsageError("pass pictures of the board, with --board, or --corners FILE.csv, with --image-size")
    found = _from_table(arguments) if arguments.corners is not None else _from_pictures(arguments)
    names, views, size = found.names, found.views, found.size
    from jaxlens.fitting import Boards, calibrate

    with fitting():
        boards = Boards.from_views(views)
        fit = calibrate(model_lens(arguments), boards, size, loss=arguments.loss)
        figures = None
        if arguments.plots is not None:
            import numpy as np

            from jaxlens.figures.fits import curve_figure, residual_figure, views_figure

            assert fit.frame is not None
            assert fit.per_view_rms is not None
            seen = np.asarray(boards.weights) > 0
            observed = np.asarray(boards.observed)[seen]
            figures = {
                "residuals": residual_figure(observed, np.asarray(fit.residuals)[seen], fit, "pixels"),
                "views": views_figure(names, np.asarray(fit.per_view_rms)),
                "curve": curve_figure(fit, np.asarray(fit.lens.invert(fit.frame.normalize(observed)).points), "pixels"),
            }
        deliver(arguments, fit, size, figures)
    return 1 if found.unread else 0


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
    size = parse_size(arguments.image_size, "--image-size")
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
    board = parse_size(arguments.board, "--board")
    if min(board) < 3:
        raise UsageError(f"--board counts inner corners, three a side at least; got {arguments.board}")
    from jaxlens.cli.chessboards import board_points, find_corners
    from jaxlens.cli.jobs import list_files

    files = list_files(arguments.files)
    from jaxlens.cli.pictures import read_picture

    names, views, size, first, unread = [], [], None, None, 0
    for path in files:
        try:
            pixels = read_picture(path, arguments.max_pixels).pixels
        except CommandError as error:
            say(f"{error}: left out")
            unread += 1
            continue
        here = (pixels.shape[1], pixels.shape[0])
        if size is not None and here != size:
            raise CommandError(
                f"{str(path)!r} is {here[0]} × {here[1]}, and {str(first)!r} {size[0]} × {size[1]}: one "
                "camera takes pictures of one size; calibrate them apart"
            )
        size, first = here, first or path
        corners = find_corners(pixels, board)
        if corners is None:
            say(f"no board of {board[0]} × {board[1]} inner corners in {str(path)!r}: left out")
            continue
        names.append(path.name)
        views.append((board_points(board, arguments.square), corners))
    if size is None:
        raise CommandError("no picture could be read" if len(files) > 1 else "the picture could not be read")
    if not views:
        raise CommandError(f"none of the {len(files)} pictures shows a board; is --board {arguments.board} right?")
    return _Found(names, views, size, unread)
