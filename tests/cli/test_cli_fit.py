"""`jaxlens fit` and `jaxlens calibrate`: files in, a summary, a calibration and pictures out."""

import sys
from typing import get_args

import jax
import numpy as np
import pytest
from pictures import files_in

import jaxlens as jl
from jaxlens import images
from jaxlens.calibrations import Calibration, read_calibration, write_calibration
from jaxlens.cli import estimation
from jaxlens.fitting import _robust
from jaxlens.images import Picture

SIZE = (160, 120)


def _table(path, header, columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


@pytest.fixture
def frame():
    return jl.Frame.half_diagonal(SIZE[1], SIZE[0])


@pytest.fixture
def lens():
    return jl.RadialPolynomial([-0.2, 0.05])


@pytest.fixture
def points(tmp_path, frame, lens):
    random = np.random.default_rng(0)
    ideal = random.uniform([0, 0], [159, 119], (80, 2))
    observed = np.asarray(frame.denormalize(lens.distort(frame.normalize(ideal))))
    observed = observed + 0.1 * random.normal(size=ideal.shape)
    return _table(tmp_path / "points.csv", "ideal_x,ideal_y,observed_x,observed_y", [ideal, observed])


def test_points(run, points, tmp_path, x64):
    output, plots = tmp_path / "lens.json", tmp_path / "plots"
    result = run("fit", "points", points, "--image-size", "160x120", "--output", output, "--plots", plots)
    assert result.code == 0
    assert "kappa1" in result.out
    assert files_in(plots) == ["curve.png", "residuals.png"]
    calibration = read_calibration(output)
    table = np.loadtxt(points, delimiter=",", skiprows=1)
    frame = jl.Frame.half_diagonal(SIZE[1], SIZE[0])
    fit = jl.fitting.fit_points(
        jl.RadialPolynomial([0.0, 0.0]), frame.normalize(table[:, :2]), table[:, 2:], frame=frame
    )
    np.testing.assert_allclose(calibration.estimate.values, fit.values, rtol=1e-12)
    np.testing.assert_allclose(calibration.estimate.covariance, fit.covariance, rtol=1e-6)
    assert calibration.image_size == SIZE
    assert run("fit", "points", points, "--output", output).code == 2, "a file is not overwritten unasked"


def test_the_lens_is_for_distort_and_undistort(run, points, tmp_path, x64):
    output, picture = tmp_path / "lens.json", tmp_path / "picture.png"
    assert run("fit", "points", points, "--image-size", "160x120", "--output", output).code == 0
    pixels = np.random.default_rng(3).integers(0, 256, (120, 160)).astype(np.uint8)
    images.write(picture, Picture(pixels))
    assert run("undistort", picture, "--lens", output, "--output", tmp_path / "a.png").code == 0
    calibration = read_calibration(output)
    with jax.enable_x64(False):
        expected = jl.undistort_image(pixels, calibration.lens(), frame=calibration.frame(120, 160))
    written = images.read(tmp_path / "a.png").pixels
    assert np.abs(written.astype(int) - np.asarray(expected).astype(int)).max() <= 1
    wrong = tmp_path / "wrong.png"
    images.write(wrong, Picture(np.zeros((50, 160), np.uint8)))
    result = run("undistort", wrong, "--lens", output, "--output", tmp_path / "b.png")
    assert (result.code, "another shape" in result.err) == (1, True)
    both = run("undistort", picture, "--lens", output, "--kappa", "0.1", "--output", tmp_path / "b.png")
    assert (both.code, "are two lenses; leave one of them out" in both.err) == (2, True)
    neither = run("undistort", picture, "--output", tmp_path / "b.png")
    assert (neither.code, "a lens is needed: pass --kappa" in neither.err) == (2, True)


def test_lines(run, tmp_path, frame, lens):
    random, rows = np.random.default_rng(1), []
    for index in range(8):
        angle, offset = random.uniform(0, np.pi), random.uniform(-40, 40)
        along = np.linspace(-45, 45, 15)[:, None]
        ideal = [80, 60] + along * [np.cos(angle), np.sin(angle)] + offset * np.array([-np.sin(angle), np.cos(angle)])
        seen = np.asarray(frame.denormalize(lens.distort(frame.normalize(ideal))))
        rows += [(index, *point) for point in seen + 0.01 * random.normal(size=ideal.shape)]
    table = _table(tmp_path / "lines.csv", "line,x,y", [np.array(rows)])
    output = tmp_path / "lens.json"
    result = run("fit", "lines", table, "--image-size", "160x120", "--output", output, "--plots", tmp_path / "plots")
    assert result.code == 0
    estimate = read_calibration(output).estimate
    errors = np.sqrt(np.diag(estimate.covariance))
    assert np.all(np.abs(np.array(estimate.values) - [-0.2, 0.05]) < 4 * errors)
    assert files_in(tmp_path / "plots") == ["curve.png", "lines.png"]


def test_images(run, tmp_path):
    noise = jax.random.uniform(jax.random.key(0), (8, 10))
    source = np.asarray(255 * jax.image.resize(noise, (48, 64), "linear")).clip(0, 255).astype(np.uint8)
    distorted = np.asarray(jl.distort_image(source, jl.Division(0.3)))
    for name, pixels in (("a.png", source), ("b.png", distorted)):
        images.write(tmp_path / name, Picture(pixels))
    output, plots = tmp_path / "lens.json", tmp_path / "plots"
    words = ("--model", "division", "--output", output, "--plots", plots)
    result = run("fit", "images", tmp_path / "a.png", tmp_path / "b.png", *words)
    assert result.code == 0
    assert dict(read_calibration(output).parameters)["k"] == pytest.approx(0.3, abs=2e-3)
    assert files_in(plots) == ["curve.png", "pictures.png"]
    images.write(tmp_path / "c.png", Picture(distorted[:40]))
    result = run("fit", "images", tmp_path / "a.png", tmp_path / "c.png")
    assert (result.code, "resize one of them" in result.err) == (2, True)


def _views(count, *, tilted=True):
    """Corners of a board before a camera, noise included, as rows of a table."""
    random = np.random.default_rng(4)
    board = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), -1).reshape(-1, 2)
    with jax.enable_x64(True):
        rotations = random.uniform(-0.5, 0.5, (count, 3)) if tilted else np.zeros((count, 3))
        places = np.column_stack([random.uniform(-3.5, -1.5, (count, 2)), random.uniform(6, 9, count)])
        ideal = jl.fitting.Poses(rotations, places).project(np.broadcast_to(board, (count, *board.shape)))
        camera = jl.Frame([80.0, 60.0], 130.0)
        seen = np.asarray(camera.denormalize(jl.BrownConrady([-0.2, 0.05, 0.0, 0.0]).distort(ideal)))
    seen = seen + 0.05 * random.normal(size=seen.shape)
    return np.concatenate(
        [
            np.column_stack([np.full(len(board), view), np.arange(len(board)), board, seen[view]])
            for view in range(count)
        ]
    )


