"""Values that a file gives, checked: each error names the file, the key and the value."""

import json
import reprlib
from collections.abc import Sequence
from typing import Any

from jaxlens.calibrations._documents import Document

# Single precision holds them, with their squares.
_LARGEST_NUMBER = 1e15
_LARGEST_SIZE = 2**20
_MOST = 4096


class Keys:
    """The keys of one part of a file."""

    def __init__(self, document: Document, values: Any, place: str = ""):
        self.document, self.place = document, place
        if not isinstance(values, dict):
            raise document.wrong(f"{place or 'the file'} must hold keys with values, got {shown(values)}")
        self.values: dict[str, Any] = values

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def path(self, key: str) -> str:
        """Returns a key with where it stands."""
        return f"{self.place}.{key}" if self.place else key

    def wrong(self, key: str, message: str) -> Exception:
        """Returns an error that names the file and the key."""
        return self.document.wrong(f"{self.path(key)}: {message}")

    def get(self, key: str) -> Any:
        """Returns the value of a key that must be there."""
        if key not in self:
            there = ", ".join(str(name) for name in list(self.values)[:20])
            raise self.document.wrong(f"{self.path(key)} is missing; there are {there or 'no keys'}")
        return self.values[key]

    def inner(self, key: str) -> "Keys":
        """Returns the keys of a part that must be there."""
        return Keys(self.document, self.get(key), self.path(key))

    def text(self, key: str, default: str | None = None) -> str:
        """Returns a word; `default` where the key is not there."""
        if default is not None and key not in self:
            return default
        value = self.get(key)
        if not isinstance(value, str):
            raise self.wrong(key, f"must be a word, got {shown(value)}")
        return value

    def number(self, key: str, default: float | None = None, *, least: float | None = None) -> float:
        """Returns a finite number, larger than `least`."""
        if default is not None and key not in self:
            return default
        return self._number(key, self.get(key), least)

    def numbers(self, key: str, counts: Sequence[int] | None = None) -> tuple[float, ...]:
        """Returns finite numbers, in one of some counts; rows of numbers one after the other."""
        return self.checked(key, flat(self.get(key)), counts)

    def checked(self, key: str, found: Any, counts: Sequence[int] | None = None) -> tuple[float, ...]:
        """Returns what is given under a key as finite numbers, in one of some counts."""
        if not isinstance(found, list) or len(found) > _MOST:
            raise self.wrong(key, f"must be numbers, got {shown(found)}")
        if counts is not None and len(found) not in counts:
            listed = " or ".join(str(count) for count in counts)
            raise self.wrong(key, f"must be {listed} numbers, got {len(found)}")
        return tuple(self._number(f"{key}[{index}]", value) for index, value in enumerate(found))

    def positive(self, key: str, value: float) -> float:
        """Returns a number that must be positive."""
        return self._number(key, value, 0.0)

    def whole(self, key: str, value: Any) -> int:
        """Returns a number of pixels."""
        number = self._number(key, value, 0.0)
        if number != int(number) or number > _LARGEST_SIZE:
            raise self.wrong(key, f"must be a whole number of pixels, at most {_LARGEST_SIZE}, got {shown(value)}")
        return int(number)

    def size(self, width: str, height: str) -> tuple[int, int]:
        """Returns (width, height), each under a key of its own."""
        return self.whole(width, self.get(width)), self.whole(height, self.get(height))

    def _number(self, key: str, value: Any, least: float | None = None) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong(key, f"must be a number, got {shown(value)}")
        if not abs(value) <= _LARGEST_NUMBER:
            raise self.wrong(key, f"must be a finite number of usual size, got {shown(value)}")
        if least is not None and value <= least:
            raise self.wrong(key, f"must be larger than {least:g}, got {shown(value)}")
        return float(value)


def flat(value: Any) -> Any:
    """Returns a list of lists as one list, a number as a list of it; what is neither as it is."""
    if isinstance(value, list):
        return [one for row in value for one in (row if isinstance(row, list) else [row])]
    return [value] if isinstance(value, int | float) else value


def shown(value: object) -> str:
    """Returns a value as messages show it, cut where it is long."""
    if isinstance(value, int) and abs(value) > _LARGEST_NUMBER:
        return "an integer of many digits"
    return reprlib.repr(value)


def quoted(text: str) -> str:
    """Returns a word as YAML and JSON both read it."""
    return json.dumps(text, ensure_ascii=False)
