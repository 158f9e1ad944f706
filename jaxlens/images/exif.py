"""EXIF's orientation: read it, reset it, and turn the pixels upright."""

import struct

import numpy as np

_ORIENTATION = 0x0112
# TIFF field types an orientation has been seen in: BYTE, SHORT, LONG.
_INTEGER_TYPES = {1: "B", 3: "H", 4: "I"}
EXIF_PREFIX = b"Exif\0\0"
"""What JPEG puts before the EXIF block; doubled by some cameras."""


def strip_prefix(exif: bytes) -> bytes:
    r"""Takes the `Exif\0\0` marks off the front of an EXIF block.

    Args:
        exif: With or without marks.

    Returns:
        The TIFF structure alone.
    """
    while exif.startswith(EXIF_PREFIX):
        exif = exif.removeprefix(EXIF_PREFIX)
    return exif


def reset_orientation(exif: bytes) -> tuple[int, bytes]:
    """Reads the orientation of an EXIF block and sets its tag to 1, changing no other byte.

    The block is patched in place, for re-encoding it would move what maker notes refer to by offset.

    Args:
        exif: EXIF as a TIFF structure, without prefix. A malformed block is returned as it is.

    Returns:
        The orientation (1 where there is none, or none that means anything) and the block with its tag at 1.
    """
    patched = bytearray(exif)
    orientation = 1
    try:
        order = {b"II": "<", b"MM": ">"}[exif[:2]]
        (directory,) = struct.unpack_from(order + "I", exif, 4)
        (count,) = struct.unpack_from(order + "H", exif, directory)
        for entry in range(directory + 2, directory + 2 + 12 * count, 12):
            tag, kind = struct.unpack_from(order + "HH", exif, entry)
            if tag == _ORIENTATION and kind in _INTEGER_TYPES:
                code = order + _INTEGER_TYPES[kind]
                (orientation,) = struct.unpack_from(code, exif, entry + 8)
                struct.pack_into(code, patched, entry + 8, 1)
    except (KeyError, struct.error):
        return 1, exif
    return (orientation if 1 <= orientation <= 8 else 1), bytes(patched)


def swaps_axes(orientation: int) -> bool:
    """Tells whether this orientation exchanges width and height.

    Args:
        orientation: EXIF orientation, 1 to 8.

    Returns:
        True for 5, 6, 7 and 8.
    """
    return orientation >= 5


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Turns stored pixels the way they are meant to be seen.

    Args:
        pixels: `(height, width)` or `(height, width, channels)`, as stored.
        orientation: EXIF orientation, 1 to 8 (EXIF 2.32, tag 0x0112): where the stored first row and first
            column lie in the scene.

    Returns:
        The same values, contiguous; height and width exchanged for orientations 5 to 8.
    """
    if swaps_axes(orientation):
        pixels = pixels.swapaxes(0, 1)
    # After the exchange: 2, 3, 6, 7 run right to left, and 3, 4, 7, 8 bottom to top.
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)
