"""The peers, each called as its own documentation would: inputs ready in its own arrays, its own number of threads.

Every function returns a `Peer`, or None where the package is not installed. Each call allocates its own result, as a
call of ours does.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import jax
import numpy as np

from benchmarks.material import BROWN_CONRADY, CAMERA_MATRIX, FISHEYE, SIZE, grid_mesh


@dataclass(frozen=True)
class Peer:
    """One contender of another library.

    Attributes:
        run: Does the work, and returns when it is done.
        read: Turns what `run` returned into an array laid out as ours.
        device: Where it runs.
    """

    run: Callable[[], Any]
    read: Callable[[Any], np.ndarray] = np.asarray
    device: str = "CPU"


def load(package: str) -> Any:
    """Returns a module, or None where it is not installed."""
    try:
        return import_module(package)
    except ImportError:
        return None


def own_work(start: Callable[[], Any]) -> Peer:
    """Other work of our own, for rows that compare us with ourselves."""
    return Peer(lambda: jax.block_until_ready(start()), device=jax.default_backend().upper())


def opencv_remap(image: np.ndarray, coordinates: np.ndarray, interpolation: str = "INTER_LINEAR") -> Peer | None:
    """`cv2.remap` with a ready map of two float32 planes."""
    if (cv2 := load("cv2")) is None:
        return None
    x, y = np.ascontiguousarray(coordinates[..., 0]), np.ascontiguousarray(coordinates[..., 1])
    mode = getattr(cv2, interpolation)
    return Peer(lambda: cv2.remap(image, x, y, mode))


def _coefficients(count: int) -> np.ndarray:
    """The lens's, as OpenCV wants them: at least five."""
    return np.pad(BROWN_CONRADY[:count], (0, max(0, 5 - count)))


def opencv_distort_map(size: int, count: int) -> Peer | None:
    """`cv2.initInverseRectificationMap`, OpenCV's only way to distort an image."""
    if (cv2 := load("cv2")) is None:
        return None
    return Peer(
        lambda: cv2.initInverseRectificationMap(
            CAMERA_MATRIX, _coefficients(count), None, CAMERA_MATRIX, (size, size), cv2.CV_32FC1
        ),
        read=lambda planes: np.stack(planes, -1),
    )


def opencv_distort(image: np.ndarray, count: int) -> Peer | None:
    """`cv2.initInverseRectificationMap`, then `cv2.remap`."""
    if (cv2 := load("cv2")) is None or (source := opencv_distort_map(len(image), count)) is None:
        return None
    return Peer(lambda: cv2.remap(image, *source.run(), cv2.INTER_LINEAR))


def opencv_undistort(image: np.ndarray, count: int) -> Peer | None:
    """`cv2.undistort`."""
    if (cv2 := load("cv2")) is None:
        return None
    coefficients = _coefficients(count)
    return Peer(lambda: cv2.undistort(image, CAMERA_MATRIX, coefficients))


def opencv_undistort_map(count: int, size: tuple[int, int] = (SIZE, SIZE)) -> Peer | None:
    """`cv2.initUndistortRectifyMap`."""
    if (cv2 := load("cv2")) is None:
        return None
    return Peer(
        lambda: cv2.initUndistortRectifyMap(
            CAMERA_MATRIX, _coefficients(count), None, CAMERA_MATRIX, size, cv2.CV_32FC1
        ),
        read=lambda planes: np.stack(planes, -1),
    )


def opencv_undistort_by_map(image: np.ndarray, count: int) -> Peer | None:
    """`cv2.initUndistortRectifyMap`, then `cv2.remap`: OpenCV's fastest way."""
    if (cv2 := load("cv2")) is None or (source := opencv_undistort_map(count, image.shape[1::-1])) is None:
        return None
    return Peer(lambda: cv2.remap(image, *source.run(), cv2.INTER_LINEAR))


def opencv_undistort_loop(images: np.ndarray, kappas: np.ndarray) -> Peer | None:
    """`cv2.initUndistortRectifyMap` and `cv2.remap`, one picture with its own lens after another."""
    if (cv2 := load("cv2")) is None:
        return None
    height, width = images.shape[1:3]
    focal = float(np.hypot(height / 2, width / 2))
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])

    def run() -> list[np.ndarray]:
        maps = (
            cv2.initUndistortRectifyMap(matrix, np.array([*k, 0, 0]), None, matrix, (width, height), cv2.CV_32FC1)
            for k in kappas
        )
        return [cv2.remap(image, *planes, cv2.INTER_LINEAR) for image, planes in zip(images, maps, strict=True)]

    return Peer(run)


