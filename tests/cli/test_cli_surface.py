"""`jaxlens surface` and `jaxlens geodesic`: landscapes, meshes seen from the front, distances along them."""

from typing import get_args

import numpy as np
import pytest

import jaxlens as jl
from jaxlens import images
from jaxlens.cli.surface import Drawing as Offered
from jaxlens.figures.surfaces import Drawing
from jaxlens.images import Picture
from jaxlens.surfaces import Mesh


@pytest.fixture
def slope(tmp_path):
    """A plane that rises 3 in 4 to the right, of 5 by 4 units."""
    path = tmp_path / "slope.ply"
    vertices = np.array([[0, 0, 0], [4, 0, 3], [4, 4, 3], [0, 4, 0]], float)
    jl.meshes.write(path, Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]])))
    return path


def test_the_styles_offered_are_those_there_are():
    assert get_args(Offered) == get_args(Drawing)


@pytest.mark.parametrize("style", get_args(Drawing))
def test_a_picture_as_a_landscape(run, picture, tmp_path, style):
    output = tmp_path / f"{style}.png"
    result = run("surface", picture, "--style", style, "--smoothing", "1", "--output", output)
    assert result.code == 0
    drawn = images.read(output).pixels
    assert min(drawn.shape[:2]) > 300
    assert drawn.std() > 5


def test_a_landscape_of_a_picture_with_holes(run, tmp_path):
    pixels = np.linspace(0, 1, 600, dtype=np.float32).reshape(20, 30)
    pixels[3, 4], pixels[5, 6] = np.nan, np.inf
    images.write(tmp_path / "holes.tif", Picture(pixels))
    result = run("surface", tmp_path / "holes.tif", "--output", tmp_path / "out.png")
    assert (result.code, "2 pixels of" in result.err) == (0, True), result.err
    assert images.read(tmp_path / "out.png").pixels.std() > 5


def test_a_mesh_from_the_front(run, slope, tmp_path):
    output, depth = tmp_path / "shaded.png", tmp_path / "depth.tif"
    result = run("surface", slope, "--size", "40x40", "--output", output, "--depth", depth)
    assert result.code == 0
    assert images.read(output).pixels.shape == (40, 40)
    values = images.read(depth).pixels
    expected = jl.surfaces.from_mesh(jl.meshes.read(slope), 40, 40)
    np.testing.assert_array_equal(np.isfinite(values), expected.mask)
    depths = np.asarray(expected.depth / expected.spacing[0])
    np.testing.assert_allclose(values[expected.mask], depths[expected.mask], rtol=1e-6)
    assert "of the mesh's units" in result.err


def test_distances_on_a_plane_are_straight(run, slope, tmp_path):
    folder = tmp_path / "distances"
    result = run("geodesic", slope, "--size", "41x41", "--source", "20", "20", "--output", folder)
    assert result.code == 0
    assert "farthest point    " in result.out
    assert "pixel (20.00, 20.00), as given" in result.out
    surface = jl.surfaces.from_mesh(jl.meshes.read(slope), 41, 41)
    points = np.asarray(surface.points())
    straight = np.linalg.norm(points - points[20, 20], axis=-1)
    for name in ("geodesic.tif", "radial.tif"):
        found = images.read(folder / name).pixels
        np.testing.assert_array_equal(np.isfinite(found), surface.mask)
        np.testing.assert_allclose(found[surface.mask], straight[surface.mask], rtol=1e-5, atol=1e-6)
    level, _, x, y = np.loadtxt(folder / "curves.csv", delimiter=",", skiprows=1).T
    spacing = float(surface.spacing[0])
    length = np.hypot(np.hypot(x - 20, y - 20), 0.75 * (x - 20)) * spacing
    assert np.abs(length - level).max() < 0.05 * spacing
    assert (folder / "distances.png").stat().st_size > 10_000


def test_the_default_source_of_a_picture_is_not_called_a_nose(run, picture, tmp_path):
    result = run("geodesic", picture, "--output", tmp_path / "out")
    assert result.code == 0
    assert ", the most prominent point" in result.out
    assert "nose" not in result.out + result.err


def test_a_picture_of_depths(run, tmp_path):
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    depth = np.where(abs(x - 20) < 2, np.nan, 0.5 * y).astype(np.float32)
    images.write(tmp_path / "depth.tif", Picture(depth))
    folder = tmp_path / "out"
    result = run("geodesic", tmp_path / "depth.tif", "--source", "5", "10", "--output", folder)
    assert result.code == 0
    assert "cannot be reached from the source" in result.err
    found = images.read(folder / "geodesic.tif").pixels
    assert np.isnan(found[10, 20])
    assert np.isposinf(found[10, 30])
    assert found[20, 5] == pytest.approx(10 * 1.25**0.5, rel=1e-5)
    again = run("geodesic", tmp_path / "depth.tif", "--source", "5", "10", "--output", folder)
    assert (again.code, "pass --overwrite" in again.err) == (2, True)


