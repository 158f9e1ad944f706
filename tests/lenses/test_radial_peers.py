"""The programs that the radial lenses come from: COLMAP, lensfun, discorpy, ImageMagick."""

import shutil
import subprocess

import numpy as np
import pytest

import jaxlens as jl

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

SIZE, CENTER, FOCAL = (1000, 800), np.array([500.0, 400.0]), 500.0


def relative(found, expected):
    """The largest distance, relative to the size of what is expected, about the centre."""
    return np.max(np.linalg.norm(found - expected, axis=-1) / np.linalg.norm(expected, axis=-1))


def colmap(model, parameters):
    pycolmap = pytest.importorskip("pycolmap")
    return pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=parameters)


@pytest.mark.parametrize("omega", [0.02, 0.5, 1.0, 2.0, 2.9])
def test_field_of_view_is_colmap_s(x64, omega):
    camera, lens = colmap("FOV", [FOCAL, FOCAL, *CENTER, omega]), jl.FieldOfView(omega)
    random = np.random.default_rng(0)
    ideal = random.uniform(-1.5, 1.5, (10_000, 2))
    ideal = ideal[np.linalg.norm(ideal, axis=-1) > 0.02]  # nearer to the axis COLMAP takes the first terms of a series
    theirs = (camera.img_from_cam(np.c_[ideal, np.ones(len(ideal))]) - CENTER) / FOCAL
    assert relative(lens.distort(ideal), theirs) < 1e-13
    observed = random.uniform(-0.9, 0.9, (10_000, 2))
    observed = observed[np.linalg.norm(observed, axis=-1) > 0.02]
    found = lens.invert(observed)
    theirs = camera.cam_from_img(observed * FOCAL + CENTER)
    near = np.linalg.norm(observed, axis=-1) < 0.97 * lens.edge_radius()
    assert relative(found.points[near], theirs[near]) < 1e-12
    # Where a tangent has passed its pole COLMAP has an answer too.
    beyond = np.linalg.norm(observed, axis=-1) > lens.edge_radius()
    assert not np.any(np.asarray(found.valid)[beyond])


@pytest.mark.parametrize("k", [-0.3, -0.05, 0.3])
def test_division_is_colmap_s(x64, k):
    random, lens = np.random.default_rng(1), jl.Division(-k)
    cameras = colmap("SIMPLE_DIVISION", [FOCAL, *CENTER, k]), colmap("DIVISION", [FOCAL, 510.0, *CENTER, k])
    rays, observed = random.normal(size=(10_000, 3)), random.uniform(-0.9, 0.9, (10_000, 2))
    if k > 0:
        rays[:, 2] = np.abs(rays[:, 2])  # COLMAP has points, too, for rays that come from behind
    for camera, focal in zip(cameras, (np.array([FOCAL, FOCAL]), np.array([FOCAL, 510.0])), strict=True):
        theirs = (camera.img_from_cam(rays) - CENTER) / focal
        seen = np.isfinite(theirs).all(-1)
        ours = np.asarray(lens.project(rays))
        np.testing.assert_array_equal(np.isfinite(ours).all(-1), seen)
        assert relative(ours[seen], theirs[seen]) < 1e-10
        theirs = camera.cam_ray_from_img(observed * focal + CENTER)
        assert relative(lens.unproject(observed), theirs) < 1e-13


LENSES = """<lensdatabase><mount><name>M</name></mount>
<camera><maker>A</maker><model>B</model><mount>M</mount><cropfactor>1.5</cropfactor></camera>
<lens><maker>A</maker><model>poly3</model><mount>M</mount><cropfactor>1.5</cropfactor><calibration>
<distortion model="poly3" focal="50" k1="-0.02"/></calibration></lens>
<lens><maker>A</maker><model>poly5</model><mount>M</mount><cropfactor>1.5</cropfactor><calibration>
<distortion model="poly5" focal="50" k1="-0.02" k2="0.007"/></calibration></lens>
<lens><maker>A</maker><model>ptlens</model><mount>M</mount><cropfactor>1.5</cropfactor><calibration>
<distortion model="ptlens" focal="50" a="0.01" b="-0.04" c="0.02"/></calibration></lens></lensdatabase>"""


def lensfun_s(lens, focal, crop, width, height, points):
    """Source coordinates by lensfun, one pixel a call: its code for four at once swaps their radii."""
    lensfunpy = pytest.importorskip("lensfunpy")
    modifier = lensfunpy.Modifier(lens, crop, width, height)
    modifier.initialize(focal, 8.0, 10.0, flags=lensfunpy.ModifyFlags.DISTORTION)
    return np.array([modifier.apply_geometry_distortion(x, y, 1, 1)[0, 0] for x, y in points])


def check_lensfun(lens, ours, focal, crop, width, height, aspect_ratio=1.5):
    random = np.random.default_rng(2)
    points = np.stack([random.integers(0, width, 200), random.integers(0, height, 200)], -1).astype(float)
    scale = np.hypot(width - 1, height - 1) / 2 / np.hypot(aspect_ratio, 1) * crop / lens.crop_factor
    center = np.array([(width - 1) / 2, (height - 1) / 2])
    frame = jl.Frame(center, scale)
    found = frame.denormalize(ours.distort(frame.normalize(points)))
    expected = lensfun_s(lens, focal, crop, width, height, points)
    assert relative(np.asarray(found) - center, expected - center) < 1e-5


