"""Views: the new camera beside OpenCV's, and what `keep`, `fov` and the projections promise."""

import pathlib

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.calibrations import Calibration, CalibrationError

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

BOARDS = pathlib.Path(__file__).parents[2].parent / "shared" / "data" / "opencv"


def slow(one):
    """A case beside one that everybody runs: compiling it takes seconds."""
    return pytest.param(one, marks=pytest.mark.slow)


PROJECTIONS = ["perspective", "cylindrical", "equirectangular", "stereographic"]
BROWN = [-0.28, 0.07, 0.001, -0.002, 0.01]


def camera():
    return jl.Camera(jl.RadialPolynomial([-0.28, 0.07]), jl.Frame([30.3, 24.1], [52.0, 53.0]), 64, 48)


def fisheye(scale=20.0):
    return jl.Camera(jl.KannalaBrandt([0.05, -0.01]), jl.Frame([31.0, 24.5], scale), 64, 48)


@pytest.fixture(scope="module")
def calibrated():
    """A camera by OpenCV from one of its own chessboards, and the picture."""
    path = BOARDS / "left01.jpg"
    if not path.exists():
        pytest.skip("the chessboards of OpenCV are not beside the repository")
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = np.mgrid[:9, :6].T.reshape(-1, 2)
    corners = []
    for name in ("left01", "left02"):
        gray = cv2.imread(str(path.with_name(f"{name}.jpg")), cv2.IMREAD_GRAYSCALE)
        found, here = cv2.findChessboardCorners(gray, (9, 6))
        assert found
        corners.append(cv2.cornerSubPix(gray, here, (5, 5), (-1, -1), (3, 30, 1e-3)))
    size = gray.shape[::-1]
    _, matrix, numbers, _, _ = cv2.calibrateCamera([board] * 2, corners, size, None, None, flags=cv2.CALIB_FIX_K3)
    return matrix, numbers.ravel(), cv2.imread(str(path))


@pytest.mark.parametrize(("keep", "alpha"), [("valid", 0), ("all", 1)])
def test_the_new_camera_is_that_of_opencv(x64, calibrated, keep, alpha):
    matrix, numbers, picture = calibrated
    height, width = picture.shape[:2]
    one = jl.Camera(jl.BrownConrady(numbers), jl.Frame.from_camera_matrix(matrix), width, height)
    for size in ((width, height), (800, 500)):
        view = one.view(keep=keep, size=size)
        expected, _ = cv2.getOptimalNewCameraMatrix(matrix, numbers, (width, height), alpha, size)
        # OpenCV undistorts its nine points a side by five steps: exact ones give its matrix exactly.
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9)), axis=-1)
        points = cv2.undistortPoints(grid.reshape(-1, 1, 2), matrix, numbers, criteria=(3, 100, 1e-15)).reshape(9, 9, 2)
        (x, y), largest, least = np.moveaxis(points, -1, 0), *((np.max, np.min) if alpha == 0 else (np.min, np.max))
        sides = (x[:, 0], y[0]), (x[:, -1], y[-1])
        if alpha == 1:
            sides = (x, y), (x, y)
        first, last = np.array([largest(a) for a in sides[0]]), np.array([least(a) for a in sides[1]])
        scale = (np.array(size) - 1) / (last - first)
        np.testing.assert_allclose(view.frame.scale, scale, rtol=1e-9)
        np.testing.assert_allclose(view.frame.center, -scale * first, rtol=1e-9)
        np.testing.assert_allclose(view.frame.camera_matrix(), expected, rtol=2e-4, atol=0)
    ours = np.asarray(jl.reproject(picture, one, view)).astype(int)
    new = np.asarray(view.frame.camera_matrix())
    maps = cv2.initUndistortRectifyMap(matrix, numbers, None, new, size, cv2.CV_32FC1)
    theirs = cv2.remap(picture, *maps, cv2.INTER_LINEAR).astype(int)
    # `remap` of 8 bits rounds positions to 1/32 of a pixel.
    assert np.abs(ours - theirs).max() <= 1 + 255 / 32
    assert (np.abs(ours - theirs) <= 1).mean() > 0.98


@pytest.mark.parametrize("projection", ["equirectangular", *map(slow, (*PROJECTIONS[:2], PROJECTIONS[3]))])
def test_valid_shows_nothing_that_was_not_seen(projection):
    ones = np.ones((48, 64), np.float32)
    for one in (camera(), fisheye(), fisheye(12.0), fisheye(40.0)):
        if projection == "perspective" and float(one.frame.scale[0]) == 12:
            continue  # without end
        view = one.view(keep="valid", projection=projection)
        assert float(jl.reproject(ones, one, view).min()) > 0.99 - 1e-2
        # And it reaches to where the picture ends.
        wider = jl.Camera(view.lens, view.frame.zoomed(0.95), 64, 48)
        assert float(jl.reproject(ones, one, wider).min()) < 0.9


