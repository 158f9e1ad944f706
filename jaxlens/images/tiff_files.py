"""TIFF, read and written by tifffile: Pillow knows neither 16-bit nor float colour."""

import math
import struct
import warnings
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from jaxlens.images.picture import ImageError, PictureMetadata, check_size
from jaxlens.images.pillow_files import checked_dpi

if TYPE_CHECKING:
    from PIL.Image import Exif
    from tifffile import TiffFile, TiffPage

# Each of these stops at the size the header declares, whatever the compressed bytes would unfold to. JPEG in
# TIFF has a header of its own, and LZMA a dictionary of any size: both could ask for gigabytes.
_COMPRESSIONS = {1: "none", 5: "LZW", 8: "Deflate", 32946: "Deflate", 32773: "PackBits", 50000: "Zstandard"}
_MINISWHITE, _MINISBLACK, _RGB, _PALETTE = 0, 1, 2, 3
_STRAIGHT_ALPHA = 2
_DNG_VERSION = 50706
# Tags that change what the pixels are; tifffile goes on without those it cannot read.
_PIXEL_TAGS = frozenset([256, 257, 258, 259, 262, 266, 273, 277, 278, 279, 284, 317, 320, *range(322, 326), 338, 339])
# Descriptive tags: Make, Model, Software, DateTime, Artist, HostComputer, Copyright. ImageDescription is left
# out: in TIFF it is where programs put descriptions of the array, which a warp would make false.
_TEXT_TAGS = (271, 272, 305, 306, 315, 316, 33432)
_ORIENTATION, _EXIF_DIRECTORY, _GPS_DIRECTORY, _INTEROP_DIRECTORY = 274, 34665, 34853, 40965


def read_tiff(file: BinaryIO, max_pixels: int) -> tuple[np.ndarray, PictureMetadata, int]:
    """Decode the first page of a TIFF or BigTIFF.

    Args:
        file: Open at its start.
        max_pixels: Largest height × width accepted, in pixels; also for one tile.

    Returns:
        The pixels as stored, channels last; the metadata, its orientation reset; the orientation to apply.

    Raises:
        ImageError: too large, incomplete, or of a kind that is refused. Damage raises what tifffile raises.
    """
    import tifffile

    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages.first
        check_size(page.imagewidth, page.imagelength, max_pixels)
        if page.is_tiled:
            check_size(page.tilewidth, page.tilelength, max_pixels)
        _check_tags(tiff, page)
        _check_kind(page)
        _check_complete(page, tiff.filehandle.size)
        if _has_second_picture(tiff):
            warnings.warn("the file holds several pictures; only the first is read", stacklevel=4)
        pixels = _pixels(page)
        orientation = int(page.tags.valueof(_ORIENTATION, 1))
        metadata = PictureMetadata(
            exif=None if tiff.is_bigtiff else _read_exif(file),
            icc_profile=page.iccprofile or None,
            dpi=_read_dpi(page),
            format="TIFF",
        )
    return pixels, metadata, orientation if 1 <= orientation <= 8 else 1


def write_tiff(file: BinaryIO, pixels: np.ndarray, metadata: PictureMetadata) -> None:
    """Encode a TIFF, Deflate-compressed, with straight alpha.

    Args:
        file: Open for writing and reading, empty.
        pixels: `(height, width)` or `(height, width, 2 to 4)`.
        metadata: EXIF, profile and resolution to put in.
    """
    import imageio.v3 as iio

    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    exif = _parse_exif(metadata.exif)
    options: dict[str, Any] = {
        "photometric": "rgb" if channels >= 3 else "minisblack",
        "planarconfig": "contig" if channels > 1 else None,
        "extrasamples": ["unassalpha"] if channels in (2, 4) else None,
        "compression": "zlib",
        # Differences of neighbours compress integers well; for floats it is an extension few readers know.
        "predictor": pixels.dtype.kind in "ui",
        "iccprofile": metadata.icc_profile,
        "extratags": _text_tags(exif) + [(tag, 4, 1, 0, True) for tag in _directories(exif)],
        # No date, no name of the writer, no description: equal pictures make equal files.
        "metadata": None,
        "software": False,
    }
    if metadata.dpi:
        options |= {"resolution": metadata.dpi, "resolutionunit": "inch"}
    iio.imwrite(file, pixels, plugin="tifffile", extension=".tif", **options)
    if exif is not None:
        _append_directories(file, exif)


