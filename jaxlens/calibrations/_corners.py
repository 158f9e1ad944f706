"""Corners of boards in a CSV file: what calibrations are made of."""

import os
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxlens.calibrations._calibration import CalibrationError
from jaxlens.columns import ColumnsError, read_columns

View = tuple[Float[np.ndarray, "corners 2"], Float[np.ndarray, "corners 2"]]


def read_corners(path: str | os.PathLike[str]) -> tuple[list[str], list[View]]:
    """Reads views of a board.

    Args:
        path: A CSV file with the columns view and corner (numbers), board_x and board_y (the board's unit), x and y
            (pixels). A view need not show every corner.

    Returns:
        The views' names, and for each the `(n, 2)` points on the board and in the picture, as
        `jaxlens.fitting.Boards.from_views` takes them.

    Raises:
        CalibrationError: the file cannot be read, a corner is at two places of the board, or twice in a view.
    """
    path = Path(path)
    try:
        columns = read_columns(path, ("view", "corner", "board_x", "board_y", "x", "y"))
    except ColumnsError as error:
        raise CalibrationError(str(error)) from error
    view, corner = np.asarray(columns["view"]), np.asarray(columns["corner"])
    board = np.stack([columns["board_x"], columns["board_y"]], axis=-1)
    seen = np.stack([columns["x"], columns["y"]], axis=-1)
    _check_corners(repr(str(path)), columns[""], view, corner, board)
    numbers = np.unique(view)
    return [f"{one:g}" for one in numbers], [(board[view == one], seen[view == one]) for one in numbers]


def _check_corners(name: str, lines: list[float], view: np.ndarray, corner: np.ndarray, board: np.ndarray) -> None:
    """Refuses a corner that is at two places of the board, or twice in a view."""
    places: dict[float, tuple[int, tuple[float, float]]] = {}
    seen: dict[tuple[float, float], int] = {}
    for index, (one, which) in enumerate(zip(view.tolist(), corner.tolist(), strict=True)):
        here, line = (float(board[index, 0]), float(board[index, 1])), int(lines[index])
        before, place = places.setdefault(which, (line, here))
        if place != here:
            raise CalibrationError(
                f"{name}, line {line}: corner {which:g} is at {here} of the board, and in line {before} at {place}: "
                "the views show boards of different size"
            )
        earlier = seen.setdefault((one, which), line)
        if earlier != line:
            raise CalibrationError(
                f"{name}, line {line}: corner {which:g} of view {one:g} is in line {earlier} already"
            )