HEADER = "view,corner,board_x,board_y,x,y"


@pytest.mark.parametrize("start", [("-0.19", "0.04"), ("-0.19,0.04",)])
def test_a_fit_starts_where_it_is_told(run, points, tmp_path, x64, start, monkeypatch):
    started = []
    for name in ("fit_points", "fit_lines", "fit_images"):
        monkeypatch.setattr(jl.fitting, name, lambda lens, *_, **options: started.append((lens, options)) or 1 / 0)
    images.write(tmp_path / "a.png", Picture(np.zeros((50, 60), np.uint8)))
    lines = _table(tmp_path / "lines.csv", "line,x,y", [np.zeros(5), np.arange(5.0), np.arange(5.0)])
    for words in (("points", points), ("lines", lines), ("images", tmp_path / "a.png", tmp_path / "a.png")):
        size = () if words[0] == "images" else ("--image-size", "160x120")
        run("fit", *words, *size, "--terms", "3", "--start", *start)
        lens, options = started.pop()
        np.testing.assert_array_equal(lens.coefficients, [-0.19, 0.04, 0.0])
        assert options.get("search", False) is False
        run("fit", *words, *size)
        lens, options = started.pop()
        np.testing.assert_array_equal(lens.coefficients, [0.0, 0.0])
        assert options.get("search", True) is True
    refused = run("fit", "lines", lines, "--model", "division", "--start", "0.1", "0.2")
    assert (refused.code, "--start has 2 coefficients, and the division lens 1" in refused.err) == (2, True)


