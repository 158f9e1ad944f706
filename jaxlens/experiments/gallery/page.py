"""The page's file: written whole or not at all, in place of nothing but its earlier self, and only when it differs."""

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path

import jaxlens
from jaxlens.experiments import paper
from jaxlens.experiments.errors import ExperimentError
from jaxlens.experiments.gallery.sections import Section
from jaxlens.files import file_sha256, write_text

_TEMPLATES = Path(__file__).with_name("templates")
_START = re.compile(r"<!DOCTYPE html>\n<!-- jaxlens reproduce: made from ([0-9a-f]{64}), holding ([0-9a-f]{64}) -->\n")


def check_page(path: Path) -> None:
    """Checks that nothing but an earlier page would be replaced.

    Raises:
        ExperimentError: says what is in the way.
    """
    if (path.exists() or path.is_symlink()) and _read(path) is None:
        raise ExperimentError(
            f"{str(path)!r} is no page that jaxlens wrote; move it away, or choose another place for the results"
        )


def write_page(path: Path, sections: Sequence[Section], *, embed: bool = False) -> None:
    """Writes the page of all results; one that is right already is left alone.

    Args:
        path: The page. The sections' folders lie beside it.
        sections: In their order.
        embed: Whether it holds the figures themselves, so that it can be sent alone, or links them.

    Raises:
        ExperimentError: something else is in its place, a figure cannot be read, or the page cannot be written.
    """
    check_page(path)
    made_from = _digest(sections, embed)
    if _read(path) == made_from:
        return
    body = _render(sections, embed)
    start = f"<!DOCTYPE html>\n<!-- jaxlens reproduce: made from {made_from}, holding {_sha256(body)} -->\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, start + body, overwrite=True)
    except OSError as error:
        raise ExperimentError(f"cannot write the page {str(path)!r}: {error.strerror or error}") from error


def _render(sections: Sequence[Section], embed: bool) -> str:
    """The page, from `<html>` on; text from experiments is escaped."""
    # Not needed by those who run one experiment.
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("page.html").render(sections=sections, embed=embed)


def _read(path: Path) -> str | None:
    """What a page was made from; empty if it has been edited since, None if it is not ours."""
    try:
        text = path.read_bytes().decode()
    except (OSError, UnicodeDecodeError):
        return None
    start = _START.match(text)
    if start is None:
        return None
    return start[1] if _sha256(text[start.end() :]) == start[2] else ""


def _digest(sections: Sequence[Section], embed: bool) -> str:
    """Of everything that decides the page's bytes: to make it takes JAX, to see that it is the same does not."""
    code = [
        *sorted(path for path in Path(__file__).parent.rglob("*") if path.suffix in (".py", ".html", ".css")),
        Path(paper.__file__),
        # Without importing it, which takes JAX.
        Path(jaxlens.__file__).parent / "metrics" / "_table.py",
    ]
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
    return _sha256(json.dumps([embed, [file.read_text(encoding="utf-8") for file in code], facts]))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
