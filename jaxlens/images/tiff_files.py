"""TIFF, read and written by tifffile: Pillow knows neither 16-bit nor float colour."""

import io
import math
import struct
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, cast

import numpy as np

from jaxlens.images.directories import (
    EXIF_DIRECTORY,
    GPS_DIRECTORY,
    Entry,
    build_exif,
    lay_out,
    parse_exif,
    read_directory,
)
from jaxlens.images.exif import reset_orientation, strip_prefix
from jaxlens.images.picture import ImageError, PictureMetadata, check_size
from jaxlens.images.pillow_files import checked_dpi

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

# imagecodecs' decoder of each of these stops at the size the header declares, whatever the compressed bytes would
# unfold to. JPEG in TIFF has a header of its own, and LZMA a dictionary of any size: both could ask for gigabytes.
_COMPRESSIONS = {1: "none", 5: "LZW", 8: "Deflate", 32946: "Deflate", 32773: "PackBits", 50000: "Zstandard"}
_NO_COMPRESSION = 1
_MINISWHITE, _MINISBLACK, _RGB, _PALETTE = 0, 1, 2, 3
_STRAIGHT_ALPHA = 2
_DNG_VERSION = 50706
_ORIENTATION = 274
# Tags that change what the pixels are; tifffile goes on without those it cannot read.
_PIXEL_TAGS = frozenset([256, 257, 258, 259, 262, 266, 273, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325, 338, 339])
# Tags of EXIF in a TIFF: Make, Model, Orientation, Software, DateTime, Artist, HostComputer, Copyright.
# ImageDescription is left out: in TIFF it is where programs put descriptions of the array, which a warp would
# make false.
_KEPT_TAGS = (271, 272, _ORIENTATION, 305, 306, 315, 316, 33432, EXIF_DIRECTORY, GPS_DIRECTORY)


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
        if page.compression != _NO_COMPRESSION:
            # Its decoders stop at the declared size; what tifffile puts in their place, where it can, does not.
            import_module("imagecodecs")
        if _has_second_picture(tiff):
            warnings.warn("the file holds several pictures; only the first is read", stacklevel=4)
        pixels = _pixels(page)
        orientation = page.tags.valueof(_ORIENTATION, 1)
        metadata = PictureMetadata(
            exif=None if tiff.is_bigtiff else _read_exif(file, tiff.byteorder, page.offset),
            icc_profile=page.iccprofile or None,
            dpi=_read_dpi(page),
            format="TIFF",
        )
    return pixels, metadata, orientation if orientation in range(1, 9) else 1


def write_tiff(file: BinaryIO, pixels: np.ndarray, metadata: PictureMetadata) -> None:
    """Encode a TIFF, Deflate-compressed, with straight alpha.

    Args:
        file: Open for writing and reading, empty.
        pixels: `(height, width)` or `(height, width, 2 to 4)`.
        metadata: EXIF, profile and resolution to put in.
    """
    import tifffile

    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    order, entries = _exif_entries(metadata.exif)
    # Offsets in a plain TIFF have 32 bits; some room is left for what is not pixels. BigTIFF gets no EXIF.
    large = pixels.nbytes > 2**32 - 2**25
    options: dict[str, Any] = {
        "photometric": "rgb" if channels >= 3 else "minisblack",
        "planarconfig": "contig" if channels > 1 else None,
        "extrasamples": ["unassalpha"] if channels in (2, 4) else None,
        "compression": "zlib",
        # Differences of neighbours compress integers well; for floats it is an extension few readers know.
        "predictor": pixels.dtype.kind in "ui",
        "iccprofile": metadata.icc_profile,
        # No date, no name of the writer, no description: equal pictures make equal files.
        "metadata": None,
        "software": False,
    }
    if metadata.dpi:
        options |= {"resolution": metadata.dpi, "resolutionunit": "inch"}
    # The EXIF's byte order is taken over, for its values are copied as they are. imageio cannot hand it on.
    with tifffile.TiffWriter(file, byteorder=order, bigtiff=large) as writer:
        writer.write(pixels, **options)
    if entries and not large:
        _add_entries(file, order, entries)


def _check_tags(tiff: "TiffFile", page: "TiffPage") -> None:
    """Refuse a page of which tifffile dropped a tag that decides what the pixels are."""
    handle, layout = tiff.filehandle, tiff.tiff
    handle.seek(page.offset)
    (count,) = struct.unpack(layout.tagnoformat, handle.read(layout.tagnosize))
    entries = handle.read(count * layout.tagsize)
    starts = range(0, len(entries), layout.tagsize)
    codes = {struct.unpack_from(layout.byteorder + "H", entries, start)[0] for start in starts}
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
        return not cast("TiffPage", tiff.pages.get(1)).is_reduced
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


def _read_exif(file: BinaryIO, order: str, offset: int) -> bytes | None:
    """Gather the descriptive tags and the EXIF and GPS directories into an EXIF block of their own."""
    try:
        entries = read_directory(file, order, offset)
    except ValueError as error:
        # Pixels are what is asked for: a bad note beside them is no reason to refuse them.
        warnings.warn(f"the EXIF is damaged and left out ({error})", stacklevel=5)
        return None
    kept = [entry for entry in entries if entry.tag in _KEPT_TAGS]
    return reset_orientation(build_exif(kept, order))[1] if kept else None


def _exif_entries(block: bytes | None) -> tuple[Literal["<", ">"], list[Entry]]:
    """Entries of an EXIF block that a TIFF takes over, with their byte order; a damaged block has none."""
    if not block:
        return "<", []
    try:
        order, entries = parse_exif(strip_prefix(block))
    except ValueError as error:
        warnings.warn(f"the EXIF is damaged and left out ({error})", stacklevel=5)
        return "<", []
    return order, [entry for entry in entries if entry.tag in _KEPT_TAGS]


def _add_entries(file: BinaryIO, order: str, entries: list[Entry]) -> None:
    """Give a written TIFF more entries, by a new main directory at its end; tifffile would not write them."""
    file.seek(4)
    (first,) = struct.unpack(order + "I", file.read(4))
    present = read_directory(file, order, first)
    end = file.seek(0, io.SEEK_END)
    end += file.write(b"\0" * (end % 2))  # directories begin at even offsets
    file.write(lay_out([*present, *entries], order, end))
    file.seek(4)
    file.write(struct.pack(order + "I", end))