def test_calibrate_from_corners(run, tmp_path):
    table = _table(tmp_path / "corners.csv", HEADER, [_views(8)])
    output, plots = tmp_path / "camera.json", tmp_path / "plots"
    words = ("--corners", table, "--image-size", "160x120", "--terms", "4")
    result = run("calibrate", *words, "--output", output, "--plots", plots)
    assert result.code == 0
    estimate = read_calibration(output).estimate
    truth = [130, 130, 80, 60, -0.2, 0.05, 0, 0]
    scaled = (np.array(estimate.values) - truth) / np.sqrt(np.diag(estimate.covariance))
    assert np.abs(scaled).max() < 4
    assert files_in(plots) == ["curve.png", "residuals.png", "uncertainty.png", "views.png"]
    assert "a ray's place in the picture is known to" in result.out
    assert "median residual" not in result.out


def test_calibrate_from_a_camera_with_parameters_held(run, tmp_path):
    """A board that is partly seen, a view of three corners, a corner that is wrong: the same camera, and all named."""
    rows = _views(8)
    rows = np.delete(rows, [0, 1, 2, 40], axis=0)
    few = (rows[:, 0] == 5) & (rows[:, 1] > 2)
    rows = rows[~few]
    wrong = np.flatnonzero((rows[:, 0] == 7) & (rows[:, 1] == 8))[0]
    rows[wrong, 4:] += [3.0, -4.0]
    table = _table(tmp_path / "corners.csv", HEADER, [rows])
    held = {"cx": 80.5, "cy": 59.0, "k2": 0.04}
    start = Calibration.from_lens(
        jl.BrownConrady([-0.19, held["k2"], 0.0, 0.0]),
        frame=jl.Frame([held["cx"], held["cy"]], [128.0, 128.0]),
        image_size=SIZE,
    )
    write_calibration(tmp_path / "start.json", start)
    output = tmp_path / "camera.json"
    words = ("--corners", table, "--image-size", "160x120", "--start", tmp_path / "start.json", "--loss", "huber")
    result = run("calibrate", *words, "--fix", *held, "--output", output)
    assert result.code == 0, result.err
    assert "view '5' has 3 corners, and a pose takes 4 at least: left out" in result.err
    assert "1 of 206 corners lie more than 5 times the median residual off:" in result.out
    assert "view '7', corner (2, 1) of the board: 4.95 px" in result.out.splitlines()[-1]
    estimate, parameters = read_calibration(output).estimate, dict(read_calibration(output).parameters)
    assert estimate.names == ("fx", "fy", "k1", "p1", "p2")
    assert read_calibration(output).center == (held["cx"], held["cy"])
    assert parameters["coefficients"][1] == pytest.approx(held["k2"], rel=1e-6)
    assert np.allclose(estimate.values[:2], 130, atol=1.5)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fix", "k6"], "--fix k6: the parameters are fx, fy, cx, cy, k1, k2, p1, p2"),
        (["--fix", "fx"], "--fix fx would hold a first guess; pass --start LENS.json"),
        (["--start", "missing.json"], "there is no file 'missing.json'"),
        (["--start", "corners.csv"], "corners.csv"),
        (["--start", "division.json"], "--model brown-conrady is the lens 'BrownConrady', and 'division.json' holds"),
        (["--start", "tall.json"], "the calibration is for pictures of 120 × 160 pixels"),
        (["--start", "1", "2", "3", "4", "5"], "--start has 5 coefficients, and the brown-conrady lens 4"),
    ],
)
def test_calibrate_refuses_a_start_that_is_none(run, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    _table(tmp_path / "corners.csv", HEADER, [_views(3)])
    frame = jl.Frame([60.0, 80.0], 130.0)
    write_calibration("division.json", Calibration.from_lens(jl.Division(0.1), frame=frame, image_size=(120, 160)))
    write_calibration(
        "tall.json", Calibration.from_lens(jl.BrownConrady([0.0] * 4), frame=frame, image_size=(120, 160))
    )
    result = run("calibrate", "--corners", "corners.csv", "--image-size", "160x120", "--terms", "4", *words)
    assert (result.code, message in result.err) == (2, True), result.err


def test_calibrate_refuses_what_determines_nothing(run, tmp_path):
    parallel = _table(tmp_path / "parallel.csv", HEADER, [_views(4, tilted=False)])
    words = ("--image-size", "160x120", "--terms", "4", "--output", tmp_path / "camera.json")
    result = run("calibrate", "--corners", parallel, *words)
    assert (result.code, "show the board at more angles" in result.err) == (1, True)
    single = _table(tmp_path / "single.csv", HEADER, [_views(1)])
    result = run("calibrate", "--corners", single, *words)
    assert (result.code, "1 view of a plane cannot determine fx" in result.err) == (1, True)
    assert not (tmp_path / "camera.json").exists()


def test_calibrate_from_pictures(run, tmp_path):
    cv2 = pytest.importorskip("cv2")
    white = np.full((480, 640), 235, np.uint8)
    flat = white.copy()
    for row in range(6):
        for column in range(7):
            if (row + column) % 2:
                flat[90 + 50 * row : 140 + 50 * row, 145 + 50 * column : 195 + 50 * column] = 20
    to_board = np.array([[1 / 50, 0, -320 / 50], [0, 1 / 50, -240 / 50], [0, 0, 1]])
    camera = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    for index, vector in enumerate([(0.5, 0.1, 0.0), (-0.1, 0.5, 0.1), (-0.4, -0.4, 0.0), (0.4, -0.4, -0.1)]):
        rotation = cv2.Rodrigues(np.array(vector))[0]
        matrix = camera @ np.column_stack([rotation[:, :2], [0, 0, 13]]) @ to_board
        images.write(tmp_path / f"{index}.png", Picture(cv2.warpPerspective(flat, matrix, (640, 480), borderValue=235)))
    images.write(tmp_path / "none.png", Picture(white))
    pictures = sorted(tmp_path.glob("*.png"))
    words = ("--model", "radial", "--terms", "1", "--square", "25")
    result = run("calibrate", *pictures, "--board", "6x5", *words)
    assert "no board of 6 × 5 inner corners" in result.err
    assert result.code == 0, result.err
    assert "4 views" in result.out
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "phone.heic").write_bytes(b"no picture")
    folder = run("calibrate", tmp_path, "--board", "6x5", *words)
    assert folder.out == result.out
    # As undistort: what is damaged is named, the others are done; what is of no format that is read is skipped.
    assert (folder.code, "broken.jpg': the file is damaged" in folder.err) == (1, True), folder.err
    assert "skipping" in folder.err
    assert "phone.heic" in folder.err
    (tmp_path / "broken.jpg").unlink()
    (tmp_path / "empty").mkdir()
    result = run("calibrate", tmp_path / "empty", "--board", "6x5")
    assert (result.code, "there is no picture in the folder" in result.err) == (2, True)
    result = run("calibrate", tmp_path / "missing.png", "--board", "6x5")
    assert (result.code, "there is no file" in result.err) == (2, True)
    result = run("calibrate", tmp_path / "none.png", "--board", "6x5")
    assert (result.code, "none of the 1 pictures shows a board" in result.err) == (1, True)
    images.write(tmp_path / "small.png", Picture(white[:100]))
    result = run("calibrate", tmp_path / "0.png", tmp_path / "small.png", "--board", "6x5")
    assert (result.code, "pictures of one size" in result.err) == (2, True)


