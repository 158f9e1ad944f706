import contextlib
import dataclasses
import io
import os
import re
import resource
import signal
import stat
import struct
import subprocess
import sys
import warnings
import zlib

import numpy as np
import pytest
import tifffile
from PIL import ExifTags, Image, ImageCms, ImageOps, features
from PIL.TiffImagePlugin import IFDRational, ImageFileDirectory_v2

import jaxlens.images.writing
from jaxlens import images
from jaxlens.images import READABLE_SUFFIXES, WRITABLE_SUFFIXES, ImageError, Picture, PictureMetadata, list_images
from jaxlens.images.exif import reset_orientation
from jaxlens.images.picture import FORMATS

LOSSLESS = [
    (suffix, dtype, channels)
    for known in FORMATS
    for suffix in known.suffixes
    for dtype, counts in known.channels.items()
    for channels in counts
    if known.name != "JPEG"
]
EVERY_DTYPE = ("bool", "uint8", "uint16", "uint32", "int16", "float16", "float32", "float64", "complex64")


def noise(dtype="uint8", channels=3, height=11, width=13):
    rng = np.random.default_rng(7)
    shape = (height, width) if channels == 1 else (height, width, channels)
    if np.dtype(dtype).kind == "f":
        return rng.normal(size=shape).astype(dtype)
    limits = np.iinfo(dtype)
    return rng.integers(limits.min, limits.max, shape, dtype=dtype, endpoint=True)


def ramp(channels=3, height=24, width=32):
    y, x = np.mgrid[:height, :width]
    layers = [x * 7, y * 10, x * 3 + y * 4, 255 - x * 5][:channels]
    pixels = np.stack(layers, axis=-1).astype(np.uint8)
    return pixels[..., 0] if channels == 1 else pixels


def rgb_profile():
    return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def exif_with(orientation=None):
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "Lens & Sons"
    exif[ExifTags.Base.Model] = "M1"
    exif[ExifTags.Base.Copyright] = "nobody"
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.FocalLength] = IFDRational(35, 10)
    details[ExifTags.Base.MakerNote] = bytes(range(200))
    details[ExifTags.Base.DateTimeOriginal] = "2024:02:29 12:34:56"
    place = exif.get_ifd(ExifTags.IFD.GPSInfo)
    place[ExifTags.GPS.GPSLatitudeRef] = "N"
    place[ExifTags.GPS.GPSLatitude] = (51.0, 30.0, 12.5)
    return exif


def exif_bytes(orientation=None):
    return exif_with(orientation).tobytes().removeprefix(b"Exif\0\0")


def parsed(block):
    exif = Image.Exif()
    exif.load(block)
    tags = {tag: value for tag, value in exif.items() if tag not in (34665, 34853)}
    return tags, dict(exif.get_ifd(ExifTags.IFD.Exif)), dict(exif.get_ifd(ExifTags.IFD.GPSInfo))


def listing(folder):
    return sorted(os.listdir(folder))


def encoded(pixels, format, **options):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format, **options)
    return file.getvalue()


def put(folder, data, name="picture.png"):
    path = folder / name
    path.write_bytes(data)
    return path


def png(width, height, depth, colour_type, rows=b"", extra=b"", interlace=0):
    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, depth, colour_type, 0, 0, interlace)
    body = chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def png_chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


# --- round trips ---


@pytest.mark.parametrize(("suffix", "dtype", "channels"), LOSSLESS)
def test_lossless_round_trip(tmp_path, suffix, dtype, channels):
    pixels = noise(dtype, channels)
    path = tmp_path / f"picture{suffix}"
    images.write(path, pixels)
    picture = images.read(path)
    assert picture.pixels.dtype == pixels.dtype
    assert picture.pixels.flags.c_contiguous
    np.testing.assert_array_equal(picture.pixels, pixels)
    assert picture.has_alpha == (channels in (2, 4))
    assert picture.path == path
    assert listing(tmp_path) == [path.name]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".JPG"])
def test_jpeg_round_trip(tmp_path, suffix, channels):
    pixels = ramp(channels)
    images.write(tmp_path / f"picture{suffix}", pixels)
    picture = images.read(tmp_path / f"picture{suffix}")
    assert picture.pixels.shape == pixels.shape
    assert np.abs(picture.pixels.astype(int) - pixels).max() <= 8
    assert picture.metadata.format == "JPEG"


@pytest.mark.parametrize(("dtype", "suffix"), [("float32", ".tif"), ("float64", ".tif"), ("float16", ".tif")])
def test_special_floats_survive(tmp_path, dtype, suffix):
    pixels = np.array([[np.nan, np.inf, -np.inf], [-0.0, np.finfo(dtype).max, np.finfo(dtype).tiny]], dtype)
    images.write(tmp_path / f"a{suffix}", pixels)
    assert images.read(tmp_path / f"a{suffix}").pixels.tobytes() == pixels.tobytes()


def test_other_libraries_read_what_is_written(tmp_path):
    import cv2

    for suffix, dtype, channels in LOSSLESS:
        if dtype not in ("uint8", "uint16", "float32") or suffix == ".pnm" or channels == 2:
            continue
        if (suffix[:4], dtype, channels) == (".tif", "uint8", 4):
            continue  # OpenCV multiplies alpha into these; Pillow reads them below
        pixels = noise(dtype, channels)
        images.write(tmp_path / f"a{suffix}", pixels, overwrite=True)
        theirs = cv2.imread(str(tmp_path / f"a{suffix}"), cv2.IMREAD_UNCHANGED)
        order = {1: ..., 3: [2, 1, 0], 4: [2, 1, 0, 3]}[channels]
        theirs = theirs if channels == 1 else theirs[..., order]
        np.testing.assert_array_equal(theirs, pixels, err_msg=f"{suffix} {dtype} {channels}")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp"])
def test_pillow_reads_straight_alpha(tmp_path, suffix):
    images.write(tmp_path / f"a{suffix}", noise("uint8", 4))
    with Image.open(tmp_path / f"a{suffix}") as image:
        assert image.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(image), noise("uint8", 4))


