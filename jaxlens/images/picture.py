"""The picture, what is kept beside its pixels, the error, and what each file format holds."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

DEFAULT_MAX_PIXELS = 200_000_000
"""Largest picture read unless told otherwise, in pixels (height × width): 0.8 GB as 8-bit RGBA."""

PNG_COMPRESSION_LEVEL = 4
"""The PNG compression level, of zlib's 0 to 9: on photographs twice as fast as its default, 6, for files 5 % larger."""


class ImageError(ValueError):
    """A picture file could not be read or written; the message says why and what to do."""


@dataclass(frozen=True)
class PictureMetadata:
    r"""What a file says beside its pixels, kept to be written back.

    XMP and IPTC blocks, comments, gamma chunks and embedded thumbnails of TIFF are not kept.

    Attributes:
        exif: EXIF, as the TIFF structure without the `Exif\0\0` in front. `read` has applied its
            orientation to the pixels and set the tag to 1; the rest is the file's, byte for byte. (A
            TIFF spreads its EXIF over the file: of it, the descriptive tags, EXIF and GPS directories.)
        icc_profile: ICC colour profile of the pixels.
        dpi: Dots per inch, (horizontal, vertical), both positive.
        format: The file's format: `"PNG"`, `"JPEG"`, `"TIFF"`, `"BMP"`, `"WebP"`, `"GIF"`,
            `"AVIF"` or `"PNM"`. For information; writing goes by the suffix.
    """

    exif: bytes | None = field(default=None, repr=False)
    icc_profile: bytes | None = field(default=None, repr=False)
    dpi: tuple[float, float] | None = None
    format: str | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """Pixels and what belongs to them.

    To change the pixels and keep the rest: `dataclasses.replace(picture, pixels=warped)`.

    Attributes:
        pixels: `(height, width)` gray, or `(height, width, channels)` with 2 (gray, alpha), 3 (RGB) or
            4 (RGBA) channels, in the file's dtype, in native byte order. The scale is the file's: 0 to 255,
            0 to 65535, floats as they are. Alpha is straight, not multiplied into the colours.
        metadata: EXIF, ICC profile, resolution, format.
        path: The file it was read from, if any.
    """

    pixels: np.ndarray
    metadata: PictureMetadata = PictureMetadata()
    path: Path | None = None

    @property
    def has_alpha(self) -> bool:
        """Whether the last channel is alpha: true for 2 and 4 channels."""
        return self.pixels.ndim == 3 and self.pixels.shape[-1] in (2, 4)


@dataclass(frozen=True)
class FileFormat:
    """What can be written under a set of suffixes.

    Attributes:
        name: As people call it.
        suffixes: Lower case, with the dot.
        channels: For each dtype by name, the channel counts it may have; empty when never written.
        max_side: Largest height or width, in pixels; None for no limit of its own.
    """

    name: str
    suffixes: tuple[str, ...]
    channels: dict[str, tuple[int, ...]]
    max_side: int | None = None

    def holds(self, dtype: np.dtype, channels: int) -> bool:
        """Tells whether pixels of this dtype and channel count can be written without loss of kind."""
        return channels in self.channels.get(dtype.name, ())


_ANY = (1, 2, 3, 4)
_TIFF_DTYPES = ("uint8", "uint16", "uint32", "int8", "int16", "int32", "float16", "float32", "float64")

# GIF is not written: 256 colours would be a loss; nor AVIF, which Pillow never writes without loss. BMP's alpha is
# ambiguous among readers, WebP has no gray.
FORMATS = (
    FileFormat("PNG", (".png",), {"uint8": _ANY, "uint16": _ANY}),
    FileFormat("TIFF", (".tif", ".tiff"), {dtype: _ANY for dtype in _TIFF_DTYPES}),
    FileFormat("JPEG", (".jpg", ".jpeg"), {"uint8": (1, 3)}, max_side=65_535),
    FileFormat("WebP", (".webp",), {"uint8": (3, 4)}, max_side=16_383),
    FileFormat("BMP", (".bmp",), {"uint8": (1, 3)}),
    FileFormat("PGM", (".pgm",), {"uint8": (1,), "uint16": (1,)}),
    FileFormat("PPM", (".ppm",), {"uint8": (3,)}),
    FileFormat("PNM", (".pnm",), {"uint8": (1, 3), "uint16": (1,)}),
    FileFormat("PBM", (".pbm",), {}),
    FileFormat("GIF", (".gif",), {}),
    FileFormat("AVIF", (".avif", ".avifs"), {}),
)

READABLE_SUFFIXES = tuple(sorted(suffix for known in FORMATS for suffix in known.suffixes))
"""Suffixes that `list_images` looks for, in lower case."""
WRITABLE_SUFFIXES = tuple(sorted(suffix for known in FORMATS if known.channels for suffix in known.suffixes))
"""Suffixes that `write` accepts, in lower case."""


def check_size(width: int, height: int, max_pixels: int) -> None:
    """Refuses a picture by its declared size, before anything is decoded.

    Args:
        width: Declared width in pixels.
        height: Declared height in pixels.
        max_pixels: Largest `width * height` allowed.

    Raises:
        ImageError: empty, or larger than `max_pixels`.
    """
    if width < 1 or height < 1:
        raise ImageError(f"it declares an empty picture, {width} × {height} pixels")
    if width * height > max_pixels:
        raise ImageError(
            f"it declares {width} × {height} = {width * height} pixels, more than max_pixels={max_pixels}; "
            "if you trust the file, pass a larger max_pixels"
        )
