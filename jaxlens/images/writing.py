"""Write picture files, whole or not at all."""

import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from jaxlens.files import atomic_write
from jaxlens.images.picture import (
    FORMATS,
    PNG_COMPRESSION_LEVEL,
    WRITABLE_SUFFIXES,
    FileFormat,
    ImageError,
    Picture,
    PictureMetadata,
)

_JPEG_QUALITY = 95
# From here on colour is kept at full resolution (4:4:4); below, size matters more (4:2:0).
_JPEG_FULL_COLOUR_QUALITY = 90
_ICC_CHANNELS = {b"GRAY": (1, 2), b"RGB ": (3, 4)}


def write(
    path: str | os.PathLike[str],
    picture: Picture | npt.ArrayLike,
    *,
    metadata: PictureMetadata | None = None,
    overwrite: bool = False,
    quality: int | None = None,
) -> None:
    """Writes a picture in the format of the suffix, without converting its pixels.

    | suffix | dtype | channels |
    |---|---|---|
    | .png | uint8, uint16 | 1, 2, 3, 4 |
    | .tif .tiff | uint8/16/32, int8/16/32, float16/32/64 | 1, 2, 3, 4 |
    | .jpg .jpeg | uint8 | 1, 3 |
    | .webp | uint8 | 3, 4 |
    | .bmp | uint8 | 1, 3 |
    | .pgm | uint8, uint16 | 1 |
    | .ppm | uint8 | 3 |
    | .pnm | as .pgm, .ppm | 1, 3 |

    PNG, JPEG, WebP and TIFF carry EXIF, profile and (not WebP) resolution; BMP carries the resolution, the
    others nothing; a BigTIFF (pixels beyond 4 GB) carries no EXIF. An orientation in the EXIF is written as it is.
    A profile for another number of colours than the pixels have is left out. PNG, TIFF and,
    without `quality`, WebP are lossless. Equal pictures make equal files, with equal versions of the encoders.
    16-bit PNG with more than one channel needs the extra `codecs`; without it TIFF is not compressed.

    The file is written beside its place and renamed when complete (`jaxlens.files.atomic_write`).

    Args:
        path: The file to write. Its folder must exist.
        picture: A `Picture`, or pixels `(height, width)` or `(height, width, 1 to 4)`; see `Picture`.
        metadata: What to write beside the pixels. By default the picture's own; `PictureMetadata()` for none.
        overwrite: Replace an existing file.
        quality: 1 to 100, for JPEG (default 95; full-resolution colour from 90 up) and WebP (default:
            lossless).

    Raises:
        ImageError: unknown suffix; pixels that the format cannot hold (the message names formats that can);
            the file exists, or cannot be written. Nothing is left behind then.

    Example:
        >>> import numpy as np
        >>> from jaxlens import images
        >>> images.write("gray.png", np.full((480, 640), 40000, np.uint16))
        >>> int(images.read("gray.png").pixels.max())
        40000
    """
    path = Path(path)
    pixels = np.asarray(picture.pixels if isinstance(picture, Picture) else picture)
    if metadata is None:
        metadata = picture.metadata if isinstance(picture, Picture) else PictureMetadata()
    try:
        known = _format_for(path)
        pixels = _checked_pixels(pixels, known)
        _check_quality(quality, known)
        with atomic_write(path, overwrite=overwrite) as temporary, open(temporary, "r+b") as file:
            _encode(file, pixels, known, path.suffix.lower(), _fitting(metadata, pixels), quality)
    except ImageError as error:
        raise ImageError(f"cannot write {str(path)!r}: {error}") from error.__cause__
    except Exception as error:
        raise ImageError(f"cannot write {str(path)!r}: {_reason(error)}") from error


def _format_for(path: Path) -> FileFormat:
    suffix = path.suffix.lower()
    if suffix not in WRITABLE_SUFFIXES:
        raise ImageError(f"no picture is written with suffix {suffix!r}; use one of {', '.join(WRITABLE_SUFFIXES)}")
    return next(known for known in FORMATS if suffix in known.suffixes)