def test_files_of_opencv_are_read(tmp_path):
    import cv2

    for suffix, dtype, channels in [
        (".png", "uint16", 4), (".png", "uint16", 3), (".tif", "uint8", 4), (".tif", "uint16", 4),
        (".tif", "uint16", 1), (".tif", "float32", 3), (".tif", "float32", 1), (".tif", "float64", 3),
    ]:  # fmt: skip
        pixels = noise(dtype, channels)
        order = {1: ..., 3: [2, 1, 0], 4: [2, 1, 0, 3]}[channels]
        cv2.imwrite(str(tmp_path / f"a{suffix}"), pixels if channels == 1 else pixels[..., order])
        picture = images.read(tmp_path / f"a{suffix}")
        assert picture.pixels.dtype == dtype
        np.testing.assert_array_equal(picture.pixels, pixels, err_msg=f"{suffix} {dtype} {channels}")


def test_one_channel_is_gray(tmp_path):
    pixels = noise(channels=1)
    images.write(tmp_path / "a.png", pixels[..., None])
    np.testing.assert_array_equal(images.read(tmp_path / "a.png").pixels, pixels)


def test_foreign_byte_order_and_strides(tmp_path):
    pixels = noise("uint16", 3)
    images.write(tmp_path / "a.png", pixels.astype(">u2")[::-1, ::-1])
    images.write(tmp_path / "a.tif", np.asfortranarray(pixels[::-1, ::-1]))
    for suffix in (".png", ".tif"):
        read = images.read(tmp_path / f"a{suffix}").pixels
        assert read.dtype.isnative
        np.testing.assert_array_equal(read, pixels[::-1, ::-1])


@pytest.mark.parametrize("suffix", WRITABLE_SUFFIXES)
def test_equal_pictures_make_equal_files(tmp_path, suffix):
    known = next(known for known in FORMATS if suffix in known.suffixes)
    pixels = noise("uint8", known.channels["uint8"][-1])
    metadata = PictureMetadata(exif=exif_bytes(), icc_profile=rgb_profile(), dpi=(300.0, 300.0))
    for name in ("first", "second"):
        images.write(tmp_path / f"{name}{suffix}", pixels, metadata=metadata)
    assert (tmp_path / f"first{suffix}").read_bytes() == (tmp_path / f"second{suffix}").read_bytes()


def test_file_of_16_bit_colour_is_deterministic(tmp_path):
    for name in ("first.png", "second.png"):
        images.write(tmp_path / name, noise("uint16", 4))
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def test_suffix_does_not_decide_the_reading(tmp_path):
    path = put(tmp_path, encoded(ramp(), "PNG"), "picture.jpg")
    assert images.read(path).metadata.format == "PNG"


# --- kinds of pictures ---


def test_palette(tmp_path):
    indexed = Image.fromarray(ramp()).quantize(16)
    indexed.save(tmp_path / "a.png")
    picture = images.read(tmp_path / "a.png")
    np.testing.assert_array_equal(picture.pixels, np.asarray(indexed.convert("RGB")))
    assert not picture.has_alpha


@pytest.mark.parametrize("suffix", [".png", ".gif"])
def test_palette_with_transparency(tmp_path, suffix):
    indexed = Image.fromarray(ramp()).quantize(16)
    indexed.save(tmp_path / f"a{suffix}", transparency=3)
    picture = images.read(tmp_path / f"a{suffix}")
    assert picture.has_alpha
    np.testing.assert_array_equal(picture.pixels[..., 3], np.where(np.asarray(indexed) == 3, 0, 255))
    np.testing.assert_array_equal(picture.pixels[..., :3], np.asarray(indexed.convert("RGB")))


def test_palette_tiff_and_bmp(tmp_path):
    indexed = Image.fromarray(ramp()).quantize(16)
    for suffix in (".tif", ".bmp"):
        indexed.save(tmp_path / f"a{suffix}")
        picture = images.read(tmp_path / f"a{suffix}")
        np.testing.assert_array_equal(picture.pixels, np.asarray(indexed.convert("RGB")))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".pbm", ".gif"])
def test_one_bit_is_black_and_white_uint8(tmp_path, suffix):
    bits = ramp(1) > 100
    Image.fromarray(bits).save(tmp_path / f"a{suffix}")
    picture = images.read(tmp_path / f"a{suffix}")
    assert picture.pixels.dtype == np.uint8
    gray = picture.pixels if picture.pixels.ndim == 2 else picture.pixels[..., 0]
    np.testing.assert_array_equal(gray, np.where(bits, 255, 0))


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("key", [0, 1])
def test_transparent_gray_of_png(tmp_path, depth, key):
    values = np.array([0, 1, 1, 0, 1, 0, 0, 1])
    samples = np.array([values] * 8, dtype=">u2" if depth == 16 else np.uint8)
    if depth >= 8:
        rows = b"".join(b"\0" + row.tobytes() for row in samples)
    else:
        bits = (samples[:, :, None] >> np.arange(depth)[::-1]) & 1
        rows = b"".join(b"\0" + np.packbits(row).tobytes() for row in bits.reshape(8, -1))
    data = png(8, 8, depth, 0, rows, png_chunk(b"tRNS", struct.pack(">H", key)))
    picture = images.read(put(tmp_path, data))
    full = 65535 if depth == 16 else 255
    assert picture.pixels.shape == (8, 8, 2)
    assert picture.pixels.dtype == (np.uint16 if depth == 16 else np.uint8)
    np.testing.assert_array_equal(picture.pixels[0, :, 1], np.where(values == key, 0, full))


@pytest.mark.parametrize("depth", [8, 16])
def test_transparent_colour_of_png(tmp_path, depth):
    pixels = noise(f"uint{depth}", 3, 5, 6)
    rows = b"".join(b"\0" + row.astype(f">u{depth // 8}").tobytes() for row in pixels)
    key = struct.pack(">HHH", *(int(value) for value in pixels[2, 3]))
    picture = images.read(put(tmp_path, png(6, 5, depth, 2, rows, png_chunk(b"tRNS", key))))
    np.testing.assert_array_equal(picture.pixels[..., :3], pixels)
    assert picture.pixels[2, 3, 3] == 0
    assert np.count_nonzero(picture.pixels[..., 3]) == 29


def test_16_bit_pgm_is_stretched(tmp_path):
    values = np.array([[0, 512, 1023]], dtype=">u2")
    picture = images.read(put(tmp_path, b"P5 3 1\n# depth 10\n1023\n" + values.tobytes(), "a.pgm"))
    assert picture.pixels.dtype == np.uint16
    np.testing.assert_allclose(picture.pixels, values / 1023 * 65535, atol=1)


