"""EXIF's directories, copied between an EXIF block and a TIFF file with every type and byte kept.

Both are made of the same parts (TIFF 6.0, section 2): a directory is a table of entries, and an entry's value,
when longer than 4 bytes, lies elsewhere, at an offset counted from the start. To move a directory is to lay
these offsets out anew.
"""

import io
import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import BinaryIO, Literal

EXIF_DIRECTORY, GPS_DIRECTORY, INTEROPERABILITY_DIRECTORY = 34665, 34853, 40965
"""Tags whose value is the offset of another directory."""
_INSIDE = {None: (EXIF_DIRECTORY, GPS_DIRECTORY), EXIF_DIRECTORY: (INTEROPERABILITY_DIRECTORY,)}
_LONG = 4
# Bytes a value of each type takes, BYTE to IFD.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
# Entries may all point at the same bytes, so that a small file could ask for any amount of memory.
_MAX_BYTES = 16_000_000


@dataclass(frozen=True)
class Entry:
    """One entry of a directory.

    Attributes:
        tag: What it is, as a TIFF or EXIF tag number.
        kind: Type of its values, 1 (BYTE) to 13 (IFD).
        count: Number of values.
        value: The values' bytes in the byte order of their file, or the entries of the directory it stands for.
    """

    tag: int
    kind: int
    count: int
    value: "bytes | tuple[Entry, ...]"


def parse_exif(block: bytes) -> tuple[Literal["<", ">"], tuple[Entry, ...]]:
    """Read the main directory of an EXIF block, and those within.

    Args:
        block: EXIF as a TIFF structure, without prefix.

    Returns:
        The byte order, `"<"` or `">"`, and the entries.

    Raises:
        ValueError: the block is malformed.
    """
    orders: dict[bytes, Literal["<", ">"]] = {b"II": "<", b"MM": ">"}
    order = orders.get(block[:2])
    if order is None or len(block) < 8:
        raise ValueError(f"an EXIF block begins with {block[:8]!r}")
    (offset,) = struct.unpack_from(order + "I", block, 4)
    return order, read_directory(io.BytesIO(block), order, offset)


def build_exif(entries: Collection[Entry], order: str) -> bytes:
    """Make an EXIF block of entries.

    Args:
        entries: Those of the main directory.
        order: Byte order of their values.

    Returns:
        EXIF as a TIFF structure, without prefix.
    """
    mark = b"II" if order == "<" else b"MM"
    return mark + struct.pack(order + "HI", 42, 8) + lay_out(entries, order, 8)


def read_directory(file: BinaryIO | io.BytesIO, order: str, offset: int, owner: int | None = None) -> tuple[Entry, ...]:
    """Read a directory and those within, at most two levels deep.

    Args:
        file: A TIFF (not BigTIFF) file or an EXIF block.
        order: Its byte order.
        offset: Where the directory begins.
        owner: The tag that leads to it; None for the main directory.

    Returns:
        Its entries. Those of unknown type, and those whose value lies outside the file, are left out.

    Raises:
        ValueError: there is no directory there, or its values are too large altogether.
    """
    (count,) = struct.unpack(order + "H", _read(file, offset, 2))
    table = _read(file, offset + 2, 12 * count)
    entries, total = [], 0
    for tag, kind, number, inline in struct.iter_unpack(order + "HHI4s", table):
        size = _SIZES.get(kind, 0) * number
        (place,) = struct.unpack(order + "I", inline)
        total += size
        if total > _MAX_BYTES:
            raise ValueError(f"its values take more than {_MAX_BYTES} bytes")
        try:
            if tag in _INSIDE.get(owner, ()):
                entries.append(Entry(tag, _LONG, 1, read_directory(file, order, place, tag)))
            elif size > 0:
                value = inline[:size] if size <= 4 else _read(file, place, size)
                entries.append(Entry(tag, kind, number, value))
        except ValueError:
            continue
    return tuple(entries)


def lay_out(entries: Collection[Entry], order: str, at: int) -> bytes:
    """Encode a directory, and those within, for a given place in a file.

    Args:
        entries: In any order; values in the byte order `order`.
        order: Byte order of the file.
        at: Where the directory will begin, an even offset.

    Returns:
        The bytes to write there; an even number.
    """
    table = struct.pack(order + "H", len(entries))
    values = b""
    values_at = at + 2 + 12 * len(entries) + 4
    for entry in sorted(entries, key=lambda entry: entry.tag):
        value = entry.value
        if isinstance(value, tuple):
            value = lay_out(value, order, values_at + len(values))
            inline = None
        else:
            inline = value.ljust(4, b"\0") if len(value) <= 4 else None
        if inline is None:
            inline = struct.pack(order + "I", values_at + len(values))
            values += value + b"\0" * (len(value) % 2)
        table += struct.pack(order + "HHI4s", entry.tag, entry.kind, entry.count, inline)
    return table + bytes(4) + values


def _read(file: BinaryIO | io.BytesIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    data = file.read(size)
    if len(data) != size:
        raise ValueError(f"{size} bytes at offset {offset} lie beyond the end")
    return data
