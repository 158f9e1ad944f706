"""Pictures as files: read with all that must be kept, written whole or not at all.

This is the edge of the library: NumPy arrays and files. Nothing heavy is imported before a file is read or written,
and JAX only by `warp`. imageio writes what it can carry; `jaxlens.images.reading` says why reading goes to Pillow,
tifffile and imagecodecs (an extra) directly.
"""

from typing import TYPE_CHECKING

from jaxlens.images.picture import DEFAULT_MAX_PIXELS as DEFAULT_MAX_PIXELS
from jaxlens.images.picture import READABLE_SUFFIXES as READABLE_SUFFIXES
from jaxlens.images.picture import WRITABLE_SUFFIXES as WRITABLE_SUFFIXES
from jaxlens.images.picture import ImageError as ImageError
from jaxlens.images.picture import Picture as Picture
from jaxlens.images.picture import PictureMetadata as PictureMetadata
from jaxlens.images.reading import list_images as list_images
from jaxlens.images.reading import read as read
from jaxlens.images.writing import write as write

if TYPE_CHECKING:
    from jaxlens.images.warping import warp as warp
else:

    def __getattr__(name: str) -> object:
        if name != "warp":
            raise AttributeError(f"module 'jaxlens.images' has no attribute {name!r}")
        from jaxlens.images.warping import warp

        globals()["warp"] = warp
        return warp
