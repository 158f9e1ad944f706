"""Pictures as files: read with all that must be kept, written whole or not at all.

This is the edge of the library: NumPy arrays and files. Nothing heavy is imported before a file is read or written,
and JAX only by `warp`. imageio writes what it can carry; `jaxlens.images.reading` says why reading goes to Pillow,
tifffile and imagecodecs (an extra) directly.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