def test_a_surface_of_many_points_is_taken_coarser(run, tmp_path):
    x, y = np.meshgrid(np.arange(80.0), np.arange(60.0))
    images.write(tmp_path / "depth.tif", Picture((0.75 * x).astype(np.float32)))
    folder = tmp_path / "out"
    result = run("geodesic", tmp_path / "depth.tif", "--source", "10", "20", "--max-points", "1200", "-o", folder)
    assert result.code == 0
    assert "has 80 × 60 points, more than --max-points 1200: its surface is taken at 40 × 30" in result.err
    assert "pixel (10.00, 20.00)" in result.out
    found = images.read(folder / "geodesic.tif").pixels
    assert found.shape == (30, 40)
    x, y = x[::2, ::2] + 0.5, y[::2, ::2] + 0.5
    np.testing.assert_allclose(found, np.hypot(1.25 * (x - 10), y - 20), rtol=1e-5)
    level, _, x, y = np.loadtxt(folder / "curves.csv", delimiter=",", skiprows=1).T
    assert np.abs(np.hypot(1.25 * (x - 10), y - 20) - level).max() < 0.2
    whole = run(
        "geodesic", tmp_path / "depth.tif", "--source", "10", "20", "--max-points", "4800", "-o", tmp_path / "w"
    )
    assert "coarser" not in whole.err
    assert images.read(tmp_path / "w" / "geodesic.tif").pixels.shape == (60, 80)
    refused = run("geodesic", tmp_path / "depth.tif", "--max-points", "3", "--output", tmp_path / "no")
    assert (refused.code, "--max-points is at least 16, got 3" in refused.err) == (2, True)


def test_holes_stay_where_a_surface_is_taken_coarser(run, tmp_path):
    depth = np.zeros((60, 80), np.float32)
    depth[:, 40:44] = np.nan
    depth[3, 3] = np.nan
    images.write(tmp_path / "depth.tif", Picture(depth))
    result = run(
        "geodesic", tmp_path / "depth.tif", "--source", "10", "20", "--max-points", "1200", "-o", tmp_path / "o"
    )
    assert result.code == 0
    found = images.read(tmp_path / "o" / "geodesic.tif").pixels
    np.testing.assert_array_equal(np.isnan(found), np.broadcast_to(np.isin(np.arange(40), (20, 21)), (30, 40)))


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("geodesic", "FILE", "--source", "500", "1", "--output", "OUT"), 1, "source (500, 1) lies outside the mask"),
        (("geodesic", "FILE", "--step", "0", "--output", "OUT"), 2, "--step is a length above 0"),
        (("surface", "FILE", "--output", "OUT.jpg"), 2, "must end in .png"),
        (("surface", "FILE", "--size", "0x9", "--output", "OUT.png"), 2, "--size is two counts"),
        (("surface", "FILE", "--perspective", "0.9", "--output", "OUT.png"), 2, "--perspective is from 0"),
        (("surface", "FILE", "--smoothing", "nan", "--output", "OUT.png"), 2, "--smoothing is from 0 to 10000 pixels"),
        (("surface", "FILE", "--azimuth", "inf", "--output", "OUT.png"), 2, "--azimuth is from -360 to 360 degrees"),
        (("surface", "FILE", "--elevation", "nan", "--output", "OUT.png"), 2, "--elevation is from -360 to 360"),
        (("geodesic", "FILE", "--size", "32x32", "--step", "1e-6", "--output", "OUT"), 1, "curves up to the farthest"),
        (("surface", "FILE", "--field-of-view", "180", "--output", "OUT.png"), 2, "--field-of-view is between"),
    ],
)
def test_misuse(run, slope, tmp_path, words, code, message):
    replaced = [{"FILE": str(slope)}.get(word, word.replace("OUT", str(tmp_path / "out"))) for word in words]
    result = run(*replaced)
    assert (result.code, message in result.err) == (code, True), result.err


def test_files_that_are_no_surface(run, tmp_path):
    (tmp_path / "points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n"
    )
    result = run("surface", tmp_path / "points.ply", "--output", tmp_path / "a.png")
    assert (result.code, "has no faces" in result.err) == (1, True), result.err
    images.write(tmp_path / "empty.tif", Picture(np.full((8, 8), np.nan, np.float32)))
    result = run("geodesic", tmp_path / "empty.tif", "--output", tmp_path / "out")
    assert (result.code, "shows no surface" in result.err) == (1, True), result.err
    assert not (tmp_path / "out").exists()