def _check_tags(tiff: "TiffFile", page: "TiffPage") -> None:
    """Refuse a page of which tifffile dropped a tag that decides what the pixels are."""
    handle, layout = tiff.filehandle, tiff.tiff
    handle.seek(page.offset)
    (count,) = struct.unpack(layout.tagnoformat, handle.read(layout.tagnosize))
    entries = handle.read(count * layout.tagsize)
    codes = {
        struct.unpack_from(layout.byteorder + "H", entries, at)[0] for at in range(0, len(entries), layout.tagsize)
    }
    lost = sorted(code for code in codes & _PIXEL_TAGS if code not in page.tags)
    if lost:
        raise ImageError(f"its tags {lost} are damaged or cut off; make the file anew")


def _check_kind(page: "TiffPage") -> None:
    if page.is_reduced or _DNG_VERSION in page.tags:
        raise ImageError("its first page is a thumbnail, as in camera raw; develop it to TIFF or PNG first")
    if page.compression not in _COMPRESSIONS:
        known = ", ".join(sorted(set(_COMPRESSIONS.values())))
        raise ImageError(f"its compression is {page.compression!r}; save it with one of: {known}")
    if page.photometric not in (_MINISWHITE, _MINISBLACK, _RGB, _PALETTE):
        raise ImageError(f"its colours are {page.photometric!r}; convert it to RGB in an image editor")
    if page.axes not in ("YX", "YXS", "SYX"):
        raise ImageError(f"its axes are {page.axes!r}; save one plane picture of it")
    if page.bitspersample not in (1, 8, 16, 32, 64) or page.dtype is None or page.dtype.kind not in "buif":
        raise ImageError(f"its samples have {page.bitspersample} bits ({page.dtype}); save it with 8, 16 or 32")
    if page.photometric == _MINISWHITE and page.dtype.kind not in "bu":
        raise ImageError(f"its white is 0, with {page.dtype} samples; save it with black as 0")
    _check_channels(page)


def _check_channels(page: "TiffPage") -> None:
    extra = page.samplesperpixel - (3 if page.photometric == _RGB else 1)
    # OpenCV and others write RGBA without declaring the fourth channel; every reader takes it as alpha.
    declared = tuple(page.extrasamples)
    straight = declared in ((), (_STRAIGHT_ALPHA,))
    if extra not in (0, 1) or (extra == 1 and (not straight or page.photometric == _PALETTE)):
        raise ImageError(
            f"it has {page.samplesperpixel} channels with extra samples {list(declared)}, where only "
            "straight alpha (2) is read; save it without them, or with straight (unassociated) alpha"
        )


def _check_complete(page: "TiffPage", file_size: int) -> None:
    """Refuse missing strips and tiles, which tifffile would leave blank."""
    segments = list(zip(page.dataoffsets, page.databytecounts, strict=False))
    complete = len(segments) == math.prod(page.chunked) and len(page.dataoffsets) == len(page.databytecounts)
    inside = all(size > 0 and 0 < offset <= file_size - size for offset, size in segments)
    if not complete or not inside:
        raise ImageError("parts of its pixels are missing; the file is truncated, copy or download it again")


def _has_second_picture(tiff: "TiffFile") -> bool:
    try:
        return not tiff.pages.get(1, aspage=True).is_reduced
    except IndexError:
        return False