def opencv_warp_perspective(image: np.ndarray, matrix: np.ndarray) -> Peer | None:
    """`cv2.warpPerspective` by the map from output to source."""
    if (cv2 := load("cv2")) is None:
        return None
    return Peer(
        lambda: cv2.warpPerspective(image, matrix, image.shape[1::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    )


def opencv_undistort_points(points: np.ndarray, count: int, tolerance: float | None = None) -> Peer | None:
    """`cv2.undistortPoints`: at its default of five fixed-point steps, or iterated until it moves less than this."""
    if (cv2 := load("cv2")) is None:
        return None
    points, identity, coefficients = points[:, None], np.eye(3), _coefficients(count)
    if tolerance is None:
        run = lambda: cv2.undistortPoints(points, identity, coefficients)  # noqa: E731
    else:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, tolerance)
        run = lambda: cv2.undistortPoints(points, identity, coefficients, criteria=criteria)  # noqa: E731
    return Peer(run, read=lambda found: found[:, 0])


def opencv_fisheye(image: np.ndarray) -> Peer | None:
    """`cv2.fisheye.initUndistortRectifyMap`, then `cv2.remap`."""
    if (cv2 := load("cv2")) is None:
        return None
    eye, size = np.eye(3), image.shape[1::-1]

    def run() -> np.ndarray:
        planes = cv2.fisheye.initUndistortRectifyMap(CAMERA_MATRIX, FISHEYE, eye, CAMERA_MATRIX, size, cv2.CV_32FC1)
        return cv2.remap(image, *planes, cv2.INTER_LINEAR)

    return Peer(run)


def opencv_fisheye_points(points: np.ndarray) -> Peer | None:
    """`cv2.fisheye.undistortPoints`, at its default of ten Newton steps."""
    if (cv2 := load("cv2")) is None:
        return None
    points, identity = points[:, None], np.eye(3)
    return Peer(lambda: cv2.fisheye.undistortPoints(points, identity, FISHEYE), read=lambda found: found[:, 0])


def torch_grid_sample(image: np.ndarray, coordinates: np.ndarray) -> Peer | None:
    """`torch.nn.functional.grid_sample` with a ready map; channels first, as PyTorch keeps images."""
    if (torch := load("torch")) is None:
        return None
    height, width = image.shape[:2]
    device = _torch_device(torch)
    tensor = torch.from_numpy(image).permute(2, 0, 1)[None].contiguous().to(device)
    # With align_corners=True −1 and 1 are the centres of the first and the last pixel.
    scale = 2 / np.array([width - 1, height - 1])
    grid = torch.from_numpy((coordinates * scale - 1).astype(np.float32))[None].to(device)
    run = lambda: torch.nn.functional.grid_sample(tensor, grid, align_corners=True)  # noqa: E731
    return _torch_peer(torch, run, device)


def kornia_undistort(image: np.ndarray, count: int) -> Peer | None:
    """`kornia.geometry.calibration.undistort_image`, lens to picture."""
    torch = load("torch")
    if torch is None or (calibration := load("kornia.geometry.calibration")) is None:
        return None
    device = _torch_device(torch)
    tensor = torch.from_numpy(image).permute(2, 0, 1)[None].contiguous().to(device)
    camera_matrix, distortion = (
        torch.from_numpy(values.astype(np.float32))[None].to(device) for values in (CAMERA_MATRIX, _coefficients(count))
    )
    return _torch_peer(torch, lambda: calibration.undistort_image(tensor, camera_matrix, distortion), device)


def skimage_ssim(reference: np.ndarray, image: np.ndarray, *, gaussian: bool) -> Peer | None:
    """`structural_similarity` of colour images: with the Gaussian window of the SSIM paper, or at its own default."""
    if (metrics := load("skimage.metrics")) is None:
        return None
    # The three settings with which scikit-image's documentation matches the paper.
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False} if gaussian else {}
    return Peer(
        lambda: metrics.structural_similarity(reference, image, data_range=255.0, channel_axis=-1, **options),
    )


