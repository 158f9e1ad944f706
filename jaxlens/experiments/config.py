"""From a TOML file to a checked experiment, or to a message that says what to change."""

import difflib
import hashlib
import json
import math
import os
import tomllib
import types
import typing
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from jaxlens.experiments.errors import ConfigError
from jaxlens.experiments.schema import (
    KINDS,
    BoardsExperiment,
    Experiment,
    GeodesicsExperiment,
    GridsExperiment,
    Image,
    ReadingsExperiment,
    RotationExperiment,
    UnknownExperiment,
)

_LONGEST_VALUE = 60


@dataclass(frozen=True)
class Configuration:
    """An experiment and where it was read.

    Attributes:
        experiment: What the file says, checked.
        path: The file.
        picture: A picture that stands in for the configured images, given where the experiment was started.
    """

    experiment: Experiment
    path: Path
    picture: Path | None = None

    def digest(self) -> str:
        """Returns the SHA-256 of what decides the results, defaults included; comments, layout and captions are not."""
        return hashlib.sha256(json.dumps(self.as_dict(), sort_keys=True).encode()).hexdigest()

    def as_dict(self) -> dict[str, Any]:
        """Returns what decides the results as plain data, defaults included."""
        experiment = self.experiment
        return experiment.model_dump(mode="json", exclude_none=True, exclude=set(experiment.presentation))

    def image_path(self, image: Image) -> Path | None:
        """Returns where an image's file lies, if it is one."""
        if image.path is None:
            return None
        if self.picture is None or image.path != self.picture.name:
            return self.path.parent / image.path
        return self.picture

    def input_files(self) -> dict[str, Path]:
        """Returns the files that the experiment reads, by the keys that name them; not those of installed packages."""
        return {key: path for key, _, path, _ in _inputs(self)}

    def missing_input(self) -> str | None:
        """Says which file that the experiment reads is not there; None if all are."""
        for key, value, path, noun in _inputs(self):
            if not path.is_file():
                place = "a relative path is taken from the configuration's folder"
                return f"{key}: got {_show(value)}; there is no such {noun} ({place})"
        return None

    def with_image(self, path: str | os.PathLike[str]) -> "Configuration":
        """Returns the experiment with one picture file, all of it, in place of its images.

        Raises:
            ConfigError: the experiment has no image, or there is no such file.
        """
        experiment, path = self.experiment, Path(path)
        if isinstance(experiment, GridsExperiment):
            raise ConfigError(f"{self.path}: kind = 'grids' draws its own lines; leave the image out")
        if isinstance(experiment, BoardsExperiment):
            raise ConfigError(f"{self.path}: kind = 'boards' is about corners, not a picture; leave the image out")
        if isinstance(experiment, GeodesicsExperiment | RotationExperiment | UnknownExperiment):
            raise ConfigError(f"{self.path}: kind = '{experiment.kind}' takes no picture; leave the image out")
        old = experiment.images[0] if isinstance(experiment, ReadingsExperiment) else experiment.image
        if not path.is_file():
            raise ConfigError(f"image: got {_show(str(path))}; there is no such picture file")
        # The folder it lies in is no part of the experiment, nor of its hash.
        new = Image(path=path.name, gray=old.gray, peak=old.peak)
        change = {"images": [new]} if isinstance(experiment, ReadingsExperiment) else {"image": new}
        return Configuration(experiment.model_copy(update=change), self.path, path)


def load(
    path: str | os.PathLike[str], *, image: str | os.PathLike[str] | None = None, inputs: bool = True
) -> Configuration:
    """Reads and checks an experiment's file.

    Args:
        path: The TOML file.
        image: A picture file to take in place of the configured image: the whole picture, with the configured
            `gray` and `peak`.
        inputs: Check that the files that it names are there.

    Raises:
        ConfigError: the file, or one that it names, is not there; it is not TOML; or a key or value is not allowed.
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
    configuration = Configuration(_parse(document, path), path)
    if image is not None:
        return configuration.with_image(image)
    missing = configuration.missing_input() if inputs else None
    if missing is not None:
        raise ConfigError(f"{path}: {missing}")
    return configuration


def _parse(document: dict[str, Any], path: Path) -> Experiment:
    kind = document.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        got = "is missing" if kind is None else f"got {_show(kind)}"
        raise ConfigError(f"{path}: kind: {got}; must be one of {_options(KINDS)}")
    try:
        return KINDS[kind].model_validate(document)
    except ValidationError as error:
        lines = [f"{path}: {_explain(detail, KINDS[kind], document)}" for detail in error.errors()]
        raise ConfigError("\n".join(dict.fromkeys(lines))) from None


def _inputs(configuration: Configuration) -> Iterator[tuple[str, str, Path, str]]:
    """Key, value, place and nature of each file that an experiment reads."""
    experiment = configuration.experiment
    if isinstance(experiment, BoardsExperiment):
        yield "corners", experiment.corners, configuration.path.parent / experiment.corners, "CSV file"
    if isinstance(experiment, GeodesicsExperiment) and experiment.surface.path is not None:
        path = experiment.surface.path
        yield "surface.path", path, configuration.path.parent / path, "mesh file"
    for name, value in experiment:
        images = (
            {f"{name}[{index}]": one for index, one in enumerate(value)} if isinstance(value, list) else {name: value}
        )
        for key, image in images.items():
            path = configuration.image_path(image) if isinstance(image, Image) else None
            if path is not None:
                yield f"{key}.path", str(image.path), path, "picture file"


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
