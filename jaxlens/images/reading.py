"""Read picture files, which are not trusted.

imageio's v3 interface is not used here: it tries every format Pillow knows (PostScript among them, which runs
a program), cannot stop between header and pixels, truncates 16-bit colour PNG to 8 bits, and returns neither
the EXIF block nor a TIFF's profile. So the format is told from the first bytes, and only its own decoder is
called.
"""

import os
import re
import stat
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from jaxlens.images.exif import swaps_axes, upright
from jaxlens.images.picture import DEFAULT_MAX_PIXELS, READABLE_SUFFIXES, ImageError, Picture, check_size

_SIGNATURES: Sequence[tuple[str, re.Pattern[bytes]]] = (
    ("PNG", re.compile(rb"\x89PNG\r\n\x1a\n")),
    ("JPEG", re.compile(rb"\xff\xd8\xff")),
    ("TIFF", re.compile(rb"II[*+]\0|MM\0[*+]")),
    ("WebP", re.compile(rb"RIFF.{4}WEBP", re.DOTALL)),
    ("GIF", re.compile(rb"GIF8[79]a")),
    ("BMP", re.compile(rb"BM")),
    ("PNM", re.compile(rb"P[1-6][\s#]")),
    ("AVIF", re.compile(rb".{4}ftypavi[fs]", re.DOTALL)),
)
# Of the same family of files as AVIF, told by its brand.
_HEIF = re.compile(rb".{4}ftyp(hei[cxms]|hev[cxms]|mif1|msf1)", re.DOTALL)


def read(path: str | os.PathLike[str], *, max_pixels: int = DEFAULT_MAX_PIXELS) -> Picture:
    """Reads a picture with its metadata, upright.

    Formats: PNG, JPEG, TIFF, BMP, WebP, GIF, PBM/PGM/PPM and, where Pillow is built with it, AVIF, told by their
    first bytes, whatever the suffix. The dtype is the file's: 16-bit PNG and TIFF stay uint16, float TIFF stays
    float. Palettes are looked up (RGB, or RGBA with transparency); a PNG's transparent colour becomes an alpha
    channel; 1-bit pictures become uint8 with 0 and 255; a PGM of any depth is stretched to the full range. EXIF
    orientation is applied to the pixels, once, and its tag set to 1. Of animations and multi-page files the first
    picture is read, with a UserWarning; a multi-picture JPEG of a phone is its main picture, without one.

    Refused, because reading them would guess at colours or lose bits: CMYK, YCbCr and Lab, camera raw,
    premultiplied alpha, undeclared extra channels, 16-bit colour PPM, AVIF of 10 and 12 bits, TIFF compressions
    other than LZW, Deflate, PackBits and Zstandard. Those four, and PNG with 16-bit colour or a transparent colour,
    need the extra `codecs`.

    Args:
        path: The file. Symbolic links are followed.
        max_pixels: Largest height × width accepted, in pixels; checked before the pixels are decoded.

    Returns:
        The picture; see `Picture` for the layout of its pixels.

    Raises:
        ImageError: no such file, not a file, no permission, not a picture, damaged or truncated, too large,
            or of a kind that is refused. The message names the file, the reason and the remedy; the decoder's
            own exception, if any, is its cause.

    Example:
        >>> import numpy as np
        >>> from jaxlens import images
        >>> images.write("portrait.png", np.zeros((480, 640, 3), np.uint8))
        >>> picture = images.read("portrait.png")
        >>> picture.pixels.shape, picture.pixels.dtype, picture.has_alpha
        ((480, 640, 3), dtype('uint8'), False)
    """
    path = Path(path)
    try:
        _check_file(path)
        with open(path, "rb") as file:
            return _decode(file, path, max_pixels)
    except ImageError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error}") from error.__cause__
    except MemoryError as error:
        raise ImageError(f"cannot read {str(path)!r}: not enough memory for its pixels") from error
    except Exception as error:
        # Decoders raise what they please; whatever it is, the file is what is wrong.
        raise ImageError(f"cannot read {str(path)!r}: {_reason(error)}") from error


def list_images(folder: str | os.PathLike[str]) -> list[Path]:
    """Lists the picture files that lie in a folder, by suffix.

    Args:
        folder: The folder. It is not searched deeper.

    Returns:
        Files with a suffix in `READABLE_SUFFIXES` (in either case), sorted by name. Hidden files are left
        out: they are other programs' business, and unfinished writes.

    Raises:
        ImageError: the folder does not exist, is not a folder, or may not be listed.
    """
    folder = Path(folder)
    try:
        names = sorted(os.listdir(folder))
    except NotADirectoryError as error:
        raise ImageError(f"cannot list {str(folder)!r}: it is not a folder") from error
    except (OSError, ValueError) as error:
        raise ImageError(f"cannot list {str(folder)!r}: {_reason(error)}") from error
    wanted = (folder / name for name in names if not name.startswith("."))
    return [path for path in wanted if path.suffix.lower() in READABLE_SUFFIXES and path.is_file()]


def _check_file(path: Path) -> None:
    """Refuses what is not a file with something in it; a pipe would be waited for forever."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ImageError("there is no such file; check the name and the folder you are in") from error
    if stat.S_ISDIR(status.st_mode):
        raise ImageError("it is a folder; give one file, or take its pictures from list_images")
    if not stat.S_ISREG(status.st_mode):
        raise ImageError("it is not a regular file; copy its contents to one first")
    if status.st_size == 0:
        raise ImageError("the file is empty (0 bytes); copy or download it again")


def _decode(file: BinaryIO, path: Path, max_pixels: int) -> Picture:
    head = file.read(16)
    file.seek(0)
    format = next((name for name, signature in _SIGNATURES if signature.match(head)), None)
    if format is None and _HEIF.match(head):
        raise ImageError(
            "it is HEIF, which is not read; convert it first, with pillow-heif for instance, to PNG or TIFF"
        )
    if format is None:
        known = ", ".join(name for name, _ in _SIGNATURES)
        raise ImageError(f"it is not a picture of a known format ({known}); it begins with {head!r}")
    # Pillow and tifffile take their time to import, and each file needs one of them.
    if format == "TIFF":
        from jaxlens.images.tiff_files import read_tiff

        pixels, metadata, orientation = read_tiff(file, max_pixels)
    else:
        from jaxlens.images.pillow_files import read_with_pillow

        pixels, metadata, orientation = read_with_pillow(file, format, max_pixels)
    # What was decoded must be what was declared and checked.
    check_size(pixels.shape[1], pixels.shape[0], max_pixels)
    if metadata.dpi is not None and swaps_axes(orientation):
        metadata = replace(metadata, dpi=metadata.dpi[::-1])
    return Picture(upright(pixels, orientation), metadata, path)


def _reason(error: Exception) -> str:
    if isinstance(error, Warning):  # raised where the user made warnings errors
        return str(error)
    if isinstance(error, PermissionError):
        return "you may not read it; change its permissions"
    if isinstance(error, OSError) and error.errno is not None:
        return f"the system says: {error.strerror}"
    if isinstance(error, ValueError) and "null byte" in str(error):
        return "the name holds a null byte"
    return f"the file is damaged, truncated or of an unknown kind; make it anew ({error})"
