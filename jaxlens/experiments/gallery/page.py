"""What the page says, section by section."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.folders import MANIFEST
from jaxlens.experiments.gallery.html import Markup, element, join, link
from jaxlens.experiments.gallery.images import MEDIA, Embedded
from jaxlens.experiments.gallery.style import STYLE
from jaxlens.experiments.gallery.tables import comparison, csv_table, facts_table

_TITLE = "Lens distortion, reproduced"
_ABOUT = (
    "Every experiment as jaxlens reproduce carried it out: figures and tables, the paper's numbers beside ours where "
    "it has any, all parameters, and the checksums of what went in and what came out. The page holds all it shows; "
    "links to files work where it lies beside their folders. When, where and on which versions a result was made "
    "stands in the run.json of its folder, on the machine that made it."
)
_PAPER = (
    "The paper is Darujati, Gumelar, Nugroho and Hariadi, “Getting 3D Facial Image Distortion Using Pincushion "
    "Deformations”."
)
# Of a manifest, what has a place of its own on the page.
_ELSEWHERE = ("tool", "configuration", "files")


@dataclass(frozen=True)
class Section:
    """An experiment on the page.

    Attributes:
        experiment: What its configuration says.
        source: The configuration's file, by its name.
        folder: Of the results, beside the page.
        manifest: As it lies in the folder; None where there are no results.
        note: What is to be said of the results: why there are none, or why they are not of this run.
    """

    experiment: Experiment
    source: str
    folder: Path
    manifest: dict[str, object] | None
    note: str = ""

    @property
    def title(self) -> str:
        """What the section is called."""
        return self.experiment.title or self.experiment.name

    def files(self) -> list[Path]:
        """Returns the files of results that the manifest lists and that are there, the captioned ones first."""
        listed = (self.manifest or {}).get("files")
        names = [name for name in listed if Path(name).name == name] if isinstance(listed, dict) else []
        order = [*self.experiment.captions, "table"]
        paths = [path for name in sorted(names) if (path := self.folder / name).is_file()]
        return sorted(paths, key=lambda path: order.index(path.stem) if path.stem in order else len(order))


def render(sections: Sequence[Section], embed: Callable[[Path], Embedded]) -> Markup:
    """Returns the page, from `<html>` on.

    Args:
        sections: In their order.
        embed: From a figure's file to what stands for it.
    """
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", _TITLE),
        element("style", Markup(STYLE)),
    )
    contents = element(
        "nav",
        element("h2", "Contents"),
        element("ol", *(_entry(section) for section in sections)),
        aria_label="Contents",
    )
    header = element("header", element("h1", _TITLE), element("p", _ABOUT), element("p", _PAPER, class_="about"))
    main = element("main", *(_section(section, embed) for section in sections))
    return element("html", head, element("body", header, contents, main), lang="en")


def _entry(section: Section) -> Markup:
    mark = element("small", "not of this run" if section.manifest else "no results") if section.note else None
    return element("li", element("a", section.title, href=f"#{section.experiment.name}"), " ", mark)


def _section(section: Section, embed: Callable[[Path], Embedded]) -> Markup:
    experiment, files = section.experiment, section.files()
    tables = [path for path in files if path.suffix == ".csv"]
    compared = getattr(experiment, "compare", None) == "table1"
    return element(
        "section",
        element("h2", section.title),
        element("p", section.source, class_="about"),
        element("p", section.note, class_="note") if section.note else None,
        element("p", experiment.caption) if experiment.caption else None,
        *(comparison(path) for path in tables if compared and path.stem == "table"),
        *(_figure(section, stem, paths, embed) for stem, paths in _by_stem(files)),
        *(csv_table(path, experiment.captions.get(path.stem, "")) for path in tables),
        *(_provenance(section, files) if section.manifest else ()),
        id=experiment.name,
    )


def _by_stem(files: Iterable[Path]) -> list[tuple[str, list[Path]]]:
    """Figures, each with the files that hold it, the best first."""
    figures: dict[str, list[Path]] = {}
    for path in files:
        if path.suffix.lower() in MEDIA:
            figures.setdefault(path.stem, []).append(path)
    ranks = list(MEDIA)
    return [(stem, sorted(paths, key=lambda path: ranks.index(path.suffix.lower()))) for stem, paths in figures.items()]


def _figure(section: Section, stem: str, paths: list[Path], embed: Callable[[Path], Embedded]) -> Markup:
    name = section.experiment.name
    caption = section.experiment.captions.get(stem, "")
    embedded = embed(paths[0])
    picture = element(
        "img",
        src=embedded.uri,
        alt=_first_sentence(caption) or f"{section.title}: {stem.replace('_', ' ')}",
        width=embedded.width,
        height=embedded.height,
    )
    files = [join(" ", link(path.suffix[1:].upper(), name, path.name)) for path in paths]
    return element(
        "figure",
        # On a phone it is as wide as the page, and a touch opens the file.
        link(picture, name, paths[0].name),
        element("figcaption", caption, element("span", *files, class_="files")),
        id=f"{name}.{stem}",
    )


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[.!?])\s+(?=[A-ZΦκ])", text, maxsplit=1)[0]


def _provenance(section: Section, files: Sequence[Path]) -> list[Markup]:
    """The parameters and the manifest, folded."""
    manifest, name = section.manifest or {}, section.experiment.name
    configuration, checksums = manifest.get("configuration"), manifest.get("files")
    parameters = configuration if isinstance(configuration, dict) else {}
    facts = {key: value for key, value in manifest.items() if key not in _ELSEWHERE}
    sums = checksums if isinstance(checksums, dict) else {}
    rows = [
        element("tr", element("th", link(path.name, name, path.name), scope="row"), element("td", str(sums[path.name])))
        for path in sorted(files)
    ]
    table = element("table", element("tbody", *rows), class_="facts")
    return [
        element("details", element("summary", "Parameters"), facts_table(parameters, "Parameters")),
        element(
            "details",
            element("summary", "Manifest"),
            facts_table(facts, "Manifest"),
            element(
                "p", "Files and their SHA-256; all of this is in ", link(MANIFEST, name, MANIFEST), ".", class_="about"
            ),
            element("div", table, class_="scroll", role="region", aria_label="Files", tabindex=0),
        ),
    ]
