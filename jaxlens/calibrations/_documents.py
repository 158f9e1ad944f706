"""Files of other people as plain values: JSON, YAML, XML and Python literals, read so that no file can do harm.

Sizes, depths and numbers are bounded, keys stand once, YAML makes nothing but plain values, XML has no entities.
"""

import ast
import json
import os
import re
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from defusedxml import DefusedXmlException
from defusedxml import ElementTree as Xml

from jaxlens.calibrations._calibration import CalibrationError

if TYPE_CHECKING or not yaml.__with_libyaml__:
    from yaml import SafeLoader as _SafeLoader
else:
    # Libyaml's, many times as fast.
    from yaml import CSafeLoader as _SafeLoader

# A calibration has some hundred numbers, and a file of a nerfstudio capture some thousand pictures.
_LARGEST = 4 * 2**20
_DEEPEST = 20


@dataclass(frozen=True)
class Document:
    """What is in a file: its bytes, and what they say.

    Attributes:
        name: The file's path as messages name it.
        data: Its bytes.
    """

    name: str
    data: bytes

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "Document":
        """Reads a file.

        Raises:
            CalibrationError: it cannot be read, or is larger than any calibration.
        """
        path = Path(path)
        name = repr(str(path))
        try:
            with path.open("rb") as file:
                data = file.read(_LARGEST + 1)
        except OSError as error:
            raise CalibrationError(f"cannot read the calibration {name}: {error.strerror}") from error
        if len(data) > _LARGEST:
            raise CalibrationError(f"{name} is no calibration: it is larger than {_LARGEST // 2**20} MiB")
        return cls(name, data)

    def wrong(self, message: str) -> CalibrationError:
        """Returns an error that names the file."""
        return CalibrationError(f"{self.name}: {message}")

    @property
    def is_binary(self) -> bool:
        """Whether there are bytes that no text has."""
        return b"\0" in self.data

    @cached_property
    def text(self) -> str:
        """The file as text.

        Raises:
            CalibrationError: it is not UTF-8.
        """
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise CalibrationError(f"{self.name} is no calibration: it is not UTF-8 at byte {error.start}") from error

    @property
    def is_xml(self) -> bool:
        """Whether the text is XML, or would be."""
        return self.text.lstrip().startswith("<")

    @cached_property
    def values(self) -> Any:
        """What the text says, as dictionaries, lists, numbers and strings; of JSON, YAML, XML or a Python literal.

        Raises:
            CalibrationError: it is none of these, and the message says where.
        """
        start = _COMMENTS.sub("", self.text)
        if self.is_xml:
            return _from_xml(self)
        if _PYTHON.match(start):
            return _from_python(self)
        if start.startswith(("{", "[")) or not self.text.strip():
            return _from_json(self)
        return _from_yaml(self)

    @property
    def mapping(self) -> dict[str, Any]:
        """The values where they are keys with values, and else, as of what is no text, an empty dictionary.

        Raises:
            CalibrationError: as `values`.
        """
        return self.values if not self.is_binary and isinstance(self.values, dict) else {}


_COMMENTS = re.compile(r"\A(?:\s+|#[^\n]*\n)+")
# What no JSON begins with: a key in single quotes, or a comment within.
_PYTHON = re.compile(r"\{\s*(?:#|')")


