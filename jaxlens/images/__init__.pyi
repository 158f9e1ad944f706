# The public names: `__init__.py` imports each from here when it is first used, and type checkers read them here.
from .picture import DEFAULT_MAX_PIXELS as DEFAULT_MAX_PIXELS
from .picture import READABLE_SUFFIXES as READABLE_SUFFIXES
from .picture import WRITABLE_SUFFIXES as WRITABLE_SUFFIXES
from .picture import ImageError as ImageError
from .picture import Picture as Picture
from .picture import PictureMetadata as PictureMetadata
from .reading import list_images as list_images
from .reading import read as read
from .warping import warp as warp
from .writing import write as write
