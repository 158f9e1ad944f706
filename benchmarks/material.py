"""What every row works on: one picture, one lens, one size; the same numbers for ours and theirs."""

import jax
import numpy as np

import jaxlens as jl

SIZE = 1024
CHANNELS = 3
POINTS = 1_000_000
BATCH = 16

# A barrel lens that is one-to-one in the picture: OpenCV's k1, k2, p1, p2, k3, the denominator's k4, k5, k6, the thin
# prism's s1 to s4 and the sensor's tilts. Its unit is half the diagonal, Eq. 10's, so that the first two alone are the
# paper's lens. A corner moves by 109 px.
BROWN_CONRADY = np.array([-0.2, 0.05, 1e-3, -5e-4, -0.01, 0.02, -0.01, 0.002, 1e-3, 2e-4, -5e-4, 1e-4, 0.01, -0.02])
_FOCAL = float(np.hypot(SIZE / 2, SIZE / 2))
CAMERA_MATRIX = np.array([[_FOCAL, 0, SIZE / 2], [0, _FOCAL, SIZE / 2], [0, 0, 1]])
# A fisheye of the same focal length, OpenCV's k1 to k4: it sees a corner at 45°.
FISHEYE = np.array([-0.02, 0.003, -0.001, 0.0001])
# Corners move by up to 60 pixels.
HOMOGRAPHY = np.array([[1.05, 0.03, -20.0], [-0.02, 0.97, 15.0], [4e-5, -3e-5, 1.0]])


def picture(channels: int = CHANNELS) -> np.ndarray:
    """Returns `(SIZE, SIZE, channels)` float32 within [0, 255]: waves of 25 to 100 pixels.

    Smooth on purpose: OpenCV 4, and `cv2.undistort` still, round positions to 1/32 of a pixel, which on such a picture
    costs half a gray level, while a wrong pixel would cost many. How long a warp takes does not depend on the values.
    """
    y, x = np.mgrid[:SIZE, :SIZE]
    waves = np.stack(
        [np.sin(x / (4 + 2 * c) + y / (9 + c)) + np.cos(y / (5 + c) - x / 16) for c in range(channels)], -1
    )
    return (127.5 + 63 * waves).astype(np.float32)


def lens(count: int, dtype: jax.typing.DTypeLike = np.float32) -> jl.Lens:
    """Returns the lens of so many coefficients: two are a `RadialPolynomial`, more a `BrownConrady`."""
    coefficients = np.asarray(BROWN_CONRADY[:count], dtype)
    return jl.RadialPolynomial(coefficients) if count == 2 else jl.BrownConrady(coefficients)


def frame() -> jl.Frame:
    """Returns the frame of the pictures' lenses."""
    return jl.Frame.from_camera_matrix(np.asarray(CAMERA_MATRIX, np.float32))


def ideal_points() -> np.ndarray:
    """Returns `(POINTS, 2)` float64 ideal points all over the picture's square."""
    return np.random.default_rng(0).uniform(-0.7, 0.7, (POINTS, 2))


def correspondences(sets: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns `(sets, points, 2)` ideal and observed points of a lens with a centre of its own, noise of 1e-3."""
    random = np.random.default_rng(1)
    ideal = random.uniform(-0.7, 0.7, (sets, points, 2))
    center = np.array([0.02, -0.01])
    squared = np.sum((ideal - center) ** 2, -1, keepdims=True)
    observed = center + (ideal - center) * (1 + squared * (BROWN_CONRADY[0] + squared * BROWN_CONRADY[1]))
    return ideal, observed + 1e-3 * random.normal(size=ideal.shape)


def boards(views: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns `(54, 2)` corners of a board, and `(views, 54, 2)` where a camera sees them, with noise of 0.2 px."""
    random = np.random.default_rng(2)
    board = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2)
    seen = np.empty((views, len(board), 2))
    for view in range(views):
        tilt, turn = random.uniform(-0.5, 0.5, 2)
        x, y = (board - [4.0, 2.5]).T
        # About the board's x axis, then its y axis, then away from the camera.
        y, z = np.cos(tilt) * y, np.sin(tilt) * y
        x, z = np.cos(turn) * x + np.sin(turn) * z, np.cos(turn) * z - np.sin(turn) * x
        left, up, away = random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(10, 14)
        x, y = (x + left) / (z + away), (y + up) / (z + away)
        squared = x * x + y * y
        factor = 1 + squared * (-0.28 + squared * (0.03 + squared * 0.1))
        seen[view] = np.stack([530 * x * factor + 330, 530 * y * factor + 235], -1)
    return board, seen + 0.2 * random.normal(size=seen.shape)


def sphere_cap(size: int) -> tuple[np.ndarray, np.ndarray, tuple[float, float], np.ndarray]:
    """Returns `(size, size)` depth, mask, a pixel (x, y) on it, and the great circles' lengths from there.

    The cap fills the picture, and its slope reaches 2 at the rim.
    """
    middle = (size - 1) / 2
    radius = middle / 0.9
    y, x = np.mgrid[:size, :size] - middle
    mask = x * x + y * y <= middle**2
    depth = np.sqrt(np.where(mask, radius**2 - x * x - y * y, 0))
    column, row = int(0.65 * size), int(0.58 * size)
    points = np.stack([x, y, depth], -1)
    start = points[row, column]
    angle = np.arctan2(np.linalg.norm(np.cross(points, start), axis=-1), points @ start)
    return depth, mask, (float(column), float(row)), radius * angle


def grid_mesh(depth: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns a depth map as vertices `(N, 3)` and triangles `(M, 3)`, and the flat index of each vertex's pixel."""
    height, width = depth.shape
    index = np.arange(height * width).reshape(height, width)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate([np.stack([a, d, b], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    triangles = triangles[np.all(mask.ravel()[triangles], axis=-1)]
    pixels, renumbered = np.unique(triangles, return_inverse=True)
    rows, columns = np.divmod(pixels, width)
    vertices = np.stack([columns, rows, depth.ravel()[pixels]], -1).astype(np.float64)
    return vertices, renumbered.reshape(-1, 3), pixels
