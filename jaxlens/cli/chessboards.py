"""Corners of chessboards in pictures, found by OpenCV."""

import numpy as np
from jaxtyping import Float

from jaxlens.cli.errors import UsageError

# Half the window in which a corner is refined, and when that ends.
_WINDOW = (5, 5)
_STEPS, _SMALLEST = 30, 1e-3


def find_corners(pixels: np.ndarray, board: tuple[int, int]) -> Float[np.ndarray, "corners 2"] | None:
    """Returns the inner corners of a chessboard, row by row; None if it is not found.

    Args:
        pixels: As `jaxlens.images` reads them.
        board: Inner corners in a row, and rows.

    Raises:
        UsageError: OpenCV is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise UsageError(
            "finding a board takes OpenCV: pip install 'jaxlens[calibrate]'; or find the corners elsewhere, and pass "
            "--corners FILE.csv"
        ) from None
    gray = _gray(pixels)
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


def board_points(board: tuple[int, int], square: float) -> Float[np.ndarray, "corners 2"]:
    """Returns the corners' places on the board, row by row, in the unit of `square`."""
    columns, rows = np.meshgrid(np.arange(board[0]), np.arange(board[1]))
    return square * np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)


def _gray(pixels: np.ndarray) -> np.ndarray:
    values = pixels.astype(np.float64)
    if values.ndim == 3:
        # Without alpha.
        values = values[..., : values.shape[2] - (values.shape[2] in (2, 4))].mean(axis=-1)
    low, high = float(values.min()), float(values.max())
    return np.round((values - low) * (255 / max(high - low, 1e-12))).astype(np.uint8)
