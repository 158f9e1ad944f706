"""EXIF in TIFF files: its directories are spread over the file; Pillow reads them, and lays them out anew.

An EXIF block and a TIFF are made of the same parts (TIFF 6.0, section 2): directories, and values at offsets counted
from the start. So to move a directory is to read it, and to write it for another place.
"""

import io
import struct
import warnings
from dataclasses import dataclass
from typing import BinaryIO, Literal

from PIL.TiffImagePlugin import ImageFileDirectory_v2

ORIENTATION = 274
NESTED = {34665: "ExifTag", 34853: "GPSTag"}
"""Tags of the main directory that lead to another, by the names that tifffile has for them."""
# Make, Model, Orientation, Software, DateTime, Artist, HostComputer, Copyright. ImageDescription is left out: in TIFF
# it is where programs put descriptions of the array, which a warp would make false.
_KEPT = (271, 272, ORIENTATION, 305, 306, 315, 316, 33432, *NESTED)
_INSIDE = {None: tuple(NESTED), 34665: (40965,)}
# Entries may all point at the same bytes, so that a small file could ask for any amount of memory.
_MAX_BYTES = 16_000_000


@dataclass(frozen=True)
class Directory:
    """A directory of EXIF, and those that it leads to.

    Attributes:
        entries: Values by tag, with their types; texts are bytes.
        inner: Directories by the tag that leads to them.
    """

    entries: ImageFileDirectory_v2
    inner: "dict[int, Directory]"

    @property
    def order(self) -> Literal["<", ">"]:
        """The byte order, `"<"` or `">"`."""
        return ">" if self.entries.prefix == b"MM" else "<"

    def lay_out(self, at: int) -> tuple[bytes, int]:
        """Returns the bytes to write at the even offset `at` of a file, and where in the file the directory is then."""
        data = b""
        for tag, directory in self.inner.items():
            laid, self.entries[tag] = directory.lay_out(at + len(data))
            data += laid
        return data + self.entries.tobytes(at + len(data)), at + len(data)

    def block(self) -> bytes:
        """Returns an EXIF block, without prefix, of which this is the main directory."""
        data, place = self.lay_out(8)
        return self.entries.prefix + struct.pack(self.order + "HI", 42, place) + data


def read_exif(file: BinaryIO | io.BytesIO) -> Directory | None:
    """Reads the descriptive tags of a TIFF (not a BigTIFF) or an EXIF block, and its EXIF and GPS directories.

    Args:
        file: The file, or the block without prefix.

    Returns:
        What there is; None for nothing. A UserWarning tells of what is damaged.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            file.seek(0)
            header = file.read(8)
            found = _read(_Bounded(file), header, ImageFileDirectory_v2(header).next)
            damage = f"in part ({caught[0].message})" if caught else ""
        except Exception as error:  # a damaged directory makes Pillow raise many things
            found, damage = None, f"({error})"
    if damage:
        # Pixels are what is asked for: a bad note beside them is no reason to refuse them.
        warnings.warn(f"the EXIF is damaged and left out {damage}", stacklevel=5)
    return found if found is not None and len(found.entries) else None


class _Bounded:
    """A file of which no more than `_MAX_BYTES` are read."""

    def __init__(self, file: BinaryIO | io.BytesIO):
        self.seek, self.tell, self._read, self._left = file.seek, file.tell, file.read, _MAX_BYTES

    def read(self, size: int) -> bytes:
        self._left -= size
        if self._left < 0:
            raise ValueError(f"its values take more than {_MAX_BYTES} bytes")
        return self._read(size)


def _read(file: _Bounded, header: bytes, offset: int, owner: int | None = None) -> Directory:
    entries = ImageFileDirectory_v2(header, group=owner)
    file.seek(offset)
    entries.load(file)  # pyright: ignore[reportArgumentType]
    inner = {}
    for tag in list(entries):
        if owner is None and tag not in _KEPT:
            del entries[tag]
        elif tag in _INSIDE.get(owner, ()):
            inner[tag] = _read(file, header, entries[tag], tag)
        elif isinstance(entries[tag], str):
            # Texts may be in any encoding, and Pillow would write ASCII.
            entries[tag] = entries[tag].encode("latin-1")
    return Directory(entries, inner)