@pytest.mark.parametrize("projection", ["equirectangular", *map(slow, (*PROJECTIONS[:2], PROJECTIONS[3]))])
def test_all_shows_all_that_was_seen(x64, projection):
    for one in (camera(), fisheye()) if projection != "perspective" else (camera(), fisheye(40.0)):
        view = one.view(keep="all", projection=projection)
        pixels = np.stack(np.meshgrid(np.linspace(0, 63, 17), np.linspace(0, 47, 17)), axis=-1)
        seen = jnp.isfinite(one.unproject(pixels)[..., 0])
        assert bool(jnp.isfinite(one.transfer(pixels, view)[..., 0])[seen].all())


@pytest.mark.parametrize(("projection", "fov"), [*zip(PROJECTIONS, (100.0, 200.0, 360.0, 300.0), strict=True)])
def test_the_field_is_from_edge_to_edge(x64, projection, fov):
    view = camera().view(fov=fov, size=(200, 100), projection=projection)
    assert (view.width, view.height) == (200, 100)
    edge = view.unproject(np.array([[-0.5 + 1e-9, 49.5], [199.5 - 1e-9, 49.5], [99.5, 49.5]]))
    angle = np.degrees(np.arctan2(edge[:, 0], edge[:, 2]))
    np.testing.assert_allclose(angle, [-fov / 2, fov / 2, 0], atol=1e-6)
    assert float(view.frame.scale[0]) == float(view.frame.scale[1])


def test_same_keeps_the_frame(x64):
    view = camera().view()
    assert view.frame.center.tolist() == camera().frame.center.tolist()
    assert isinstance(view.lens, jl.Perspective)
    double = camera().view(size=(128, 96))
    np.testing.assert_allclose(double.frame.scale, 2 * camera().frame.scale)
    np.testing.assert_allclose(double.frame.center, 2 * camera().frame.center + 0.5)


@pytest.mark.slow
def test_a_view_is_differentiated(x64):
    def zoom(numbers):
        one = jl.Camera(jl.RadialPolynomial(numbers), camera().frame, 64, 48)
        return one.view(keep="all").frame.scale[0]

    numbers, step = jnp.asarray([-0.28, 0.07]), 1e-6
    slope = jax.grad(zoom)(numbers)
    change = step * jnp.eye(2)[0]
    np.testing.assert_allclose(slope[0], (zoom(numbers + change) - zoom(numbers - change)) / (2 * step), rtol=1e-6)


def test_misuse(untyped):
    with pytest.raises(ValueError, match=r"past 90° .* projection='equirectangular'.* fov=120"):
        fisheye().view(keep="all")
    with pytest.raises(ValueError, match=r"straight above or below.* 'stereographic'"):
        fisheye(12.0).view(keep="all", projection="cylindrical")
    with pytest.raises(ValueError, match=r"has no end; choose a field"):
        fisheye(12.0).view(keep="valid")
    with pytest.raises(ValueError, match="two ways to choose a view"):
        camera().view(keep="all", fov=90.0)
    with pytest.raises(ValueError, match="below 180 degrees; projection='equirectangular'"):
        camera().view(fov=180.0)
    with pytest.raises(ValueError, match="above 0 and at most 360"):
        camera().view(fov=361.0, projection="cylindrical")
    with pytest.raises(ValueError, match="keep='crop' is none of same, valid, all"):
        camera().view(keep="crop")
    with pytest.raises(ValueError, match="projection='flat' is none of"):
        camera().view(projection="flat")
    with pytest.raises(ValueError, match="height of pictures is at least one pixel, got 0"):
        camera().view(size=(5, 0))


def test_the_camera_of_a_calibration(x64):
    known = Calibration.from_lens(jl.BrownConrady(BROWN), frame=camera().frame, image_size=(64, 48))
    one = known.camera()
    assert (one.width, one.height) == (64, 48)
    assert one.lens.coefficients.tolist() == BROWN
    half = known.camera(24, 32)
    np.testing.assert_allclose(half.frame.scale, camera().frame.scale / 2)
    with pytest.raises(CalibrationError, match=r"give their size, camera\(height, width\)"):
        Calibration.from_lens(jl.BrownConrady(BROWN), frame=camera().frame).camera()
