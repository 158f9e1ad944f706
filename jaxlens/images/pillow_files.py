"""All formats but TIFF: Pillow decodes, and imagecodecs the PNG that Pillow cannot hold.

Pillow has no mode for 16-bit colour. imagecodecs (the extra `codecs`) wraps libpng, is kept by the author of tifffile,
and is what tifffile wants for compressed TIFF anyway; pypng, the light alternative, takes 40 times as long (1 s a
megapixel) and had its last release in 2022.
"""

import math
import re
import warnings
import zlib
from collections.abc import Callable
from importlib import import_module
from typing import Any, BinaryIO

import numpy as np
from PIL import Image, ImageFile, features

from jaxlens.images.codecs import codecs
from jaxlens.images.exif import reset_orientation, strip_prefix
from jaxlens.images.picture import PNG_COMPRESSION_LEVEL, ImageError, PictureMetadata, check_size

# Called directly, not through Image.open: only the decoder meant is tried, and Pillow's own limit, a global
# that warns at 89 megapixels, does not come before ours.
_READERS = {
    "PNG": ("PIL.PngImagePlugin", "PngImageFile"),
    "JPEG": ("PIL.JpegImagePlugin", "JpegImageFile"),
    "WebP": ("PIL.WebPImagePlugin", "WebPImageFile"),
    "GIF": ("PIL.GifImagePlugin", "GifImageFile"),
    "BMP": ("PIL.BmpImagePlugin", "BmpImageFile"),
    "PNM": ("PIL.PpmImagePlugin", "PpmImageFile"),
    "AVIF": ("PIL.AvifImagePlugin", "AvifImageFile"),
}
_DIRECT_MODES = ("L", "LA", "RGB", "RGBA")
# The boxes before the pixels, which hold the configuration of each picture in the file, its alpha included.
_AVIF_HEAD = 65_536
_AV1_CONFIGURATION = re.compile(rb"av1C(.{4})", re.DOTALL)
_PNM_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PNM_COLOUR_HEADER = re.compile(rb"P[36]" + 2 * (_PNM_SPACE + rb"\d+") + _PNM_SPACE + rb"(\d+)")


def read_with_pillow(file: BinaryIO, format: str, max_pixels: int) -> tuple[np.ndarray, PictureMetadata, int]:
    """Decodes a file of a known format.

    Args:
        file: Open at its start.
        format: A key of the formats above.
        max_pixels: Largest height × width accepted, in pixels.

    Returns:
        The pixels as stored, the metadata with its orientation reset, and the orientation to apply.

    Raises:
        ImageError: too large, or of a kind that is refused. Damage raises what the decoder raises.
    """
    image = _open(file, format)
    check_size(*image.size, max_pixels)
    if getattr(image, "is_animated", False):
        warnings.warn("the file holds several pictures; only the first is read", stacklevel=4)
    image.load()
    exif = image.info.get("exif") or _exif_in_disguise(image)
    orientation, exif = reset_orientation(strip_prefix(exif))
    metadata = PictureMetadata(
        exif=exif or None,
        icc_profile=image.info.get("icc_profile") or None,
        dpi=checked_dpi(image.info.get("dpi")),
        format=format,
    )
    return _pixels(image, file, format), metadata, orientation


def encode_png16(pixels: np.ndarray, metadata: PictureMetadata) -> bytes:
    """Encodes a 16-bit PNG with more than one channel, which Pillow cannot.

    Args:
        pixels: `(height, width, channels)` uint16 with 2, 3 or 4 channels.
        metadata: EXIF, profile and resolution to put in.

    Returns:
        The file's bytes; the same input gives the same bytes.

    Raises:
        ImageError: imagecodecs is not installed.
    """
    encoded = bytes(
        codecs("writing 16-bit PNG with more than one channel").png_encode(pixels, level=PNG_COMPRESSION_LEVEL)
    )
    chunks = b""
    if metadata.icc_profile:
        chunks += _png_chunk(b"iCCP", b"ICC profile\0\0" + zlib.compress(metadata.icc_profile))
    if metadata.dpi:
        per_metre = (round(value / 0.0254).to_bytes(4, "big") for value in metadata.dpi)
        chunks += _png_chunk(b"pHYs", b"".join(per_metre) + b"\x01")
    if metadata.exif:
        chunks += _png_chunk(b"eXIf", strip_prefix(metadata.exif))
    header_end = 8 + 25  # signature and IHDR; all these chunks may follow it
    return encoded[:header_end] + chunks + encoded[header_end:]