@pytest.mark.parametrize(("width", "height"), [(600, 400), (401, 601), (900, 400)])
def test_the_polynomials_are_lensfun_s(x64, width, height):
    lensfunpy = pytest.importorskip("lensfunpy")
    ours = {"poly3": jl.Poly3(-0.02), "poly5": jl.Poly5(-0.02, 0.007), "ptlens": jl.PtLens(0.01, -0.04, 0.02)}
    for lens in lensfunpy.Database(load_common=False, load_bundled=False, xml=LENSES).lenses:
        check_lensfun(lens, ours[lens.model], 50.0, 1.5, width, height)
        check_lensfun(lens, ours[lens.model], 50.0, 2.0, width, height)


def test_lenses_of_lensfun_s_own(x64):
    lensfunpy = pytest.importorskip("lensfunpy")
    kinds = {"PTLENS": (jl.PtLens, 3), "POLY3": (jl.Poly3, 1)}
    # A full-frame camera's, so that the pictures were 3 : 2.
    names = {"Canon EF 28-70mm f/2.8L USM", "Canon EF-S 24mm f/2.8 STM"}
    found = [lens for lens in lensfunpy.Database().lenses if lens.model in names]
    assert found
    for lens in found:
        distortion = lens.interpolate_distortion(lens.min_focal)
        kind, count = kinds[distortion.model.name]
        check_lensfun(lens, kind(*distortion.terms[:count]), lens.min_focal, lens.crop_factor, 600, 400)


@pytest.mark.slow
def test_radial_powers_are_discorpy_s(x64):
    post = pytest.importorskip("discorpy.post.postprocessing")
    random = np.random.default_rng(3)
    frame = jl.Frame(CENTER, FOCAL)
    k = np.array([1.02, 0.03, -0.05, 0.01, 0.004])
    in_pixels = list(k / FOCAL ** np.arange(len(k)))
    points = random.uniform(0, SIZE, (2000, 2))
    # Lines are arrays of (y, x).
    forward = post.unwarp_line_forward([points[:, ::-1]], *CENTER, in_pixels)[0][:, ::-1]
    ours = np.asarray(frame.denormalize(jl.RadialPowersInverse(k).undistort(frame.normalize(points))))
    assert relative(ours - CENTER, forward - CENTER) < 1e-13
    # The other direction is found by a search, which is not run to the last digit.
    some = points[:100]
    backward = post.unwarp_line_backward([some[:, ::-1]], *CENTER, in_pixels)[0][:, ::-1]
    ours = np.asarray(frame.denormalize(jl.RadialPowers(k).undistort(frame.normalize(some))))
    assert relative(ours - CENTER, backward - CENTER) < 1e-6
    x, y = np.meshgrid(np.arange(100.0), np.arange(80.0))
    frame, in_pixels = jl.Frame([50.0, 40.0], 50.0), list(k / 50.0 ** np.arange(len(k)))
    sources = np.stack([post.unwarp_image_backward(plane, 50.0, 40.0, in_pixels) for plane in (x, y)], -1)
    ours = np.asarray(frame.denormalize(jl.RadialPowers(k).distort(frame.normalize(np.stack([x, y], -1)))))
    inside = np.all((ours >= 0) & (ours <= [99, 79]), axis=-1)
    np.testing.assert_allclose(sources[inside], ours[inside], rtol=0, atol=1e-5)  # it counts in single precision


def image_magick():
    """The command of ImageMagick 7 or 6, where it is installed."""
    for name in ("magick", "convert", "convert-im6.q16"):
        path = shutil.which(name)
        if path is None:
            continue
        said = subprocess.run([path, "-version"], capture_output=True, text=True, check=False).stdout
        if said.startswith("Version: ImageMagick"):
            return path
    return pytest.skip("ImageMagick is not installed")


@pytest.mark.parametrize(
    ("method", "lens", "arguments"),
    [
        ("Barrel", jl.Barrel(0.02, -0.05, 0.03), "0.02 -0.05 0.03"),
        ("Barrel", jl.Barrel(0.02, -0.05, 0.03, d=0.9), "0.02 -0.05 0.03 0.9"),
        ("BarrelInverse", jl.BarrelInverse(0.02, -0.05, 0.03), "0.02 -0.05 0.03"),
        ("BarrelInverse", jl.BarrelInverse(0.0, 0.05, 0.03, d=1.1), "0 0.05 0.03 1.1"),
    ],
)
@pytest.mark.parametrize(("width", "height"), [(200, 120), (121, 201)])
def test_barrels_are_image_magick_s(x64, method, lens, arguments, width, height):
    """Pictures of the coordinates themselves, 16 bits deep: the source of each pixel to half a step of theirs."""
    command, step = image_magick(), 200
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    picture = ["-size", f"{width}x{height}", "-depth", "16", "-endian", "LSB", "gray:-"]
    sources = []
    for plane in (x, y):
        options = ["-virtual-pixel", "black", "-filter", "point", "-interpolate", "bilinear"]
        words = [command, *picture, *options, "-distort", method, arguments, *picture[2:]]
        pixels = (8192 + step * plane).astype("<u2").tobytes()
        result = subprocess.run(words, input=pixels, capture_output=True, check=True)
        sources.append((np.frombuffer(result.stdout, "<u2").reshape(height, width) - 8192.0) / step)
    frame = jl.Frame([(width - 1) / 2, (height - 1) / 2], min(width, height) / 2)
    ours = np.asarray(frame.denormalize(lens.distort(frame.normalize(np.stack([x, y], -1).astype(float)))))
    inside = np.all((ours > 1) & (ours < [width - 2, height - 2]), axis=-1)
    assert inside.mean() > 0.9
    np.testing.assert_allclose(np.stack(sources, -1)[inside], ours[inside], rtol=0, atol=1.1 / step)