def _pixels(page: "TiffPage") -> np.ndarray:
    pixels = page.asarray()
    if page.axes == "SYX":
        pixels = np.moveaxis(pixels, 0, -1)
    if page.photometric == _PALETTE:
        # The TIFF 6.0 colour map has 16 bits; its indices have at most 8, and so had the colours.
        colours = np.asarray(page.colormap)
        return (colours >> 8).astype(np.uint8).T[pixels]
    if pixels.dtype == np.bool_:
        pixels = pixels.astype(np.uint8) * np.uint8(255)
    if page.photometric == _MINISWHITE:
        pixels = np.array(pixels)
        gray = pixels[..., 0] if pixels.ndim == 3 else pixels
        np.subtract(np.iinfo(pixels.dtype).max, gray, out=gray)
    return pixels.astype(pixels.dtype.newbyteorder("="), copy=False)


def _read_dpi(page: "TiffPage") -> tuple[float, float] | None:
    centimetres, inches = 3, 2
    unit = page.tags.valueof(296, inches)
    if 282 not in page.tags or 283 not in page.tags or unit not in (centimetres, inches):
        return None
    per_inch = 2.54 if unit == centimetres else 1.0
    fractions = (page.tags.valueof(282), page.tags.valueof(283))
    try:
        return checked_dpi([per_inch * top / bottom for top, bottom in fractions])
    except (TypeError, ValueError, ZeroDivisionError):
        return None


def _read_exif(file: BinaryIO) -> bytes | None:
    """Gather the descriptive tags and the EXIF and GPS directories into an EXIF block of their own."""
    from PIL.Image import Exif

    exif = Exif()
    try:
        file.seek(0)
        exif.load_from_fp(file)
        kept = set(exif) & {*_TEXT_TAGS, _EXIF_DIRECTORY, _GPS_DIRECTORY}
        for tag in set(exif) - kept:
            del exif[tag]
        return exif.tobytes().removeprefix(b"Exif\0\0") if kept else None
    except Exception as error:
        # Pixels are what is asked for: a bad note beside them is no reason to refuse them.
        warnings.warn(f"the file's EXIF is damaged and left out ({error})", stacklevel=4)
        return None


def _parse_exif(block: bytes | None) -> "Exif | None":
    if not block:
        return None
    from PIL.Image import Exif

    exif = Exif()
    try:
        exif.load(block)
    except Exception as error:
        raise ImageError(f"its EXIF is damaged ({error}); pass metadata without it") from error
    return exif


def _text_tags(exif: "Exif | None") -> list[tuple[int, int, int, bytes, bool]]:
    found = [(tag, exif[tag]) for tag in _TEXT_TAGS if tag in exif] if exif is not None else []
    # Pillow hands text out as latin-1, so this gives the bytes that were in the block.
    return [(tag, 2, 0, str(text).encode("latin-1", "replace"), True) for tag, text in found if text]


def _directories(exif: "Exif | None") -> list[int]:
    candidates = (_EXIF_DIRECTORY, _GPS_DIRECTORY)
    return [tag for tag in candidates if exif is not None and exif.get_ifd(tag)]


def _append_directories(file: BinaryIO, exif: "Exif") -> None:
    """Put the EXIF and GPS directories at the end of a written file, and point their tags at them.

    tifffile writes tags with values only; Pillow lays out a directory for a given place in a file.
    """
    from PIL.TiffImagePlugin import ImageFileDirectory_v2
    from tifffile import TiffFile

    with TiffFile(file, mode="r+") as tiff:
        for tag in _directories(exif):
            entries = dict(exif.get_ifd(tag))
            if _INTEROP_DIRECTORY in entries:
                entries[_INTEROP_DIRECTORY] = exif.get_ifd(_INTEROP_DIRECTORY)
            directory = ImageFileDirectory_v2(
                b"II*\0\x08\0\0\0" if tiff.byteorder == "<" else b"MM\0*\0\0\0\x08", group=tag
            )
            for code, value in entries.items():
                directory[code] = value
            offset = file.seek(0, 2)
            offset += file.write(b"\0" * (offset % 2))  # directories begin at even bytes
            file.write(directory.tobytes(offset))
            tiff.pages.first.tags[tag].overwrite(offset)