def _checked_pixels(pixels: np.ndarray, known: FileFormat) -> np.ndarray:
    if pixels.ndim == 3 and pixels.shape[-1] == 1:
        pixels = pixels[..., 0]
    channels = _channels(pixels)
    if pixels.ndim not in (2, 3) or channels > 4 or pixels.size == 0:
        raise ImageError(
            f"the pixels have shape {pixels.shape}; a picture is (height, width) or (height, width, 1 to 4)"
        )
    if not known.holds(pixels.dtype, channels):
        raise ImageError(f"{known.name} does not hold {_describe(pixels)}; {_advice(pixels)}")
    if known.max_side is not None and max(pixels.shape[:2]) > known.max_side:
        raise ImageError(
            f"{known.name} holds at most {known.max_side} pixels a side, the picture is "
            f"{pixels.shape[1]} × {pixels.shape[0]}; write .png or .tif"
        )
    return np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))


def _channels(pixels: np.ndarray) -> int:
    return pixels.shape[-1] if pixels.ndim == 3 else 1


def _describe(pixels: np.ndarray) -> str:
    layout = {1: "gray", 2: "gray and alpha", 3: "RGB", 4: "RGBA"}[_channels(pixels)]
    return f"{pixels.dtype} {layout}"


def _advice(pixels: np.ndarray) -> str:
    fitting = [known.suffixes[0] for known in FORMATS if known.holds(pixels.dtype, _channels(pixels))]
    if not fitting:
        return "convert the pixels to uint8 (0 to 255), uint16 or float32 first"
    conversions = ["make them uint8 (0 to 255)"] if pixels.dtype != np.uint8 else []
    conversions += ["drop the alpha channel"] if _channels(pixels) in (2, 4) else []
    return ", or ".join([f"write {' or '.join(fitting)}", *conversions])


def _check_quality(quality: int | None, known: FileFormat) -> None:
    if quality is None:
        return
    if known.name not in ("JPEG", "WebP"):
        raise ImageError(f"{known.name} has no quality, got quality={quality}; leave it out")
    if not 1 <= quality <= 100:
        raise ImageError(f"quality must be 1 to 100, got {quality}")


def _fitting(metadata: PictureMetadata, pixels: np.ndarray) -> PictureMetadata:
    """Leaves out a profile that is for another kind of colour: readers reject or misapply it."""
    profile = metadata.icc_profile
    if profile and _channels(pixels) not in _ICC_CHANNELS.get(profile[16:20], ()):
        profile = None
    return PictureMetadata(metadata.exif, profile, metadata.dpi, metadata.format)


def _encode(
    file: BinaryIO,
    pixels: np.ndarray,
    known: FileFormat,
    suffix: str,
    metadata: PictureMetadata,
    quality: int | None,
) -> None:
    # Imported late: see the package's docstring.
    if known.name == "TIFF":
        from jaxlens.images.tiff_files import write_tiff

        write_tiff(file, pixels, metadata)
    elif known.name == "PNG" and pixels.dtype == np.uint16 and pixels.ndim == 3:
        from jaxlens.images.pillow_files import encode_png16

        file.write(encode_png16(pixels, metadata))
    else:
        import imageio.v3 as iio

        options = _carried(known, metadata) | _encoder_options(known, quality)
        iio.imwrite(file, pixels, plugin="pillow", extension=suffix, is_batch=False, **options)


def _carried(known: FileFormat, metadata: PictureMetadata) -> dict[str, Any]:
    from jaxlens.images.exif import EXIF_PREFIX, strip_prefix

    options: dict[str, Any] = {}
    if metadata.dpi and known.name in ("PNG", "JPEG", "BMP"):
        options["dpi"] = metadata.dpi
    if known.name in ("PNG", "JPEG", "WebP"):
        if metadata.exif:
            options["exif"] = EXIF_PREFIX + strip_prefix(metadata.exif)
        if metadata.icc_profile:
            options["icc_profile"] = metadata.icc_profile
    return options


def _encoder_options(known: FileFormat, quality: int | None) -> dict[str, Any]:
    if known.name == "JPEG":
        quality = _JPEG_QUALITY if quality is None else quality
        return {
            "quality": quality,
            "subsampling": "4:4:4" if quality >= _JPEG_FULL_COLOUR_QUALITY else "4:2:0",
        }
    if known.name == "WebP":
        # exact: colours under transparent pixels are kept, as in the other formats.
        return {"lossless": True, "exact": True} if quality is None else {"quality": quality}
    if known.name == "PNG":
        return {"compress_level": PNG_COMPRESSION_LEVEL}
    return {}


def _reason(error: Exception) -> str:
    if isinstance(error, PermissionError):
        return "you may not write there; choose another folder or change its permissions"
    if isinstance(error, OSError) and error.errno is not None:
        return f"the system says: {error.strerror}"
    return str(error) or type(error).__name__
