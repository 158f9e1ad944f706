"""TIFF, read and written by tifffile: Pillow knows neither 16-bit nor float colour."""

import io
import math
import struct
import warnings
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np

from jaxlens.images.codecs import codecs
from jaxlens.images.exif import reset_orientation, strip_prefix
from jaxlens.images.picture import ImageError, PictureMetadata, check_size
from jaxlens.images.pillow_files import checked_dpi
from jaxlens.images.tiff_exif import NESTED, ORIENTATION, Directory, read_exif

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

# imagecodecs' decoder of each of these stops at the size the header declares, whatever the compressed bytes would
# unfold to. JPEG in TIFF has a header of its own, and LZMA a dictionary of any size: both could ask for gigabytes.
_COMPRESSIONS = {1: "none", 5: "LZW", 8: "Deflate", 32946: "Deflate", 32773: "PackBits", 50000: "Zstandard"}
_NO_COMPRESSION = 1
_MINISWHITE, _MINISBLACK, _RGB, _PALETTE = 0, 1, 2, 3
_STRAIGHT_ALPHA = 2
_DNG_VERSION = 50706
# Of the main directory in a file that tifffile writes: it stands for directories that are still to be appended.
_FIRST_OFFSET = 8
# Tags that change what the pixels are; tifffile goes on without those it cannot read.
_PIXEL_TAGS = frozenset([256, 257, 258, 259, 262, 266, 273, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325, 338, 339])


def read_tiff(file: BinaryIO, max_pixels: int) -> tuple[np.ndarray, PictureMetadata, int]:
    """Decodes the first page of a TIFF or BigTIFF.

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
            codecs(f"reading TIFF compressed by {_COMPRESSIONS[page.compression]}")
        if _has_second_picture(tiff):
            warnings.warn("the file holds several pictures; only the first is read", stacklevel=4)
        pixels = _pixels(page)
        orientation = page.tags.valueof(ORIENTATION, 1)
        metadata = PictureMetadata(
            exif=None if tiff.is_bigtiff else _exif_block(file),
            icc_profile=page.iccprofile or None,
            dpi=_read_dpi(page),
            format="TIFF",
        )
    return pixels, metadata, orientation if orientation in range(1, 9) else 1


def write_tiff(file: BinaryIO, pixels: np.ndarray, metadata: PictureMetadata) -> None:
    """Encodes a TIFF, Deflate-compressed where imagecodecs is installed, with straight alpha.

    Args:
        file: Open for writing and reading, empty.
        pixels: `(height, width)` or `(height, width, 2 to 4)`.
        metadata: EXIF, profile and resolution to put in.
    """
    import tifffile

    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    # Offsets in a plain TIFF have 32 bits; some room is left for what is not pixels. BigTIFF gets no EXIF.
    large = pixels.nbytes > 2**32 - 2**25
    exif = None if large or not metadata.exif else read_exif(io.BytesIO(strip_prefix(metadata.exif)))
    # What is written here can be read here.
    compressed = find_spec("imagecodecs") is not None
    options: dict[str, Any] = {
        "photometric": "rgb" if channels >= 3 else "minisblack",
        "planarconfig": "contig" if channels > 1 else None,
        "extrasamples": ["unassalpha"] if channels in (2, 4) else None,
        "compression": "zlib" if compressed else None,
        # Differences of neighbours compress integers well; for floats it is an extension few readers know.
        "predictor": compressed and pixels.dtype.kind in "ui",
        "iccprofile": metadata.icc_profile,
        # No date, no name of the writer, no description: equal pictures make equal files.
        "metadata": None,
        "software": False,
        "extratags": [] if exif is None else _tags(exif),
    }
    if metadata.dpi:
        options |= {"resolution": metadata.dpi, "resolutionunit": "inch"}
    # The EXIF's byte order is taken over: its directories are written in it. imageio cannot hand it on.
    with tifffile.TiffWriter(file, byteorder="<" if exif is None else exif.order, bigtiff=large) as writer:
        writer.write(pixels, **options)
    if exif is not None and exif.inner:
        _add_directories(file, exif)


def _check_tags(tiff: "TiffFile", page: "TiffPage") -> None:
    """Refuses a page of which tifffile dropped a tag that decides what the pixels are."""
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
    """Refuses missing strips and tiles, which tifffile would leave blank."""
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


def _exif_block(file: BinaryIO) -> bytes | None:
    exif = read_exif(file)
    return None if exif is None else reset_orientation(exif.block())[1]


def _tags(exif: Directory) -> list[tuple[int | str, int, int, Any, bool]]:
    """Returns the entries of the main directory as tifffile takes them; those that lead to others are to be set yet."""
    entries = exif.entries
    return [
        (NESTED[tag], 4, 1, _FIRST_OFFSET, True) if tag in exif.inner else (tag, entries.tagtype[tag], 1, value, True)
        for tag, value in entries.items()
        if isinstance(value, bytes | int)
    ]


def _add_directories(file: BinaryIO, exif: Directory) -> None:
    """Appends the EXIF and GPS directories to a written TIFF, which tifffile would not write, and points at them."""
    import tifffile

    file.seek(0)
    with tifffile.TiffFile(file) as tiff:
        tags = tiff.pages.first.tags
        for tag, directory in exif.inner.items():
            end = file.seek(0, io.SEEK_END)
            end += file.write(b"\0" * (end % 2))  # directories begin at even offsets
            data, place = directory.lay_out(end)
            file.write(data)
            tags[tag].overwrite(place)
