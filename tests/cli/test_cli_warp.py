import os
import sys

import jax
import numpy as np
import pytest
from pictures import files_in, smooth
from PIL import Image, ImageCms

import jaxlens as jl
from jaxlens import images
from jaxlens.images import Picture, PictureMetadata


def library(pixels, direction, kappa, **options):
    """What the library makes of the pixels, in single precision."""
    with jax.enable_x64(False):
        lens = jl.RadialPolynomial(np.array(kappa, np.float32))
        function = {"distort": jl.distort_image, "undistort": jl.undistort_image}[direction]
        return np.asarray(function(pixels, lens, **options))


@pytest.mark.parametrize("direction", ["distort", "undistort"])
def test_pixels_are_those_of_the_library(run, picture, direction):
    output = picture.with_name("out.png")
    result = run(direction, picture, "--kappa", "-0.2", "5e-2", "--output", output)
    assert result.code == 0
    assert result.out == ""
    assert "out.png" in result.err
    assert "32 × 24, 8-bit RGB" in result.err
    np.testing.assert_array_equal(images.read(output).pixels, library(smooth(), direction, (-0.2, 0.05)))


@pytest.mark.parametrize("words", [["-.2", "+5E-2"], ["-2e-1", "0.05"], ["-0.2000", "5e-2"]])
def test_ways_to_write_numbers(run, picture, words):
    output = picture.with_name("out.png")
    assert run("distort", picture, "-k", *words, "-o", output).code == 0
    np.testing.assert_array_equal(images.read(output).pixels, library(smooth(), "distort", (-0.2, 0.05)))


def test_the_process_itself(run_process, picture):
    result = run_process("distort", picture.name, "--kappa", "-0.2", "5e-2", "--output", "out.png", cwd=picture.parent)
    assert result.code == 0
    assert result.out == ""
    assert result.err == "jaxlens: wrote 'out.png' (32 × 24, 8-bit RGB)\n"
    np.testing.assert_array_equal(
        images.read(picture.with_name("out.png")).pixels, library(smooth(), "distort", (-0.2, 0.05))
    )


def test_options_reach_the_library(run, picture):
    output = picture.with_name("out.png")
    options = ["--method", "bicubic_opencv", "--border", "reflect", "--fill", "7", "8", "9"]
    assert run("distort", picture, "--kappa", "-0.9", "0", "--output", output, *options).code == 0
    fill = np.float32([7, 8, 9])
    expected = library(smooth(), "distort", (-0.9, 0.0), method="bicubic_opencv", border="reflect", fill=fill)
    np.testing.assert_array_equal(images.read(output).pixels, expected)


def test_center(run, picture):
    output = picture.with_name("out.png")
    assert run("undistort", picture, "--kappa", "0.3", "0", "--output", output, "--center", "10", "8.5").code == 0
    with jax.enable_x64(False):
        frame = jl.Frame(np.array([10.0, 8.5]), 20.0)
        expected = np.asarray(jl.undistort_image(smooth(), jl.RadialPolynomial(np.array([0.3, 0.0])), frame=frame))
    np.testing.assert_array_equal(images.read(output).pixels, expected)


def test_crop_leaves_no_border(run, picture):
    output = picture.with_name("out.png")
    assert run("undistort", picture, "--kappa", "0.3", "0", "--output", output, "--crop").code == 0
    cropped = images.read(output).pixels
    assert 8 < cropped.shape[0] < 24
    assert 8 < cropped.shape[1] < 32
    assert cropped.min() >= smooth().min()
    whole = library(smooth(), "undistort", (0.3, 0.0))
    windows = np.lib.stride_tricks.sliding_window_view(whole, cropped.shape).reshape(-1, *cropped.shape)
    assert any(np.array_equal(window, cropped) for window in windows)


def test_nothing_left_to_crop(run, picture):
    output = picture.with_name("out.png")
    result = run("undistort", picture, "--kappa", "1e6", "0", "--output", output, "--crop", "--center", "-500", "0")
    assert result.code == 1
    assert "--crop" in result.err
    assert not output.exists()