def test_losses_are_those_of_the_library():
    """The command line names them again, for the library's own names import JAX."""
    assert get_args(estimation.Loss) == get_args(_robust.Loss)


def test_without_opencv(run, tmp_path, monkeypatch):
    images.write(tmp_path / "a.png", Picture(np.zeros((50, 50), np.uint8)))
    monkeypatch.setitem(sys.modules, "cv2", None)
    result = run("calibrate", tmp_path / "a.png", "--board", "6x5")
    assert (result.code, "pip install 'jaxlens[calibrate]'" in result.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["points", "nothing.csv"], "there is no file 'nothing.csv'"),
        (["points", "{points}", "--terms", "99"], "--terms of the radial lens can be 1, 2, 3"),
        (["points", "{points}", "--image-size", "160"], "--image-size is two counts"),
        (["points", "{points}", "--output", "{folder}"], "is a folder; name a file"),
        (["points", "{points}", "--output", "{folder}/no/lens.json"], "there is no folder"),
        (["points", "{points}", "--plots", "{points}"], "is a file; name a folder"),
        (["points", "{broken}"], "line 1: no column observed_y"),
        (["lines", "{points}"], "line 1: no column line, x, y"),
        (["points", "{points}"], "look like pixels; pass --image-size WIDTHxHEIGHT"),
        (["lines", "{lines}"], "coordinates up to 159 look like pixels; pass --image-size"),
    ],
)
def test_wrong_arguments(run, points, tmp_path, words, message):
    broken = tmp_path / "broken.csv"
    broken.write_text("ideal_x,ideal_y,observed_x\n1,2,3\n")
    lines = tmp_path / "lines.csv"
    lines.write_text("line,x,y\n0,1,2\n0,80,3\n0,159,2\n")
    places = {"points": points, "folder": tmp_path, "broken": broken, "lines": lines}
    result = run("fit", *(word.format(**places) for word in words))
    assert result.code == 2
    assert message in result.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "pass pictures of the board"),
        (["--corners", "c.csv"], "there is no file"),
        (["a.png"], "--board COLUMNSxROWS is needed"),
        (["a.png", "--board", "2x9"], "three a side at least"),
        (["a.png", "--board", "9x6", "--square", "0"], "--square is a length above 0"),
        (["a.png", "--board", "9x6", "--image-size", "640x480"], "pictures have a size of their own"),
    ],
)
def test_wrong_arguments_of_calibrate(run, words, message):
    result = run("calibrate", *words)
    assert result.code == 2
    assert message in result.err


def test_points_that_determine_nothing(run, tmp_path):
    angle = np.linspace(0, 6, 30)
    circle = 0.5 * np.column_stack([np.cos(angle), np.sin(angle)])
    table = _table(tmp_path / "circle.csv", "ideal_x,ideal_y,observed_x,observed_y", [circle, 1.1 * circle])
    result = run("fit", "points", table, "--output", tmp_path / "lens.json")
    assert result.code == 1
    assert "the data do not determine kappa1, kappa2 separately" in result.err
    assert not (tmp_path / "lens.json").exists()
    few = _table(tmp_path / "few.csv", "ideal_x,ideal_y,observed_x,observed_y", [circle[:1], circle[:1]])
    result = run("fit", "points", few, "--fit-center")
    assert (result.code, "too few points" in result.err) == (1, True)