def _torch_device(torch: Any) -> str:
    return "cuda" if jax.default_backend() == "gpu" and torch.cuda.is_available() else "cpu"


def _torch_peer(torch: Any, start: Callable[[], Any], device: str) -> Peer:
    def run() -> Any:
        with torch.inference_mode():
            tensor = start()
        if device == "cuda":
            torch.cuda.synchronize()
        return tensor

    return Peer(run, read=lambda tensor: tensor[0].permute(1, 2, 0).cpu().numpy(), device=device.upper())


def scipy_fit(ideal: np.ndarray, observed: np.ndarray) -> Peer | None:
    """`scipy.optimize.least_squares(method="lm")` for each set of points: three coefficients and the centre."""
    if (optimize := load("scipy.optimize")) is None:
        return None

    def residuals(values: np.ndarray, ideal: np.ndarray, observed: np.ndarray) -> np.ndarray:
        offset = ideal - values[3:]
        squared = np.sum(offset * offset, -1, keepdims=True)
        factor = 1 + squared * (values[0] + squared * (values[1] + squared * values[2]))
        return (values[3:] + offset * factor - observed).ravel()

    def jacobian(values: np.ndarray, ideal: np.ndarray, observed: np.ndarray) -> np.ndarray:
        offset = ideal - values[3:]
        squared = np.sum(offset * offset, -1, keepdims=True)
        factor = 1 + squared * (values[0] + squared * (values[1] + squared * values[2]))
        slope = values[0] + squared * (2 * values[1] + squared * 3 * values[2])
        columns = np.empty((len(ideal), 2, 5))
        for power in range(3):
            columns[:, :, power] = offset * squared ** (power + 1)
        for axis in range(2):
            columns[:, :, 3 + axis] = -2 * offset * slope * offset[:, axis : axis + 1]
            columns[:, axis, 3 + axis] += 1 - factor[:, 0]
        return columns.reshape(-1, 5)

    def run() -> list[np.ndarray]:
        start = np.zeros(5)
        return [
            optimize.least_squares(residuals, start, jacobian, args=pair, method="lm").x
            for pair in zip(ideal, observed, strict=True)
        ]

    return Peer(run)


def opencv_calibrate(board: np.ndarray, corners: np.ndarray, size: tuple[int, int]) -> Peer | None:
    """`cv2.calibrateCamera` with its five coefficients; the result is its RMS."""
    if (cv2 := load("cv2")) is None:
        return None
    points = np.column_stack([board, np.zeros(len(board))]).astype(np.float32)
    seen = [view[:, None].astype(np.float32) for view in corners]
    return Peer(lambda: cv2.calibrateCamera([points] * len(seen), seen, size, None, None)[0])


def potpourri3d_distance(depth: np.ndarray, mask: np.ndarray, source: tuple[float, float]) -> Peer | None:
    """`MeshHeatMethodDistanceSolver` on the triangulated depth map: factorized, then solved from the nearest vertex."""
    return _potpourri3d(depth, mask, source, ready=False)


def potpourri3d_solve(depth: np.ndarray, mask: np.ndarray, source: tuple[float, float]) -> Peer | None:
    """The same with its factorization ready."""
    return _potpourri3d(depth, mask, source, ready=True)


def _potpourri3d(depth: np.ndarray, mask: np.ndarray, source: tuple[float, float], *, ready: bool) -> Peer | None:
    if (potpourri3d := load("potpourri3d")) is None:
        return None
    vertices, faces, pixels = grid_mesh(depth, mask)
    start = int(np.argmin(np.sum((vertices[:, :2] - source) ** 2, -1)))
    solver = potpourri3d.MeshHeatMethodDistanceSolver(vertices, faces) if ready else None

    def run() -> np.ndarray:
        prepared = potpourri3d.MeshHeatMethodDistanceSolver(vertices, faces) if solver is None else solver
        return prepared.compute_distance(start)

    def read(distance: np.ndarray) -> np.ndarray:
        picture = np.full(depth.shape, np.nan)
        picture.reshape(-1)[pixels] = distance
        return picture

    return Peer(run, read)
