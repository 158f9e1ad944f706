"""What every row works on: one picture, one lens, one size; the same numbers for ours and theirs."""

import numpy as np

SIZE = 1024
CHANNELS = 3
POINTS = 1_000_000
BATCH = 16

# A barrel lens that is one-to-one everywhere, in units of half the diagonal (Eq. 10): x_d = x_u (1 + κ1 r² + κ2 r⁴).
# In the corner it moves a point by 109 pixels.
KAPPA = (-0.2, 0.05)

# The same frame and lens in OpenCV's words.
_FOCAL = float(np.hypot(SIZE / 2, SIZE / 2))
CAMERA_MATRIX = np.array([[_FOCAL, 0, SIZE / 2], [0, _FOCAL, SIZE / 2], [0, 0, 1]])
DISTORTION = np.array([*KAPPA, 0, 0, 0])


def picture(channels: int = CHANNELS) -> np.ndarray:
    """Returns `(SIZE, SIZE, channels)` float32 within [0, 255]: waves of 25 to 100 pixels.

    Smooth on purpose: OpenCV 4, and `cv2.undistort` still, round positions to 1/32 of a pixel, which on such a picture
    costs half a grey level, while a wrong pixel would cost many. How long a warp takes does not depend on the values.
    """
    y, x = np.mgrid[:SIZE, :SIZE]
    waves = np.stack(
        [np.sin(x / (4 + 2 * c) + y / (9 + c)) + np.cos(y / (5 + c) - x / 16) for c in range(channels)], -1
    )
    return (127.5 + 63 * waves).astype(np.float32)


def observed_points() -> tuple[np.ndarray, np.ndarray]:
    """Returns `(POINTS, 2)` float64 ideal points all over the picture's square, and what the lens makes of them."""
    ideal = np.random.default_rng(0).uniform(-0.7, 0.7, (POINTS, 2))
    squared = np.sum(ideal * ideal, -1, keepdims=True)
    return ideal, ideal * (1 + squared * (KAPPA[0] + squared * KAPPA[1]))
