"""From a TOML file to a checked experiment, or to a message that says what to change."""

import difflib
import hashlib
import json
import math
import os
import tomllib
import types
import typing
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from jaxlens.experiments.errors import ConfigError
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.finding import Kind, find_kind

_LONGEST_VALUE = 60


@dataclass(frozen=True)
class Configuration:
    """An experiment and where it was read.

    Attributes:
        experiment: What the file says, checked.
        kind: The class that it is of, and where that is defined.
        path: The file.
        picture: A picture that stands in for the configured images, given where the experiment was started.
    """

    experiment: Experiment
    kind: Kind
    path: Path
    picture: Path | None = None

    def digest(self) -> str:
        """Returns the SHA-256 of what decides the results, defaults included; comments, layout and captions are not."""
        return hashlib.sha256(json.dumps(self.experiment.as_dict(), sort_keys=True).encode()).hexdigest()

    def file(self, name: str) -> Path:
        """Returns where a file lies that the experiment names."""
        if self.picture is not None and name == self.picture.name:
            return self.picture
        return self.path.parent / name

    def input_files(self) -> dict[str, Path]:
        """Returns the files that the experiment reads, by the keys that name them; not those of installed packages."""
        return {key: self.file(name) for key, name, _ in self.experiment.input_files()}

    def missing_input(self) -> str | None:
        """Says which file that the experiment reads is not there; None if all are."""
        for key, name, noun in self.experiment.input_files():
            if not self.file(name).is_file():
                place = "a relative path is taken from the configuration's folder"
                return f"{key}: got {_show(name)}; there is no such {noun} ({place})"
        return None

    def with_image(self, path: str | os.PathLike[str]) -> "Configuration":
        """Returns the experiment with one picture file, all of it, in place of its images.

        Raises:
            ConfigError: the experiment has no image, or there is no such file.
        """
        path = Path(path)
        try:
            # The folder it lies in is no part of the experiment, nor of its hash.
            experiment = self.experiment.with_picture(path.name)
        except ValueError as error:
            raise ConfigError(f"{self.path}: {error}") from None
        if not path.is_file():
            raise ConfigError(f"image: got {_show(str(path))}; there is no such picture file")
        return Configuration(experiment, self.kind, self.path, path)


def load(
    path: str | os.PathLike[str], *, image: str | os.PathLike[str] | None = None, inputs: bool = True
) -> Configuration:
    """Reads and checks an experiment's file. A kind that is not built in is Python beside it, which this imports.

    Args:
        path: The TOML file.
        image: A picture file to take in place of the configured image: the whole picture, with the configured
            `gray` and `peak`.
        inputs: Check that the files that it names are there.

    Raises:
        ConfigError: the file, or one that it names, is not there; it is not TOML; a key or value is not allowed; or
            its kind is not found.
    """
    path = Path(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; give the path of an experiment's TOML file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file in UTF-8; give an experiment's TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}") from None
    configuration = _parse(document, path)
    if image is not None:
        return configuration.with_image(image)
    missing = configuration.missing_input() if inputs else None
    if missing is not None:
        raise ConfigError(f"{path}: {missing}")
    return configuration


def _parse(document: dict[str, Any], path: Path) -> Configuration:
    try:
        kind = find_kind(document.get("kind"), path.parent)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    try:
        return Configuration(kind.model.model_validate(document), kind, path)
    except ValidationError as error:
        lines = [f"{path}: {_explain(detail, kind.model, document)}" for detail in error.errors()]
        raise ConfigError("\n".join(dict.fromkeys(lines))) from None


def _explain(detail: ErrorDetails, model: type[BaseModel], document: Any) -> str:
    """One line on one mistake: key, value, what is allowed."""
    location, value, kind = detail["loc"], detail["input"], detail["type"]
    key = _dotted(location)
    if kind == "extra_forbidden":
        keys = list(_model_at(model, location[:-1]).model_fields)
        near = difflib.get_close_matches(str(location[-1]), keys, n=1)
        hint = f" (did you mean '{near[0]}'?)" if near else ""
        return f"{key}: unknown key, got {_show(value)}{hint}; allowed here: {_options(keys)}"
    if kind == "missing":
        return f"{key}: is missing; add it"
    message = detail["msg"].removeprefix("Value error, ")
    if kind in ("model_type", "dict_type"):
        message = f"must be a table with the keys {_options(_model_at(model, location).model_fields)}"
    elif message.startswith("Input should be "):
        message = "must be " + message.removeprefix("Input should be ")
    elif kind == "value_error" and isinstance(value, dict):
        # A rule between the keys of a table, which the message names.
        return f"{key + ': ' if key else ''}{message}; got the keys {_options(value)}"
    return f"{key}: got {_show(value)}; {message}"


def _dotted(location: Sequence[int | str]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _model_at(model: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel]:
    """The model of the table that a key's location leads to."""
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            model = _table_in(model.model_fields[part].annotation) or model
    return model


def _table_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    return next((found for inner in typing.get_args(annotation) if (found := _table_in(inner))), None)


def _options(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _show(value: Any) -> str:
    """A value as TOML would write it, shortened."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, float) and not math.isfinite(value):
        text = str(value)
    else:
        text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"
