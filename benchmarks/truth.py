"""References in float64 NumPy, written for clarity and not for speed: both contenders are measured against them."""

import numpy as np

from benchmarks.material import BROWN_CONRADY, CAMERA_MATRIX, FISHEYE, HOMOGRAPHY, SIZE

_FIXED_POINT_STEPS = 60
# Pixels from the edge within which contenders may differ, as they treat what lies outside in their own ways.
_MARGIN = 3.0


def distorted_from(count: int) -> np.ndarray:
    """Returns `(SIZE, SIZE, 2)`: where each pixel of a distorted picture comes from, the exact inverse of the lens."""
    observed = pixel_grid()
    ideal = observed
    # The displacement of so mild a lens changes by less than half a pixel a pixel: each step halves the error.
    for _ in range(_FIXED_POINT_STEPS):
        ideal = ideal + (observed - undistorted_from(count, ideal))
    return ideal


def undistorted_from(count: int, pixels: np.ndarray | None = None) -> np.ndarray:
    """Returns where each pixel of an undistorted picture comes from: where the lens takes ideal pixels `(…, 2)`."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(BROWN_CONRADY[:count], (0, 8 - count))
    pixels = pixel_grid() if pixels is None else pixels
    x, y = np.moveaxis((pixels - CAMERA_MATRIX[:2, 2]) / CAMERA_MATRIX[0, 0], -1, 0)
    s = x * x + y * y
    factor = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    across = x * factor + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    down = y * factor + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    return _pixels(np.stack([across, down], -1))


def fisheye(pixels: np.ndarray) -> np.ndarray:
    """Returns where the fisheye sees what a perspective camera of the same focal length sees at pixels `(…, 2)`."""
    ideal = (pixels - CAMERA_MATRIX[:2, 2]) / CAMERA_MATRIX[0, 0]
    radius = np.hypot(ideal[..., :1], ideal[..., 1:])
    angle = np.arctan(radius)
    s = angle * angle
    observed = angle * (1 + s * (FISHEYE[0] + s * (FISHEYE[1] + s * (FISHEYE[2] + s * FISHEYE[3]))))
    scale = np.where(radius > 0, observed / np.where(radius > 0, radius, 1), 1)
    return _pixels(ideal * scale)


def homography(pixels: np.ndarray) -> np.ndarray:
    """Returns where the homography takes pixels `(…, 2)`."""
    image = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], -1) @ HOMOGRAPHY.T
    return image[..., :2] / image[..., 2:]


def pixel_grid() -> np.ndarray:
    """Returns `(SIZE, SIZE, 2)`: the coordinates of every pixel, (x, y) order."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float64)
    return np.stack([x, y], -1)


def interior(coordinates: np.ndarray) -> np.ndarray:
    """Returns which coordinates lie well inside the picture."""
    return np.all((coordinates >= _MARGIN) & (coordinates <= SIZE - 1 - _MARGIN), -1)


def bilinear(image: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
    """Samples at interior coordinates `(N, 2)`."""
    return _separable(image, coordinates, 2, lambda t: 1 - t)


def bicubic(image: np.ndarray, coordinates: np.ndarray, a: float = -0.75) -> np.ndarray:
    """Samples at interior coordinates `(N, 2)` with Keys's kernel; a = −0.75 is OpenCV's."""

    def kernel(t: np.ndarray) -> np.ndarray:
        near = ((a + 2) * t - (a + 3)) * t * t + 1
        return np.where(t <= 1, near, a * (((t - 5) * t + 8) * t - 4))

    return _separable(image, coordinates, 4, kernel)


def _separable(image, coordinates, taps, kernel) -> np.ndarray:
    whole = np.floor(coordinates).astype(int)
    total = np.zeros((*coordinates.shape[:-1], *image.shape[2:]))
    offsets = range(1 - taps // 2, 1 + taps // 2)
    for row in offsets:
        for column in offsets:
            at = whole + np.array([column, row])
            weight = np.prod(kernel(np.abs(coordinates - at)), -1)
            total += weight.reshape(weight.shape + (1,) * (total.ndim - weight.ndim)) * image[at[..., 1], at[..., 0]]
    return total


def _pixels(points: np.ndarray) -> np.ndarray:
    return points * CAMERA_MATRIX[0, 0] + CAMERA_MATRIX[:2, 2]