def test_16_bit_colour_ppm_is_refused(tmp_path):
    data = b"P6\n# a comment\n2 1 65535\n" + bytes(12)
    with pytest.raises(ImageError, match=r"values up to 65535.*convert it to 16-bit PNG or TIFF"):
        images.read(put(tmp_path, data, "a.ppm"))


def test_colour_ppm_with_an_endless_comment_is_refused(tmp_path):
    data = b"P6\n#" + b"x" * 5000 + b"\n2 1 65535\n" + bytes(12)
    with pytest.raises(ImageError, match="header is malformed, or longer"):
        images.read(put(tmp_path, data, "a.ppm"))


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_cmyk_is_refused(tmp_path, suffix):
    Image.fromarray(ramp()).convert("CMYK").save(tmp_path / f"a{suffix}")
    with pytest.raises(ImageError, match=r"its colours are .*convert it to RGB"):
        images.read(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp", ".tif"])
def test_first_of_several_pictures_is_read_with_a_warning(tmp_path, suffix):
    frames = [Image.fromarray(np.full((8, 8, 3), level, np.uint8)) for level in (0, 255)]
    options = {"lossless": True} if suffix == ".webp" else {}
    frames[0].save(tmp_path / f"a{suffix}", save_all=True, append_images=frames[1:], **options)
    with pytest.warns(UserWarning, match="several pictures; only the first is read"):
        picture = images.read(tmp_path / f"a{suffix}")
    assert picture.pixels[..., :3].shape == (8, 8, 3)
    assert picture.pixels[..., :3].max() == 0


def test_multi_picture_jpeg_is_its_main_picture(tmp_path):
    frames = [Image.fromarray(np.full((8, 8, 3), level, np.uint8)) for level in (0, 255)]
    frames[0].save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=frames[1:])
    assert images.read(tmp_path / "a.jpg").pixels.max() == 0


def test_warnings_made_errors_keep_their_words(tmp_path):
    frames = [Image.fromarray(np.full((8, 8, 3), level, np.uint8)) for level in (0, 255)]
    frames[0].save(tmp_path / "a.gif", save_all=True, append_images=frames[1:])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ImageError, match=r"a\.gif': the file holds several pictures"):
            images.read(tmp_path / "a.gif")


# --- TIFF ---