@pytest.mark.parametrize("direction", ["distort", "undistort"])
def test_a_lens_that_folds(run, picture, direction):
    output = picture.with_name("out.png")
    result = run(direction, picture, "--kappa", "-0.9", "0", "--output", output)
    assert result.code == 0
    with jax.enable_x64(False):
        lens = jl.RadialPolynomial(np.array([-0.9, 0.0]))
        maps = {"distort": jl.distortion_map, "undistort": jl.undistortion_map}
        share = np.isnan(np.asarray(maps[direction](lens, 24, 32))[..., 0]).mean()
    assert 0.2 < share < 0.9
    assert "folds at the radius 0.6086 (12.2 pixels" in result.err
    assert f"{share:.2%} of the pixels" in result.err
    pixels = images.read(output).pixels
    assert (pixels == 0).all(axis=-1).mean() == pytest.approx(share, abs=0.05)


def test_a_lens_that_folds_outside_is_not_warned_of(run, picture):
    result = run("undistort", picture, "--kappa", "-0.3", "0", "--output", picture.with_name("out.png"))
    assert result.code == 0
    assert "warning" not in result.err


BROKEN = {
    "truncated.png": lambda good: good[: len(good) // 2],
    "empty.png": lambda good: b"",
    "text.png": lambda good: b"this is no picture\n",
    "header.png": lambda good: good[:40],
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_input(run, picture, name):
    broken = picture.with_name(name)
    broken.write_bytes(BROKEN[name](picture.read_bytes()))
    result = run("distort", broken, "--kappa", "0.1", "--output", picture.with_name("out.png"))
    assert result.code == 1
    assert name in result.err
    assert result.out == ""
    assert files_in(picture.parent) == sorted([name, "picture.png"])


def test_broken_input_as_a_process(run_process, picture):
    broken = picture.with_name("truncated.png")
    broken.write_bytes(BROKEN["truncated.png"](picture.read_bytes()))
    result = run_process("distort", broken, "--kappa", "0.1", "--output", picture.with_name("out.png"))
    assert result.code == 1
    assert len(result.err.splitlines()) == 1
    assert "truncated.png" in result.err
    assert files_in(picture.parent) == ["picture.png", "truncated.png"]


def test_too_many_pixels(run, picture):
    result = run("distort", picture, "--kappa", "0.1", "--output", picture.with_name("o.png"), "--max-pixels", "767")
    assert result.code == 1
    assert "32 × 24 = 768 pixels" in result.err
    assert "--max-pixels 767" in result.err
    assert "max_pixels" not in result.err
    assert files_in(picture.parent) == ["picture.png"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kappa", "nan"], "'nan' is not finite"),
        (["--kappa", "0.1", "-inf"], "'-inf' is not finite"),
        (["--kappa", "1e400"], "'1e400' is not finite"),
        (["--kappa", "1e30"], "'1e30' is beyond"),
        (["--kappa", "big"], "'big' is not a number"),
        (["--kappa"], "at least one"),
        (["--kappa", "0.1", "--output", ""], "--output is empty"),
        (["--kappa", "0.1", "--method", "cubic"], "bicubic"),
        (["--kappa", "0.1", "--border", "black"], "constant"),
        (["--kappa", "0.1", "--fill", "inf"], "'inf' is not finite"),
        (["--kappa", "0.1", "--fill", "1e39"], "'1e39' is beyond"),
        (["--kappa", "0.1", "--center", "0", "1e7"], "'1e7' is beyond"),
        (["--kappa", "0.1", "--fill", "1", "2", "3", "4", "5"], "got 5"),
        (["--kappa", "0.1", "--center", "1"], "--center"),
        (["--kappa", "0.1", "--quality", "0"], "--quality is from 1 to 100, got 0"),
        (["--kappa", "0.1", "--quality", "80"], "none will be written"),
        (["--kappa", "0.1", "--max-pixels", "0"], "--max-pixels is at least 1, got 0"),
        (["--kappa", "0.1", "--zoom", "2"], "--zoom"),
    ],
)
def test_wrong_options(run, picture, options, message):
    result = run("distort", picture, "--output", picture.with_name("out.png"), *options)
    assert result.code == 2
    assert message in " ".join(result.err.replace("│", " ").split())
    assert result.out == ""
    assert files_in(picture.parent) == ["picture.png"]


def test_an_empty_path(run, tmp_path):
    result = run("distort", "", "--kappa", "0.1", "--output", tmp_path / "out.png")
    assert result.code == 2
    assert "a path is empty" in result.err


def test_an_existing_output(run, picture):
    output = picture.with_name("out.png")
    output.write_bytes(b"precious")
    result = run("distort", picture, "--kappa", "0.1", "--output", output)
    assert result.code == 1
    assert "pass --overwrite" in result.err
    assert output.read_bytes() == b"precious"
    assert run("distort", picture, "--kappa", "-0.2", "0.05", "--output", output, "--overwrite").code == 0
    assert images.read(output).pixels.shape == (24, 32, 3)
    # In place, too: what is read is read before anything is written.
    assert run("distort", output, "--kappa", "-0.2", "0.05", "--output", output, "--overwrite").code == 0


@pytest.mark.skipif(not hasattr(os, "geteuid") or sys.platform == "win32", reason="permissions of POSIX")
def test_a_folder_that_may_not_be_written(run, picture, tmp_path, monkeypatch):
    if os.geteuid() == 0:
        # The superuser may write anywhere: the system's refusal is acted.
        def refuse(*_, **__):
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr("jaxlens.files._create_empty", refuse)
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    result = run("distort", picture, "--kappa", "-0.2", "0.05", "--output", folder / "out.png")
    assert result.code == 1
    assert "out.png" in result.err
    assert files_in(folder) == []


def test_a_format_that_does_not_hold_the_picture(run, picture, tmp_path):
    images.write(tmp_path / "deep.png", smooth(np.uint16))
    result = run("distort", tmp_path / "deep.png", "--kappa", "0.1", "--output", tmp_path / "out.jpg")
    assert result.code == 1
    assert "JPEG" in result.err
    assert not (tmp_path / "out.jpg").exists()


def test_a_folder_of_pictures(run, picture, tmp_path):
    folder = picture.parent
    images.write(folder / "second.png", smooth()[::-1].copy())
    (folder / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "notes.txt").write_text("not a picture")
    output = tmp_path / "out"
    result = run("distort", folder, "--kappa", "-0.2", "0.05", "--output", output)
    assert result.code == 1
    assert "broken.png" in result.err
    assert "wrote 2 of 3 pictures" in result.err
    assert result.out == ""
    assert files_in(output) == ["picture.png", "second.png"]
    np.testing.assert_array_equal(
        images.read(output / "second.png").pixels, library(smooth()[::-1], "distort", (-0.2, 0.05))
    )
    again = run("distort", folder, "--kappa", "-0.2", "0.05", "--output", output)
    assert again.code == 1
    assert again.err.count("pass --overwrite") == 2


def test_a_folder_is_compiled_for_once(run, tmp_path, monkeypatch):
    folder = tmp_path / "many"
    folder.mkdir()
    for index in range(5):
        images.write(folder / f"{index}.png", smooth())
    jl.warp.clear_cache()
    assert run("distort", folder, "--kappa", "-0.2", "0.05", "--output", tmp_path / "out").code == 0
    assert jl.warp._cache_size() == 1


def test_same_names_from_different_folders(run, picture, tmp_path):
    (tmp_path / "other").mkdir()
    images.write(tmp_path / "other" / "picture.png", smooth()[::-1].copy())
    result = run("distort", picture.parent, tmp_path / "other", "--kappa", "0.1", "--output", tmp_path / "out")
    assert result.code == 2
    assert "would both be written" in result.err
    assert not (tmp_path / "out").exists()


def test_no_folder_is_left_where_nothing_was_written(run, tmp_path):
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(b"no picture")
    result = run("distort", tmp_path / "a.png", tmp_path / "b.png", "--kappa", "0.1", "--output", tmp_path / "out")
    assert result.code == 1
    assert "wrote 0 of 2 pictures" in result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_link_that_leads_out_of_the_folder(run, picture, tmp_path):
    output = tmp_path / "out"
    output.mkdir()
    outside = tmp_path / "outside.png"
    outside.write_bytes(b"precious")
    (output / picture.name).symlink_to(outside)
    result = run("distort", picture, "--kappa", "0.1", "--output", output, "--overwrite")
    assert result.code == 1
    assert "leads out of the folder" in result.err
    assert outside.read_bytes() == b"precious"


def test_metadata_is_kept_and_orientation_applied_once(run, tmp_path):
    exif = Image.Exif()
    exif[0x010F] = "Lens & Co"
    exif[0x0112] = 6
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # Stored lying; upright it is the usual picture.
    stored = np.rot90(smooth())
    Image.fromarray(stored).save(tmp_path / "phone.png", exif=exif, icc_profile=profile)
    assert run("distort", tmp_path / "phone.png", "-k", "-0.2", "0.05", "-o", tmp_path / "out.png").code == 0
    np.testing.assert_array_equal(images.read(tmp_path / "out.png").pixels, library(smooth(), "distort", (-0.2, 0.05)))
    with Image.open(tmp_path / "out.png") as out:
        assert out.getexif()[0x010F] == "Lens & Co"
        assert out.getexif().get(0x0112, 1) == 1
        assert out.info["icc_profile"] == profile


def test_what_the_reader_warns_of_is_a_message(run, tmp_path):
    frames = [Image.fromarray(smooth()), Image.fromarray(smooth()[::-1].copy())]
    frames[0].save(tmp_path / "moving.gif", save_all=True, append_images=frames[1:])
    result = run("distort", tmp_path / "moving.gif", "-k", "-0.2", "0.05", "-o", f"{tmp_path / 'out'}/")
    assert result.code == 0
    assert "warning" in result.err
    assert "only the first" in result.err
    assert files_in(tmp_path / "out") == ["moving.png"]


def test_quality(run, picture, tmp_path):
    sizes = []
    for quality in (20, 95):
        output = tmp_path / f"{quality}.jpg"
        assert run("distort", picture, "-k", "-0.2", "0.05", "-o", output, "--quality", quality).code == 0
        sizes.append(output.stat().st_size)
    assert sizes[0] < sizes[1]


def test_fill_with_nan_is_for_floating_pictures(run, picture, tmp_path):
    images.write(tmp_path / "float.tif", smooth(np.float32, 1))
    options = ["-k", "0.3", "0", "--fill", "nan", "-o"]
    assert run("undistort", tmp_path / "float.tif", *options, tmp_path / "out.tif").code == 0
    missing = np.isnan(images.read(tmp_path / "out.tif").pixels)
    assert 0.1 < missing.mean() < 0.7
    assert missing[0, 0]
    assert not missing[6:18, 8:24].any()
    result = run("undistort", picture, *options, tmp_path / "out.png")
    assert result.code == 1
    assert "--fill nan" in result.err


def test_a_name_with_control_characters_is_quoted(run, tmp_path):
    path = tmp_path / "red\x1b[31m [bold].png"
    path.write_bytes(b"no picture")
    result = run("distort", path, "--kappa", "0.1", "--output", tmp_path / "out.png")
    assert result.code == 1
    assert "\x1b" not in result.err
    assert "[bold]" in result.err


def test_pictures_with_metadata_of_their_own(run, tmp_path):
    picture = Picture(smooth(np.float32, 1), PictureMetadata(dpi=(72.0, 72.0)))
    images.write(tmp_path / "float.tif", picture)
    assert run("undistort", tmp_path / "float.tif", "-k", "0.3", "0", "-o", tmp_path / "out.tif").code == 0
    out = images.read(tmp_path / "out.tif")
    assert out.metadata.dpi == (72.0, 72.0)
    np.testing.assert_array_equal(out.pixels, library(smooth(np.float32, 1), "undistort", (0.3, 0.0)))
