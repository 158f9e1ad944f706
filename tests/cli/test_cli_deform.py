"""`jaxlens deform`: pictures and meshes through lattices, corners and lenses; and what it refuses."""

import numpy as np
import pytest
from pictures import smooth

import jaxlens as jl
from jaxlens import images
from jaxlens.deformations import FreeForm, FreeForm3D
from jaxlens.images import Picture

SQUARE = ("1", "1", "9", "1", "9", "9", "1", "9")
PYRAMID = """v 0 0 0
v 2 0 0
v 2 2 0
v 0 2 0
v 1 1 1
f 1 2 5
f 2 3 5
f 3 4 5
f 4 1 5
"""


@pytest.fixture
def mesh(tmp_path):
    path = tmp_path / "pyramid.obj"
    path.write_text(PYRAMID)
    return path


def _csv(tmp_path, text):
    path = tmp_path / "control.csv"
    path.write_text(text)
    return path


def test_a_lattice_drags_a_picture(run, picture, tmp_path):
    control = _csv(tmp_path, "column,row,x,y\n1,1,0.6,0.5\n")
    output = tmp_path / "out.png"
    result = run("deform", picture, "--control", control, "--degrees", "2x2", "--output", output)
    assert result.code == 0
    still = FreeForm.identity(2, 2)
    dragged = FreeForm(still.control_points.at[1, 1].set(np.array([0.6, 0.5])))
    expected = jl.warp(smooth(), dragged.inverse(), frame=jl.Frame([-0.5, -0.5], [32, 24]))
    assert np.abs(images.read(output).pixels.astype(int) - np.asarray(expected, int)).max() <= 1
    assert "have no preimage" not in result.err


def test_nothing_listed_is_nothing_done(run, picture, tmp_path):
    output = tmp_path / "out.png"
    assert run("deform", picture, "--control", _csv(tmp_path, "column,row,x,y\n0,0,0,0\n"), "-o", output).code == 0
    assert (images.read(output).pixels == smooth()).all()


def test_a_fold_is_told(run, picture, tmp_path):
    control = _csv(tmp_path, "column,row,x,y,weight\n1,1,1.9,0.5,1\n2,2,-0.9,0.5,3\n")
    result = run("deform", picture, "--control", control, "--output", tmp_path / "out.png")
    assert result.code == 0
    assert "have no preimage" in result.err


def test_corners_make_a_slanted_rectangle_upright(run, tmp_path):
    """A picture slanted by a homography comes back."""
    y, x = np.mgrid[:40, :60]
    straight = np.stack([60 + 2 * x, 200 - 3 * y, 100 + x + y], axis=-1).astype(np.uint8)
    corners = np.array([[10.0, 8], [70, 4], [66, 52], [6, 46]])
    slanting = jl.deformations.rectification(corners, 40, 60)
    slanted = jl.warp(straight, slanting, frame=jl.Frame((0, 0), 1), shape=(60, 80))
    images.write(tmp_path / "slanted.png", Picture(np.asarray(slanted)))
    output = tmp_path / "upright.png"
    words = [str(value) for value in corners.ravel()]
    result = run("deform", tmp_path / "slanted.png", "--corners", *words, "--size", "60x40", "--output", output)
    assert result.code == 0
    upright = images.read(output).pixels
    assert upright.shape == straight.shape
    inner = np.s_[2:-2, 2:-2]
    assert np.abs(upright[inner].astype(float) - straight[inner]).max() <= 2
    # Without a size, sides as long as in the picture.
    assert run("deform", tmp_path / "slanted.png", "--corners", *words, "-o", tmp_path / "b.png").code == 0
    assert images.read(tmp_path / "b.png").pixels.shape[:2] == (48, 60)