def checked_dpi(dpi: Any) -> tuple[float, float] | None:
    """Takes a resolution as a file gives it, or None where it makes no sense.

    Args:
        dpi: Two numbers, or anything else.

    Returns:
        Dots per inch (horizontal, vertical), finite and positive.
    """
    try:
        horizontal, vertical = (float(value) for value in dpi)
    except (TypeError, ValueError, ArithmeticError):
        return None
    finite = math.isfinite(horizontal) and math.isfinite(vertical)
    return (horizontal, vertical) if finite and min(horizontal, vertical) > 0 else None


def _open(file: BinaryIO, format: str) -> ImageFile.ImageFile:
    if format == "AVIF":
        _check_avif(file)
    module, name = _READERS[format]
    reader: Callable[[BinaryIO], ImageFile.ImageFile] = getattr(import_module(module), name)
    try:
        return reader(file)
    except Image.DecompressionBombError as error:
        raise ImageError(f"it declares a huge picture ({error})") from error


def _check_avif(file: BinaryIO) -> None:
    """Refuses what Pillow cannot read, and what it would cut to 8 bits."""
    # Older versions warn of a feature that they do not know.
    supported = "avif" in features.modules and features.check("avif")
    if not supported:
        raise ImageError("this Pillow does not read AVIF; pip install --upgrade 'pillow>=11.3', or convert it to PNG")
    head = file.read(_AVIF_HEAD)
    file.seek(0)
    # AV1's configuration (AV1-ISOBMFF 2.3.3): the third byte has a bit for more than 8 bits.
    if any(match[1][2] & 0x40 for match in _AV1_CONFIGURATION.finditer(head)):
        raise ImageError("it has more than 8 bits a channel, which would be cut to 8; convert it to 16-bit PNG or TIFF")


def _exif_in_disguise(image: Image.Image) -> bytes:
    """Returns EXIF from a PNG text chunk, or an orientation in XMP, as old ImageMagick and some editors leave them."""
    exif = image.getexif()
    return exif.tobytes() if exif else b""


def _pixels(image: Image.Image, file: BinaryIO, format: str) -> np.ndarray:
    if image.mode in ("P", "PA"):
        return np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB"))
    if format == "PNG" and (_png_is_deep_colour(file) or "transparency" in image.info):
        return _decode_png(file)
    if format == "PNM":
        _refuse_deep_colour_pnm(file)
    if image.mode == "1":
        return np.asarray(image.convert("L"))
    if image.mode == "L" and "transparency" in image.info:
        return np.asarray(image.convert("LA"))
    if image.mode.startswith("I;16") or (image.mode == "I" and format == "PNM"):
        return np.asarray(image).astype(np.uint16)
    if image.mode in _DIRECT_MODES:
        return np.asarray(image)
    raise ImageError(f"its colours are {image.mode}; convert it to RGB, with its profile, in an image editor")


def _png_is_deep_colour(file: BinaryIO) -> bool:
    file.seek(0)
    header = file.read(26)
    if header[12:16] != b"IHDR":
        raise ImageError("its header is not where PNG wants it; make the file anew")
    depth, colour_type = header[24], header[25]
    return depth == 16 and colour_type != 0


def _decode_png(file: BinaryIO) -> np.ndarray:
    """Decodes 16-bit colour, or a transparent colour, which libpng turns into alpha at every depth."""
    decoder = codecs("reading PNG with 16-bit colour or a transparent colour")
    file.seek(0)
    return np.asarray(decoder.png_decode(file.read()))


def _refuse_deep_colour_pnm(file: BinaryIO) -> None:
    file.seek(0)
    head = file.read(4096)
    if head[:2] not in (b"P3", b"P6"):
        return
    match = _PNM_COLOUR_HEADER.match(head)
    if match is None:
        raise ImageError("its header is malformed, or longer than 4096 bytes; make the file anew")
    if int(match[1]) > 255:
        raise ImageError(
            f"it is a colour PPM with values up to {int(match[1])}, which would be cut to 8 bits; "
            "convert it to 16-bit PNG or TIFF"
        )


def _png_chunk(name: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(name + data)
    return len(data).to_bytes(4, "big") + name + data + checksum.to_bytes(4, "big")