def _from_json(document: Document) -> Any:
    try:
        return json.loads(document.text, parse_constant=_refuse_constant, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        raise CalibrationError(
            f"{document.name} is no calibration: not JSON at line {error.lineno}, column {error.colno}: {error.msg}"
        ) from error
    except ValueError as error:
        raise document.wrong(str(error)) from error


def _from_python(document: Document) -> Any:
    """Reads a literal, as mrcal writes them: nothing in it is run."""
    try:
        with warnings.catch_warnings(action="ignore"):
            return ast.literal_eval(document.text)
    except SyntaxError as error:
        raise CalibrationError(
            f"{document.name} is no calibration: not a Python literal at line {error.lineno}: {error.msg}"
        ) from error
    except (ValueError, TypeError, MemoryError) as error:
        raise CalibrationError(f"{document.name} is no calibration: not a Python literal") from error


def _from_yaml(document: Document) -> Any:
    # OpenCV's first line, %YAML:1.0, is no directive of YAML.
    text = document.text.replace("%YAML", "#YAML", 1) if document.text.startswith("%YAML") else document.text
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f" at line {mark.line + 1}, column {mark.column + 1}"
        raise CalibrationError(f"{document.name} is no calibration: not YAML{where}: {error.problem}") from error
    except (yaml.YAMLError, ValueError) as error:
        said = " ".join(str(error).split())
        raise CalibrationError(f"{document.name} is no calibration: not YAML: {said}") from error


def _from_xml(document: Document) -> Any:
    try:
        root = Xml.fromstring(document.data, forbid_dtd=True)
    except Xml.ParseError as error:
        line, column = error.position
        raise CalibrationError(
            f"{document.name} is no calibration: not XML at line {line}, column {column + 1}: {error}"
        ) from error
    except DefusedXmlException as error:
        raise CalibrationError(f"{document.name}: a document type or an entity in XML is refused: delete it") from error
    except (ValueError, LookupError) as error:
        raise CalibrationError(f"{document.name} is no calibration: not XML: {error}") from error
    return {str(root.tag): _element(document, root, 0)}


def _element(document: Document, element: Any, depth: int) -> Any:
    """Returns an element's children by name, those of one name as a list; of a leaf its text, or its numbers."""
    if depth > _DEEPEST:
        raise CalibrationError(f"{document.name} is no calibration: it is nested too deeply")
    if not len(element):
        return {f"@{key}": value for key, value in element.items()} or _scalars(element.text or "")
    found: dict[str, Any] = {f"@{key}": value for key, value in element.items()}
    several: dict[str, list] = {}
    for child in element:
        several.setdefault(str(child.tag), []).append(_element(document, child, depth + 1))
    return found | {name: values[0] if len(values) == 1 else values for name, values in several.items()}


def _scalars(text: str) -> Any:
    words = text.split()
    if not words or not all(_NUMBER.fullmatch(word) for word in words):
        return text.strip().strip('"')
    numbers = [int(word) if _INTEGER.fullmatch(word) else float(word) for word in words]
    return numbers[0] if len(numbers) == 1 else numbers


# Decimal numbers alone: YAML 1.1 has 1:30 for 90 and 010 for 8 besides, and takes 1e-5 for a word.
_INTEGER = re.compile(r"[-+]?\d{1,300}", re.ASCII)
_FLOAT = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_NUMBER = _FLOAT


class _Loader(_SafeLoader):
    """YAML of plain values: no dates, no merged keys, and OpenCV's matrices."""


def _mapping(loader: Any, node: Any) -> dict:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, "a matrix has rows, cols, dt and data", node.start_mark)
    found: dict[Any, Any] = {}
    for key_node, value_node in node.value:
        if not isinstance(key_node, yaml.ScalarNode):
            raise yaml.constructor.ConstructorError(None, None, "a key is a word", key_node.start_mark)
        key = key_node.value
        if key in found:
            raise yaml.constructor.ConstructorError(None, None, f"{key} stands twice", key_node.start_mark)
        found[key] = loader.construct_object(value_node, deep=True)
    return found


_Loader.yaml_implicit_resolvers = {}
for _tag in ("map", "opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _mapping)
_Loader.add_constructor("tag:yaml.org,2002:int", lambda loader, node: int(node.value))
_Loader.add_constructor("tag:yaml.org,2002:float", lambda loader, node: float(node.value))
for _tag, _pattern, _first in (
    ("null", re.compile(r"(?:~|null|Null|NULL|)$", re.ASCII), ["~", "n", "N", ""]),
    ("bool", re.compile(r"(?:true|True|TRUE|false|False|FALSE)$", re.ASCII), list("tTfF")),
    ("int", re.compile(f"(?:{_INTEGER.pattern})$", re.ASCII), list("-+0123456789")),
    ("float", re.compile(f"(?:{_FLOAT.pattern})$", re.ASCII), list("-+.0123456789")),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", _pattern, _first)


def _refuse_constant(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key!r} stands twice")
        found[key] = value
    return found