def test_a_lattice_drags_a_mesh(run, mesh, tmp_path):
    control = _csv(tmp_path, "column,row,layer,x,y,z\n1,1,1,0.5,0.5,1.5\n")
    output = tmp_path / "out.obj"
    result = run("deform", mesh, "--control", control, "--degrees", "2x2x1", "--output", output)
    assert result.code == 0
    still = FreeForm3D.identity(2, 2, 1)
    dragged = FreeForm3D(still.control_points.at[1, 1, 1].set(np.array([0.5, 0.5, 1.5])))
    moved = jl.meshes.read(output)
    box = np.array([2.0, 2.0, 1.0])
    before = np.asarray(jl.meshes.read(mesh).vertices)
    np.testing.assert_allclose(moved.vertices, np.asarray(dragged(before / box)) * box, atol=1e-5)
    assert "5 vertices, 4 triangles" in result.err


def test_a_lens_bends_a_mesh(run, mesh, tmp_path):
    output = tmp_path / "out.ply"
    assert run("deform", mesh, "--kappa", "0.2", "--output", output).code == 0
    moved = np.asarray(jl.meshes.read(output).vertices)
    # A corner lies one half diagonal from the middle.
    np.testing.assert_allclose(moved[0], [-0.2, -0.2, 0], atol=1e-6)
    np.testing.assert_allclose(moved[4], [1, 1, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "a picture takes one of --control or --corners, got none"),
        (("--kappa", "0.1"), "got --kappa; for the lens use jaxlens distort"),
        (("--corners", *SQUARE, "--degrees", "2x2"), "--degrees goes with --control"),
        (("--corners", *["1", "1", "9", "9", "9", "1", "1", "9"]), "--corners: "),
        (("--control", "missing.csv"), "there is no file 'missing.csv'"),
        (("--corners", *SQUARE, "--quality", "90"), "--quality 90 is for JPEG and WebP"),
        (("--corners", *SQUARE, "--quality", "101"), "--quality is from 1 to 100, got 101"),
        (("--corners", *SQUARE, "--output", "out.xyz"), "suffix '.xyz', which no picture is written with"),
    ],
)
def test_misuse_with_a_picture(run, picture, tmp_path, words, message):
    result = run("deform", picture, "--output", tmp_path / "out.png", *words)
    assert (result.code, message in result.err) == (2, True), result.err
    assert not (tmp_path / "out.png").exists()


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("column,row,x\n1,1,0.5\n", (), "no column y"),
        ("column,row,x,y\n1,9,0.5,0.5\n", (), "row 1: row must be a whole number from 0 to 3 (see --degrees), got 9"),
        ("column,row,x,y\n1,1,0.5,0.5\n1,1,0.5,0.6\n", (), "row 2: control point (1, 1) is listed twice"),
        ("column,row,x,y,weight\n1,1,0.5,0.5,-1\n", (), "weights must be positive"),
        ("column,row,x,y\n1,1,0.5,0.5\n", ("--continuity", "2"), "freezes all control points"),
        ("column,row,x,y\n1,1,0.5,0.5\n", ("--degrees", "2x2x2"), "--degrees is 2 numbers from 1 to 20"),
    ],
)
def test_control_points_that_make_no_deformation(run, picture, tmp_path, text, options, message):
    result = run("deform", picture, "--control", _csv(tmp_path, text), *options, "--output", tmp_path / "out.png")
    assert (result.code, message in result.err) == (2, True), result.err


def test_misuse_with_a_mesh(run, mesh, picture, tmp_path):
    assert "a mesh becomes a mesh" in run("deform", mesh, "--kappa", "0.1", "--output", tmp_path / "out.png").err
    result = run("deform", mesh, "--corners", *SQUARE, "--output", tmp_path / "out.obj")
    assert "a mesh takes one of --control or --kappa or --lens, got --corners" in result.err
    result = run("deform", mesh, "--lens", "missing.json", "--output", tmp_path / "out.obj")
    assert (result.code, "there is no file 'missing.json'" in result.err) == (2, True)
    (tmp_path / "out.obj").write_text("mine")
    result = run("deform", mesh, "--kappa", "0.1", "--output", tmp_path / "out.obj")
    assert (result.code, "pass --overwrite" in result.err) == (2, True)
    broken = tmp_path / "broken.obj"
    broken.write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    result = run("deform", broken, "--kappa", "0.1", "--output", tmp_path / "b.obj")
    assert (result.code, "must be finite" in result.err) == (1, True), result.err
    assert not (tmp_path / "b.obj").exists()
