"""The page's file: written whole or not at all, in place of nothing but its earlier self, and only when it differs."""

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path

from jaxlens.experiments import paper
from jaxlens.experiments.errors import ExperimentError
from jaxlens.experiments.gallery.images import Embedded, embed
from jaxlens.experiments.gallery.page import Section, render
from jaxlens.files import file_sha256, write_text

_MARK = re.compile(r"<!-- jaxlens reproduce: made from ([0-9a-f]{64}), holding ([0-9a-f]{64}) -->\n")
_START = "<!DOCTYPE html>\n"


def check_page(path: Path) -> None:
    """Checks that nothing but an earlier page would be replaced.

    Raises:
        ExperimentError: says what is in the way.
    """
    if not path.exists() and not path.is_symlink():
        return
    if _read(path) is None:
        raise ExperimentError(
            f"{str(path)!r} is no page that jaxlens wrote; move it away, or choose another place for the results"
        )


def write_page(path: Path, sections: Sequence[Section]) -> None:
    """Writes the page of all results; one that is right already is left alone.

    Args:
        path: The page. The sections' folders lie beside it.
        sections: In their order.

    Raises:
        ExperimentError: something else is in its place, or it cannot be written.
    """
    check_page(path)
    made_from = _digest(sections)
    if _read(path) == made_from:
        return
    try:
        body = f"{render(sections, _embed)}\n"
        mark = f"<!-- jaxlens reproduce: made from {made_from}, holding {_sha256(body)} -->\n"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, _START + mark + body, overwrite=True)
    except OSError as error:
        raise ExperimentError(f"cannot write the page {str(path)!r}: {error.strerror or error}") from error


def _embed(path: Path) -> Embedded:
    try:
        return embed(path)
    except OSError as error:
        raise ExperimentError(f"cannot read the figure {str(path)!r}: {error.strerror or error}") from error


def _read(path: Path) -> str | None:
    """What a page was made from; empty if it has been edited since, None if it is not ours."""
    try:
        text = path.read_bytes().decode()
    except (OSError, UnicodeDecodeError):
        return None
    mark = _MARK.match(text, len(_START)) if text.startswith(_START) else None
    if mark is None:
        return None
    return mark[1] if _sha256(text[mark.end() :]) == mark[2] else ""


def _digest(sections: Sequence[Section]) -> str:
    """Of everything that decides the page's bytes: to make it takes seconds, to see that it is the same need not."""
    import PIL

    code = sorted([*Path(__file__).parent.glob("*.py"), Path(paper.__file__)])
    facts = [
        [
            section.source,
            section.note,
            section.manifest,
            section.experiment.model_dump(mode="json"),
            {path.name: file_sha256(path) for path in section.files()},
        ]
        for section in sections
    ]
    page = [PIL.__version__, [file.read_text(encoding="utf-8") for file in code], facts]
    return _sha256(json.dumps(page))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