@pytest.mark.parametrize(
    "options",
    [
        {"tile": (16, 16)}, {"planarconfig": "separate"}, {"bigtiff": True}, {"byteorder": ">"},
        {"rowsperstrip": 3}, {"compression": "lzw", "predictor": True}, {"compression": "zstd"},
        {"compression": "packbits"}, {"tile": (16, 16), "planarconfig": "separate", "compression": "zlib"},
    ],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("channels", [3, 4])
def test_tiff_layouts(tmp_path, options, channels):
    pixels = noise("uint16", channels, 21, 35)
    stored = np.moveaxis(pixels, -1, 0) if "planarconfig" in options else pixels
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", **options)
    read = images.read(tmp_path / "a.tif").pixels
    assert read.dtype.isnative
    np.testing.assert_array_equal(read, pixels)


def test_tiff_white_is_zero(tmp_path):
    pixels = noise("uint16", 1)
    tifffile.imwrite(tmp_path / "a.tif", 65535 - pixels, photometric="miniswhite")
    np.testing.assert_array_equal(images.read(tmp_path / "a.tif").pixels, pixels)


def test_tiff_thumbnail_beside_the_picture_is_no_second_picture(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as tiff:
        tiff.write(noise(), photometric="rgb")
        tiff.write(noise(height=3, width=4), photometric="rgb", subfiletype=1)
    np.testing.assert_array_equal(images.read(tmp_path / "a.tif").pixels, noise())


@pytest.mark.parametrize(
    ("options", "channels", "message"),
    [
        ({"subfiletype": 1}, 3, "thumbnail, as in camera raw"),
        ({"compression": "jpeg"}, 3, "its compression is .*save it with one of: Deflate"),
        ({"compression": "lzma"}, 3, "its compression is .*LZMA"),
        ({"extrasamples": ["assocalpha"]}, 4, r"extra samples \[.*only straight alpha"),
        ({"extrasamples": ["unspecified"]}, 4, r"extra samples \[.*only straight alpha"),
        ({"extrasamples": ["unassalpha", "unspecified"]}, 5, "it has 5 channels"),
    ],
)
def test_tiff_kinds_refused(tmp_path, options, channels, message):
    tifffile.imwrite(tmp_path / "a.tif", noise("uint8", channels), photometric="rgb", **options)
    with pytest.raises(ImageError, match=message):
        images.read(tmp_path / "a.tif")


def test_tiff_of_complex_numbers_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.ones((4, 4), np.complex64))
    with pytest.raises(ImageError, match="complex64"):
        images.read(tmp_path / "a.tif")


def tiff_with(tmp_path, changes, payload=b"", **options):
    """A small TIFF with tag values overwritten; `payload` becomes its one strip."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((10, 10), np.uint8), metadata=None, **options)
    if payload:
        changes = changes | {273: path.stat().st_size, 279: len(payload)}
        path.write_bytes(path.read_bytes() + payload)
    with tifffile.TiffFile(path, mode="r+") as tiff:
        for tag, value in changes.items():
            tiff.pages[0].tags[tag].overwrite(value)
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {256: 100_000, 257: 100_000},
            "100000 × 100000 = 10000000000 pixels, more than max_pixels=200000000",
        ),
        ({256: 2**32 - 1, 257: 2**32 - 1}, "more than max_pixels"),
        ({256: 0}, "empty picture"),
        ({273: 10**6}, "parts of its pixels are missing"),
        ({279: 0}, "parts of its pixels are missing"),
        ({279: 10**6}, "parts of its pixels are missing"),
        ({278: 5}, "parts of its pixels are missing"),
    ],
)
def test_tiff_with_false_numbers(tmp_path, changes, message):
    with pytest.raises(ImageError, match=message):
        images.read(tiff_with(tmp_path, changes))


def test_tiff_with_giant_tiles(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.ones((10, 10), np.uint8), tile=(16, 16), metadata=None)
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as tiff:
        tiff.pages[0].tags[322].overwrite(2**20)
        tiff.pages[0].tags[323].overwrite(2**20)
    with pytest.raises(ImageError, match="more than max_pixels"):
        images.read(tmp_path / "a.tif")


def test_tiff_strip_that_unfolds_to_a_bomb(tmp_path):
    squeezer = zlib.compressobj(9)
    bomb = b"".join(squeezer.compress(bytes(1 << 20)) for _ in range(64)) + squeezer.flush()
    path = tiff_with(tmp_path, {}, bomb, compression="zlib")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ImageError, match="damaged"):
        images.read(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kilobytes


# --- metadata ---

CARRIERS = [
    (".png", "uint8", 3), (".png", "uint16", 3), (".png", "uint16", 4), (".jpg", "uint8", 3),
    (".tif", "uint8", 3), (".tif", "float32", 3), (".tif", "uint16", 4), (".webp", "uint8", 4),
]  # fmt: skip


@pytest.mark.parametrize(("suffix", "dtype", "channels"), CARRIERS)
def test_exif_profile_and_resolution_are_carried(tmp_path, suffix, dtype, channels):
    metadata = PictureMetadata(exif=exif_bytes(1), icc_profile=rgb_profile(), dpi=(300.0, 150.0))
    path = tmp_path / f"a{suffix}"
    images.write(path, noise(dtype, channels), metadata=metadata)
    read = images.read(path).metadata
    assert read.icc_profile == metadata.icc_profile
    tags, details, place = parsed(read.exif)
    expected, expected_details, expected_place = parsed(metadata.exif)
    assert (tags, details, place) == (expected, expected_details, expected_place)
    if suffix != ".tif":
        assert read.exif == metadata.exif
    if suffix != ".webp":
        assert read.dpi == pytest.approx((300, 150), abs=0.02)
    # A second trip changes nothing more.
    images.write(tmp_path / f"b{suffix}", images.read(path))
    assert images.read(tmp_path / f"b{suffix}").metadata == read


def test_pillow_finds_the_exif_of_a_tiff(tmp_path):
    images.write(tmp_path / "a.tif", noise(), metadata=PictureMetadata(exif=exif_bytes()))
    with Image.open(tmp_path / "a.tif") as image:
        exif = image.getexif()
        assert exif[ExifTags.Base.Make] == "Lens & Sons"
        assert exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.MakerNote] == bytes(range(200))
        assert exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSLatitudeRef] == "N"


def test_exif_of_a_tiff_by_pillow(tmp_path):
    Image.fromarray(ramp()).save(tmp_path / "a.tif", exif=exif_with(6).tobytes(), dpi=(72, 144))
    picture = images.read(tmp_path / "a.tif")
    tags, details, place = parsed(picture.metadata.exif)
    assert tags[ExifTags.Base.Model] == "M1"
    assert details[ExifTags.Base.FocalLength] == 3.5
    assert place[ExifTags.GPS.GPSLatitudeRef] == "N"
    assert picture.pixels.shape == (32, 24, 3)
    assert picture.metadata.dpi == (144, 72)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".webp", ".bmp"])
def test_metadata_can_be_left_out(tmp_path, suffix):
    metadata = PictureMetadata(exif=exif_bytes(), icc_profile=rgb_profile(), dpi=(300.0, 300.0))
    picture = Picture(ramp(), metadata)
    images.write(tmp_path / f"a{suffix}", picture, metadata=PictureMetadata())
    read = images.read(tmp_path / f"a{suffix}").metadata
    assert (read.exif, read.icc_profile) == (None, None)


@pytest.mark.parametrize("suffix", [".bmp", ".ppm"])
def test_formats_without_metadata_leave_it_out(tmp_path, suffix):
    metadata = PictureMetadata(exif=exif_bytes(), icc_profile=rgb_profile(), dpi=(300.0, 300.0))
    images.write(tmp_path / f"a{suffix}", Picture(ramp(), metadata))
    np.testing.assert_array_equal(images.read(tmp_path / f"a{suffix}").pixels, ramp())


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
def test_profile_for_other_colours_is_left_out(tmp_path, suffix):
    images.write(tmp_path / f"a{suffix}", ramp(1), metadata=PictureMetadata(icc_profile=rgb_profile()))
    assert images.read(tmp_path / f"a{suffix}").metadata.icc_profile is None


def test_picture_with_new_pixels_keeps_its_metadata(tmp_path):
    Image.fromarray(ramp()).save(tmp_path / "a.jpg", exif=exif_with(3), icc_profile=rgb_profile())
    picture = images.read(tmp_path / "a.jpg")
    images.write(tmp_path / "b.png", dataclasses.replace(picture, pixels=picture.pixels[:5]))
    copy = images.read(tmp_path / "b.png")
    assert copy.pixels.shape == (5, 32, 3)
    assert copy.metadata.exif == picture.metadata.exif
    assert copy.metadata.icc_profile == picture.metadata.icc_profile


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".webp"])
@pytest.mark.parametrize("orientation", [None, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9])
def test_orientation_is_applied_once(tmp_path, suffix, orientation):
    path = tmp_path / f"a{suffix}"
    options = {"lossless": True} if suffix == ".webp" else {}
    Image.fromarray(ramp()).save(path, exif=exif_with(orientation).tobytes(), **options)
    with Image.open(path) as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    picture = images.read(path)
    np.testing.assert_array_equal(picture.pixels, expected)
    tags, details, _ = parsed(picture.metadata.exif)
    assert tags.get(ExifTags.Base.Orientation, 1) == 1
    assert details[ExifTags.Base.MakerNote] == bytes(range(200))
    # And not again, by us or by others, after writing.
    images.write(tmp_path / "b.png", picture)
    np.testing.assert_array_equal(images.read(tmp_path / "b.png").pixels, expected)
    with Image.open(tmp_path / "b.png") as image:
        np.testing.assert_array_equal(np.asarray(ImageOps.exif_transpose(image)), expected)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(("suffix", "dtype", "channels"), [(".tif", "float32", 1), (".png", "uint16", 3)])
def test_orientation_of_deep_pictures(tmp_path, suffix, dtype, channels, orientation):
    levels = ramp()[..., 0]
    expected = ImageOps.exif_transpose(turned(levels, orientation))
    pixels = levels.astype(dtype) if channels == 1 else np.stack([levels] * 3, -1).astype(dtype)
    if suffix == ".tif":
        tifffile.imwrite(tmp_path / "a.tif", pixels, extratags=[(274, 3, 1, orientation, True)])
    else:
        images.write(tmp_path / "a.png", pixels, metadata=PictureMetadata(exif=exif_bytes(orientation)))
    read = images.read(tmp_path / f"a{suffix}").pixels
    np.testing.assert_array_equal(read if channels == 1 else read[..., 1], np.asarray(expected))


def turned(levels, orientation):
    image = Image.fromarray(levels)
    image.getexif()[ExifTags.Base.Orientation] = orientation
    return image


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".webp"])
def test_given_orientation_is_written(tmp_path, suffix):
    images.write(tmp_path / f"a{suffix}", ramp(), metadata=PictureMetadata(exif=exif_bytes(6)))
    with Image.open(tmp_path / f"a{suffix}") as image:
        assert image.getexif()[ExifTags.Base.Orientation] == 6
    assert images.read(tmp_path / f"a{suffix}").pixels.shape == (32, 24, 3)


def test_only_the_orientation_changes_in_the_exif(tmp_path):
    for order in "<>":
        exif = exif_with(6)
        exif.endian = order
        block = exif.tobytes()
        path = put(tmp_path, encoded(ramp(), "JPEG", exif=block), "a.jpg")
        kept = images.read(path).metadata.exif
        changed = [i for i, (old, new) in enumerate(zip(block[6:], kept, strict=True)) if old != new]
        assert len(changed) == 1


def laid_out(entries, order="<", at=8):
    """A directory of entries (tag, type, count, value), the value bytes or the entries of another directory."""
    table, values = struct.pack(order + "H", len(entries)), b""
    values_at = at + 2 + 12 * len(entries) + 4
    for tag, kind, count, value in entries:
        nested = not isinstance(value, bytes)
        if nested:
            value = laid_out(value, order, values_at + len(values))
        inline = value.ljust(4, b"\0")
        if nested or len(value) > 4:
            inline = struct.pack(order + "I", values_at + len(values))
            values += value + b"\0" * (len(value) % 2)
        table += struct.pack(order + "HHI4s", tag, kind, count, inline)
    return table + bytes(4) + values


def exif_of(*entries, order="<"):
    return (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8) + laid_out(entries, order)


def typed(block, offset=None, owner=None):
    """Type and value of each entry of an EXIF block, and of the directories within."""
    found = ImageFileDirectory_v2(block[:8], group=owner)
    file = io.BytesIO(block)
    file.seek(found.next if offset is None else offset)
    found.load(file)
    return {
        tag: typed(block, value, tag) if tag in (34665, 34853, 40965) else (found.tagtype[tag], value)
        for tag, value in found.items()
    }


@pytest.mark.parametrize("order", ["<", ">"])
def test_directories_keep_types_and_values_through_a_tiff(tmp_path, order):
    details = (
        (33434, 5, 1, struct.pack(order + "II", 1, 250)),  # an exposure time, RATIONAL
        (37380, 10, 1, struct.pack(order + "ii", -1, 3)),  # an exposure bias, SRATIONAL
        (37500, 7, 5, b"maker"),
        (40962, 3, 1, struct.pack(order + "H", 640)),
        (40965, 4, 1, ((1, 2, 4, b"R98\0"),)),
        (42036, 2, 10, "50 mm ƒ2\0".encode()),
    )
    place = ((1, 2, 2, b"N\0"), (2, 5, 3, struct.pack(order + "6I", 51, 1, 30, 1, 25, 2)))
    text = "Objektiv & Söhne\0".encode()
    exif = exif_of((271, 2, len(text), text), (34665, 4, 1, details), (34853, 4, 1, place), order=order)
    expected = typed(exif)
    assert expected[271] == (2, text[:-1].decode("latin-1"))
    images.write(tmp_path / "a.tif", noise(), metadata=PictureMetadata(exif=exif))
    kept = images.read(tmp_path / "a.tif").metadata.exif
    assert kept[:2] == exif[:2]
    assert typed(kept) == expected
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), noise())


def test_exif_whose_entries_share_their_bytes_takes_no_memory(tmp_path):
    size, count = 1_000_000, 60_000
    table = b"".join(struct.pack("<HHII", tag, 2, size, 8) for tag in range(count))
    block = b"II*\0\x08\0\0\0" + struct.pack("<H", count) + table + bytes(4 + size)
    with pytest.warns(UserWarning, match="EXIF is damaged and left out"):
        images.write(tmp_path / "a.tif", noise(), metadata=PictureMetadata(exif=block))
    np.testing.assert_array_equal(images.read(tmp_path / "a.tif").pixels, noise())
    huge = exif_of((271, 2, 17_000_000, bytes(17_000_000)))
    with pytest.warns(UserWarning, match="EXIF is damaged and left out .*more than 16000000 bytes"):
        images.write(tmp_path / "b.tif", noise(), metadata=PictureMetadata(exif=huge))


def test_directories_that_hold_themselves_end(tmp_path):
    block = bytearray(exif_of((34665, 4, 1, ((40965, 4, 1, ((1, 2, 4, b"R98\0"),)),))))
    for place in range(8, len(block) - 12, 2):
        for tag in (34665, 40965):
            if struct.unpack_from("<H", block, place) == (tag,):
                struct.pack_into("<I", block, place + 8, 8)  # both point back at the main directory
    images.write(tmp_path / "a.tif", noise(), metadata=PictureMetadata(exif=bytes(block)))
    assert images.read(tmp_path / "a.tif").pixels.shape == (11, 13, 3)


def test_what_is_whole_of_a_damaged_exif_is_kept(tmp_path):
    whole = exif_of((271, 2, 6, b"Maker\0"), (272, 2, 8, b"Model 1\0"))
    with pytest.warns(UserWarning, match="the EXIF is damaged and left out in part"):
        images.write(tmp_path / "a.tif", noise(), metadata=PictureMetadata(exif=whole[:-4]))
    assert typed(images.read(tmp_path / "a.tif").metadata.exif) == {271: (2, "Maker")}


def test_damaged_exif_is_left_out_of_a_tiff(tmp_path):
    with pytest.warns(UserWarning, match="the EXIF is damaged and left out"):
        images.write(tmp_path / "a.tif", noise(), metadata=PictureMetadata(exif=b"nonsense"))
    assert images.read(tmp_path / "a.tif").metadata.exif is None


def test_orientation_of_xmp_is_applied(tmp_path):
    xmp = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
    path = put(tmp_path, encoded(ramp(), "JPEG", xmp=xmp), "a.jpg")
    assert images.read(path).pixels.shape == (32, 24, 3)


@pytest.mark.parametrize(
    "block",
    [
        b"",
        b"nonsense",
        b"II*\0",
        b"II*\0\xff\xff\xff\xff",
        b"MM\0*\0\0\0\x08\xff\xff" + bytes(30),
        b"Exif\0\0" * 3,
    ],
)
def test_malformed_exif_does_not_hide_the_pixels(tmp_path, block):
    data = encoded(ramp(), "PNG", exif=b"Exif\0\0" + block) if block else encoded(ramp(), "PNG")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        picture = images.read(put(tmp_path, data))
    np.testing.assert_array_equal(picture.pixels, ramp())


@pytest.mark.parametrize("dpi", [(0.0, 0.0), (-1.0, 72.0), (float("nan"), 72.0)])
def test_senseless_resolution_is_left_out(dpi):
    from jaxlens.images.pillow_files import checked_dpi

    assert checked_dpi(dpi) is None
    assert checked_dpi(None) is None


def test_exif_too_long_for_jpeg(tmp_path):
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "x" * 70_000
    metadata = PictureMetadata(exif=exif.tobytes())
    with pytest.raises(ImageError, match=r"a\.jpg': EXIF data is too long"):
        images.write(tmp_path / "a.jpg", ramp(), metadata=metadata)
    assert listing(tmp_path) == []
    images.write(tmp_path / "a.png", ramp(), metadata=metadata)


# --- broken and hostile files ---


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("none.png", None, r"cannot read '.*none\.png': there is no such file; check the name"),
        ("file/a.png", lambda path: path.parent.write_text("x"), "there is no such file"),
        ("folder.png", lambda path: path.mkdir(), "it is a folder; give one file"),
        ("pipe.png", os.mkfifo, "not a regular file"),
        ("empty.png", lambda path: path.touch(), r"the file is empty \(0 bytes\)"),
        (
            "text.png",
            lambda path: path.write_text("a, b\n1, 2\n"),
            "not a picture of a known format .*b'a, b",
        ),
        ("a.eps", lambda path: path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n"), "not a picture of a known"),
        ("a.svg", lambda path: path.write_text("<svg/>"), "not a picture of a known format"),
        ("a.npy", lambda path: np.save(path, np.ones((2, 2))), "not a picture of a known format"),
        ("loop.png", lambda path: path.symlink_to(path), "the system says"),
        ("null\0.png", None, "null (byte|character)"),
    ],
)
def test_files_that_are_no_pictures(tmp_path, name, make, message):
    path = tmp_path / name
    if make is not None:
        make(path)
    with pytest.raises(ImageError, match=message):
        images.read(path)


def test_file_that_may_not_be_read(tmp_path, monkeypatch):
    path = put(tmp_path, encoded(ramp(), "PNG"))

    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(ImageError, match=r"picture\.png': you may not read it; change its permissions") as caught:
        images.read(path)
    assert isinstance(caught.value.__cause__, PermissionError)


def written(tmp_path, suffix, dtype="uint8", channels=3, **options):
    path = tmp_path / f"whole{suffix}"
    # EXIF would move a TIFF's directory to its end, where every cut is plain to see.
    exif = exif_bytes() if suffix != ".tif" else None
    metadata = PictureMetadata(exif=exif, dpi=(300.0, 300.0))
    images.write(path, noise(dtype, channels, 5, 6), metadata=metadata, **options)
    return path.read_bytes()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("suffix", "dtype", "channels"),
    [
        (".png", "uint8", 3), (".png", "uint16", 1), (".png", "uint16", 3), (".jpg", "uint8", 3),
        (".tif", "uint8", 3), (".tif", "float32", 3), (".bmp", "uint8", 3), (".webp", "uint8", 3),
        (".ppm", "uint8", 3), (".pgm", "uint16", 1),
    ],
)  # fmt: skip
def test_truncated_at_every_length(tmp_path, suffix, dtype, channels):
    """A file cut anywhere is refused, unless all its pixels are there and come out right."""
    data = written(tmp_path, suffix, dtype, channels)
    whole = images.read(tmp_path / f"whole{suffix}").pixels
    path = tmp_path / f"cut{suffix}"
    refused = 0
    for length in range(len(data)):
        path.write_bytes(data[:length])
        try:
            pixels = images.read(path).pixels
        except ImageError:
            refused += 1
        else:
            np.testing.assert_array_equal(pixels, whole, err_msg=f"cut to {length} of {len(data)} bytes")
    assert refused >= len(data) * 0.3


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("options", [{}, {"compression": "tiff_lzw"}, {"compression": "packbits"}], ids=str)
def test_truncated_tiff_of_pillow(tmp_path, options):
    data = encoded(noise(height=5, width=6), "TIFF", **options)
    whole = images.read(put(tmp_path, data, "whole.tif")).pixels
    for length in range(len(data)):
        path = put(tmp_path, data[:length], "cut.tif")
        try:
            pixels = images.read(path).pixels
        except ImageError:
            continue
        np.testing.assert_array_equal(pixels, whole, err_msg=f"cut to {length} of {len(data)} bytes")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("suffix", "dtype", "channels"),
    [(".png", "uint8", 3), (".png", "uint16", 3), (".jpg", "uint8", 3), (".tif", "uint16", 3),
     (".webp", "uint8", 3), (".bmp", "uint8", 3)],
)  # fmt: skip
def test_damaged_files_raise_nothing_else(tmp_path, suffix, dtype, channels):
    data = written(tmp_path, suffix, dtype, channels)
    rng = np.random.default_rng(3)
    for _ in range(150):
        damaged = np.frombuffer(data, np.uint8).copy()
        places = rng.integers(0, min(len(data), 400), 3)
        damaged[places] = rng.integers(0, 256, 3)
        with contextlib.suppress(ImageError):
            images.read(put(tmp_path, damaged.tobytes(), f"damaged{suffix}"), max_pixels=1_000_000)


def bmp_header(width, height):
    return b"BM" + struct.pack("<IHHI IiiHHIIiiII", 0, 0, 0, 54, 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.png", png(100_000, 100_000, 8, 2)),
        ("b.png", png(100_000, 100_000, 16, 6)),
        ("c.png", png(2**31 - 1, 2**31 - 1, 8, 2)),
        ("a.bmp", bmp_header(100_000, 100_000)),
        ("a.ppm", b"P6 100000 100000 255\n"),
        (
            "a.gif",
            b"GIF89a" + struct.pack("<HHBBB", 65535, 65535, 0, 0, 0) + b",\0\0\0\0\xff\xff\xff\xff\0\x02\0;",
        ),
    ],
)
def test_header_of_a_huge_picture_is_refused_cheaply(tmp_path, name, data):
    path = put(tmp_path, data, name)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ImageError, match="more than max_pixels=200000000; if you trust the file"):
        images.read(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kilobytes


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp", ".bmp", ".ppm"])
def test_limit_is_counted_in_pixels(tmp_path, suffix):
    images.write(tmp_path / f"a{suffix}", noise())
    images.read(tmp_path / f"a{suffix}", max_pixels=11 * 13)
    with pytest.raises(ImageError, match="13 × 11 = 143 pixels, more than max_pixels=142"):
        images.read(tmp_path / f"a{suffix}", max_pixels=11 * 13 - 1)


def test_own_limit_replaces_that_of_pillow(tmp_path, monkeypatch):
    images.write(tmp_path / "a.png", noise())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    assert images.read(tmp_path / "a.png").pixels.shape == (11, 13, 3)


def test_limit_of_pillow_on_webp_is_told(tmp_path, monkeypatch):
    images.write(tmp_path / "a.webp", noise())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    with pytest.raises(ImageError, match="declares a huge picture"):
        images.read(tmp_path / "a.webp")


def test_symbolic_links_are_followed(tmp_path):
    images.write(tmp_path / "a.png", noise())
    (tmp_path / "b.png").symlink_to(tmp_path / "a.png")
    np.testing.assert_array_equal(images.read(tmp_path / "b.png").pixels, noise())


@pytest.mark.parametrize(("suffix", "dtype"), [(".tif", "uint8"), (".png", "uint16")])
def test_a_missing_extra_is_named(tmp_path, monkeypatch, suffix, dtype):
    images.write(tmp_path / f"a{suffix}", noise(dtype))
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(ImageError, match=r"takes imagecodecs: pip install 'jaxlens\[codecs\]'"):
        images.read(tmp_path / f"a{suffix}")
    with pytest.raises(ImageError, match=r"takes imagecodecs: pip install 'jaxlens\[codecs\]'"):
        images.write(tmp_path / "b.png", noise("uint16"))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_a_tiff_written_without_the_extra_is_read_without_it(tmp_path, monkeypatch, dtype):
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    images.write(tmp_path / "a.tif", noise(dtype), metadata=PictureMetadata(exif=exif_bytes()))
    read = images.read(tmp_path / "a.tif")
    np.testing.assert_array_equal(read.pixels, noise(dtype))
    assert parsed(read.metadata.exif) == parsed(exif_bytes())


# --- writing ---


@pytest.mark.parametrize("suffix", WRITABLE_SUFFIXES)
@pytest.mark.parametrize("dtype", EVERY_DTYPE)
def test_pixels_a_format_cannot_hold(tmp_path, suffix, dtype):
    known = next(known for known in FORMATS if suffix in known.suffixes)
    for channels in set(range(1, 5)) - set(known.channels.get(dtype, ())):
        shape = (4, 5) if channels == 1 else (4, 5, channels)
        with pytest.raises(ImageError, match=rf"does not hold {dtype} .*; (write \.|convert the pixels)"):
            images.write(tmp_path / f"a{suffix}", np.zeros(shape, dtype))
    assert listing(tmp_path) == []


def test_the_message_says_what_to_do(tmp_path):
    with pytest.raises(ImageError) as caught:
        images.write(tmp_path / "a.jpg", noise("uint16", 4))
    message = "JPEG does not hold uint16 RGBA; write .png or .tif, or make them uint8 (0 to 255), or drop the alpha"
    assert str(caught.value) == f"cannot write '{tmp_path}/a.jpg': {message} channel"


@pytest.mark.parametrize("shape", [(), (3,), (2, 3, 5), (2, 3, 3, 3), (0, 3), (2, 0, 3), (2, 3, 0)])
def test_shapes_that_are_no_pictures(tmp_path, shape):
    with pytest.raises(ImageError, match=r"the pixels have shape \(.*a picture is \(height, width\)"):
        images.write(tmp_path / "a.png", np.zeros(shape, np.uint8))


@pytest.mark.parametrize("name", ["a", "a.gif", "a.pbm", "a.jp2", "a.npy", ".png"])
def test_suffixes_that_are_not_written(tmp_path, name):
    with pytest.raises(ImageError, match=r"no picture is written with suffix .*use one of \.bmp, \.jpeg, \.jpg"):
        images.write(tmp_path / name, ramp())


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_side_too_long_for_the_format(tmp_path, suffix):
    with pytest.raises(ImageError, match=r"holds at most \d+ pixels a side, the picture is 70000 × 1; write"):
        images.write(tmp_path / f"a{suffix}", np.zeros((1, 70_000, 3), np.uint8))


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_quality_trades_size(tmp_path, suffix):
    pixels = noise(height=64, width=64)
    sizes = []
    for quality in (10, 60, 100):
        images.write(tmp_path / f"a{suffix}", pixels, quality=quality, overwrite=True)
        sizes.append((tmp_path / f"a{suffix}").stat().st_size)
    assert sizes == sorted(set(sizes))


def test_jpeg_default_is_full_colour_at_95(tmp_path):
    images.write(tmp_path / "default.jpg", ramp())
    images.write(tmp_path / "95.jpg", ramp(), quality=95)
    assert (tmp_path / "default.jpg").read_bytes() == (tmp_path / "95.jpg").read_bytes()
    with Image.open(tmp_path / "default.jpg") as image:
        assert [layer[1:3] for layer in image.layer] == [(1, 1)] * 3


@pytest.mark.parametrize(
    ("suffix", "quality", "message"),
    [
        (".png", 90, "PNG has no quality"),
        (".jpg", 0, "quality must be 1 to 100, got 0"),
        (".jpg", 101, "got 101"),
    ],
)
def test_bad_quality(tmp_path, suffix, quality, message):
    with pytest.raises(ImageError, match=message):
        images.write(tmp_path / f"a{suffix}", ramp(), quality=quality)


@pytest.mark.parametrize("suffix", WRITABLE_SUFFIXES)
def test_existing_file_needs_overwrite(tmp_path, suffix):
    path = put(tmp_path, b"precious", f"a{suffix}")
    pixels = ramp(1) if suffix == ".pgm" else ramp()
    with pytest.raises(ImageError, match=rf"a\{suffix}' exists; pass overwrite=True"):
        images.write(path, pixels)
    assert path.read_bytes() == b"precious"
    images.write(path, pixels, overwrite=True)
    assert images.read(path).pixels.shape == pixels.shape
    assert listing(tmp_path) == [path.name]


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(ImageError, match=r"the folder '.*nowhere' does not exist; make it first"):
        images.write(tmp_path / "nowhere" / "a.png", ramp())
    assert listing(tmp_path) == []


@pytest.mark.parametrize("failure", [RuntimeError("boom"), MemoryError(), KeyboardInterrupt()])
@pytest.mark.parametrize("existing", [False, True])
def test_failure_while_encoding_leaves_nothing(tmp_path, monkeypatch, failure, existing):
    if existing:
        put(tmp_path, b"precious", "a.png")

    def fail(file, *arguments):
        file.write(b"half a picture")
        raise failure

    monkeypatch.setattr(jaxlens.images.writing, "_encode", fail)
    kind = type(failure) if isinstance(failure, KeyboardInterrupt) else ImageError
    with pytest.raises(kind):
        images.write(tmp_path / "a.png", ramp(), overwrite=True)
    assert listing(tmp_path) == (["a.png"] if existing else [])
    assert not existing or (tmp_path / "a.png").read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("suffix", "dtype"), [(".png", "uint8"), (".png", "uint16"), (".jpg", "uint8"), (".tif", "uint8"),
                          (".webp", "uint8"), (".bmp", "uint8"), (".ppm", "uint8")],
)  # fmt: skip
def test_no_space_leaves_nothing(tmp_path, suffix, dtype):
    """The system cuts the file at a size limit, as a full disk would."""
    pixels = noise(dtype, 3, 200, 200)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(ImageError, match="cannot write") as caught:
            images.write(tmp_path / f"a{suffix}", pixels)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert isinstance(caught.value.__cause__, OSError)
    assert listing(tmp_path) == []


def test_permissions_are_those_of_the_umask(tmp_path):
    previous = os.umask(0o022)
    try:
        images.write(tmp_path / "a.png", ramp())
    finally:
        os.umask(previous)
    assert stat.S_IMODE((tmp_path / "a.png").stat().st_mode) == 0o644


# --- folders, imports ---


def test_list_images(tmp_path):
    for name in ("b.png", "a.JPG", "c.tiff", "10.png", "9.png", "notes.txt", ".hidden.png", "a.png.bak"):
        (tmp_path / name).touch()
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "link.png").symlink_to(tmp_path / "b.png")
    (tmp_path / "dangling.png").symlink_to(tmp_path / "nothing")
    names = ["10.png", "9.png", "a.JPG", "b.png", "c.tiff", "link.png"]
    assert list_images(tmp_path) == [tmp_path / name for name in names]
    assert set(WRITABLE_SUFFIXES) < set(READABLE_SUFFIXES)


def test_list_images_of_no_folder(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ImageError, match="file': it is not a folder"):
        list_images(tmp_path / "file")
    with pytest.raises(ImageError, match="none': the system says"):
        list_images(tmp_path / "none")


def test_import_is_light():
    # A bare parent package stands in for jaxlens, whose own __init__ imports jax.
    code = f"""
import sys, types
sys.modules["jaxlens"] = types.ModuleType("jaxlens")
sys.modules["jaxlens"].__path__ = {list(jaxlens.__path__)!r}
import jaxlens.images
print([name for name in ("jax", "PIL", "imageio", "tifffile", "imagecodecs") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


needs_avif = pytest.mark.skipif(not features.check("avif"), reason="Pillow without AVIF")


@needs_avif
@pytest.mark.parametrize("channels", [3, 4])
def test_avif_is_read(tmp_path, channels):
    y, x = np.mgrid[:40, :56]
    pixels = np.stack([3 * x, 4 * y, 2 * (x + y), 255 - 2 * x][:channels], axis=-1).astype(np.uint8)
    path = tmp_path / "a.avif"
    Image.fromarray(pixels).save(path, quality=100, subsampling="4:4:4")
    picture = images.read(path)
    assert picture.metadata.format == "AVIF"
    assert picture.pixels.shape == pixels.shape
    assert np.abs(picture.pixels.astype(int) - pixels).max() <= 4
    assert list_images(tmp_path) == [path]
    with pytest.raises(ImageError, match="max_pixels=100"):
        images.read(path, max_pixels=100)
    with pytest.raises(ImageError, match=re.escape("no picture is written with suffix '.avif'")):
        images.write(tmp_path / "b.avif", picture)


@needs_avif
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_avif_is_upright(tmp_path, orientation):
    y, x = np.mgrid[:40, :56]
    pixels = np.stack([3 * x, 4 * y, 2 * (x + y)], axis=-1).astype(np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(tmp_path / "a.avif", quality=100, subsampling="4:4:4", exif=exif)
    expected = ImageOps.exif_transpose(Image.open(tmp_path / "a.avif"))
    found = images.read(tmp_path / "a.avif")
    np.testing.assert_array_equal(found.pixels, np.asarray(expected))
    assert found.pixels.shape[:2] == ((56, 40) if orientation > 4 else (40, 56))
    if found.metadata.exif:
        assert reset_orientation(found.metadata.exif)[0] == 1


@needs_avif
def test_avif_of_more_bits_is_refused(tmp_path):
    path = tmp_path / "a.avif"
    Image.new("RGB", (16, 16)).save(path)
    data = bytearray(path.read_bytes())
    data[data.index(b"av1C") + 6] |= 0x40
    path.write_bytes(data)
    with pytest.raises(ImageError, match="more than 8 bits"):
        images.read(path)


def test_avif_without_its_decoder_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.delitem(features.modules, "avif", raising=False)
    (tmp_path / "a.avif").write_bytes(b"\0\0\0\x20ftypavif\0\0\0\0")
    with pytest.raises(ImageError, match=re.escape("pip install --upgrade 'pillow>=11.3'")):
        images.read(tmp_path / "a.avif")


def test_heif_says_how_to_convert_it(tmp_path):
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0")
    with pytest.raises(ImageError, match=r"it is HEIF.*pillow-heif"):
        images.read(tmp_path / "a.heic")
