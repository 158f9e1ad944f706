"""Figures inside a page: line art as SVG, pictures as WebP where that is smaller."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

# By suffix, the best first: of files with one stem, the first is shown.
MEDIA = {
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".webp": "image/webp",
    ".gif": "image/gif",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
}
# Pillow's quality: text on a picture stays crisp, at about a third of the PNG's size.
_QUALITY = 90
# What may stand in a data URI in double quotes; base64 would be longer, for SVG is mostly digits.
_SAFE = " !$'()*+,-./:;=?@_~"


@dataclass(frozen=True)
class Embedded:
    """A figure as the page holds it.

    Attributes:
        uri: All of it, as `data:…`.
        width: In pixels, if known.
        height: Likewise.
    """

    uri: str
    width: int | None = None
    height: int | None = None


def embed(path: Path) -> Embedded:
    """Returns a figure's file as a data URI.

    Raises:
        OSError: the file cannot be read, or is no picture.
    """
    content, suffix = path.read_bytes(), path.suffix.lower()
    if suffix == ".svg":
        # As an image of its own: the ids of one figure cannot meet those of another, and no script in it runs.
        return Embedded(f"data:{MEDIA[suffix]},{quote(content, safe=_SAFE)}", *_size(path.with_suffix(".png")))
    media, shrunk = MEDIA[suffix], _as_webp(content) if suffix == ".png" else None
    if shrunk is not None and len(shrunk) < len(content):
        media, content = MEDIA[".webp"], shrunk
    return Embedded(f"data:{media};base64,{base64.b64encode(content).decode()}", *_size(path))


def _as_webp(content: bytes) -> bytes | None:
    import PIL.Image

    with PIL.Image.open(io.BytesIO(content)) as picture:
        if picture.mode not in ("1", "L", "P", "RGB") or "transparency" in picture.info:
            return None
        buffer = io.BytesIO()
        picture.convert("RGB").save(buffer, "WEBP", quality=_QUALITY, method=4)
    return buffer.getvalue()


def _size(path: Path) -> tuple[int | None, int | None]:
    import PIL.Image

    if not path.is_file():
        return None, None
    with PIL.Image.open(path) as picture:
        return picture.size
