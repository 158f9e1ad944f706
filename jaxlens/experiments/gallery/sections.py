"""What the page shows of an experiment: its figures, tables, parameters and provenance, as values for the template."""

import base64
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from jaxlens.experiments.errors import ExperimentError
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.folders import MANIFEST
from jaxlens.experiments.gallery.tables import Comparison, CsvTable, comparison, csv_table

# By suffix, the best first: of files with one stem, the first is shown.
MEDIA = {
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".webp": "image/webp",
    ".gif": "image/gif",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
}
# Of a manifest, what has a place of its own on the page.
_ELSEWHERE = ("tool", "configuration", "files")
# A figure of the usual width, 7 inches, fills the column; letters are of one size in all figures.
_PIXELS_PER_INCH = 800 / 7
_POINTS_PER_INCH = 72


@dataclass(frozen=True)
class Figure:
    """A figure as the page shows it.

    Attributes:
        stem: Its name, without suffix.
        caption: What it shows; may be empty.
        alternative: The caption's first sentence, or a name, for those who do not see it.
        files: The names of the files that hold it, the one that is shown first.
        source: Where the browser finds it: the file, relative to the page, or all of it as `data:…`.
        width: In pixels of the page, if known.
        height: Likewise.
    """

    stem: str
    caption: str
    alternative: str
    files: list[str]
    source: str
    width: int | None
    height: int | None


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

    @property
    def manifest_name(self) -> str:
        """The manifest's file."""
        return MANIFEST

    def files(self) -> list[Path]:
        """Returns the files of results that the manifest lists and that are there, the captioned ones first."""
        names = [name for name in self._manifest_table("files") if Path(name).name == name]
        order = [*self.experiment.captions, "table"]
        paths = [path for name in sorted(names) if (path := self.folder / name).is_file()]
        return sorted(paths, key=lambda path: order.index(path.stem) if path.stem in order else len(order))

    def checksums(self) -> list[tuple[str, str]]:
        """Returns the files' names and SHA-256, as the manifest has them."""
        sums = self._manifest_table("files")
        return [(path.name, str(sums[path.name])) for path in sorted(self.files())]

    def figures(self, *, embed: bool) -> list[Figure]:
        """Returns the figures, each once.

        Args:
            embed: Whether the page holds the figures themselves, or links them.

        Raises:
            ExperimentError: a file cannot be read, or is no picture.
        """
        found: dict[str, list[Path]] = {}
        for path in self.files():
            if path.suffix.lower() in MEDIA:
                found.setdefault(path.stem, []).append(path)
        ranks = list(MEDIA)
        return [
            self._figure(stem, sorted(paths, key=lambda path: ranks.index(path.suffix.lower())), embed)
            for stem, paths in found.items()
        ]

    def _figure(self, stem: str, paths: list[Path], embed: bool) -> Figure:
        caption, shown = self.experiment.captions.get(stem, ""), paths[0]
        # As an image of its own, embedded or not: no script in an SVG runs, and its ids cannot meet those of another.
        source = f"{quote(self.experiment.name, safe='')}/{quote(shown.name, safe='')}"
        try:
            size = _size(shown)
            if embed:
                source = f"data:{MEDIA[shown.suffix.lower()]};base64,{base64.b64encode(shown.read_bytes()).decode()}"
        except OSError as error:
            raise ExperimentError(f"cannot read the figure {str(shown)!r}: {error.strerror or error}") from error
        alternative = _first_sentence(caption) or f"{self.title}: {stem.replace('_', ' ')}"
        return Figure(stem, caption, alternative, [path.name for path in paths], source, *size)

    def tables(self) -> list[CsvTable]:
        """Returns the CSV files."""
        captions = self.experiment.captions
        tables = (csv_table(path, captions.get(path.stem, "")) for path in self.files() if path.suffix == ".csv")
        return [table for table in tables if table is not None]

    def comparison(self) -> Comparison | None:
        """Returns the paper's Table 1 beside ours, where the experiment asks for it and has its lenses."""
        if getattr(self.experiment, "compare", None) != "table1":
            return None
        return next((comparison(path) for path in self.files() if path.name == "table.csv"), None)

    def parameters(self) -> list[tuple[str, str]]:
        """Returns what the experiment was given, by dotted names."""
        return _flat(self._manifest_table("configuration"))

    def facts(self) -> list[tuple[str, str]]:
        """Returns what else the manifest says, by dotted names."""
        return _flat({key: value for key, value in (self.manifest or {}).items() if key not in _ELSEWHERE})

    def _manifest_table(self, name: str) -> dict[str, object]:
        table = (self.manifest or {}).get(name)
        return table if isinstance(table, dict) else {}


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[.!?])\s+(?=[A-ZΦκ])", text, maxsplit=1)[0]


def _size(path: Path) -> tuple[int | None, int | None]:
    """Width and height on the page: in proportion to what they are on paper, where the file says that."""
    if path.suffix.lower() == ".svg":
        with path.open("rb") as file:
            root = re.search(rb"<svg\b[^>]*>", file.read(10_000))
        sides = [re.search(rb'\b%s="([0-9.]+)pt"' % side, root[0]) if root else None for side in (b"width", b"height")]
        inches = [float(side[1]) / _POINTS_PER_INCH for side in sides if side]
    else:
        import PIL.Image

        with PIL.Image.open(path) as picture:
            resolution = picture.info.get("dpi", (0, 0))
            if not all(resolution):
                return picture.size
            inches = [pixels / float(dpi) for pixels, dpi in zip(picture.size, resolution, strict=True)]
    if len(inches) < 2:
        return None, None
    width, height = (round(side * _PIXELS_PER_INCH) for side in inches)
    return width, height


def _flat(facts: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    """Names and values, one line each; a list of plain values is one line."""
    lines: list[tuple[str, str]] = []
    for key, value in facts.items():
        name = f"{prefix}{key}"
        if isinstance(value, list) and any(isinstance(one, dict) for one in value):
            value = {str(index): one for index, one in enumerate(value)}
        if isinstance(value, dict):
            lines += _flat(value, f"{name}.")
        else:
            lines.append((name, _plain(value)))
    return lines


def _plain(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_plain(one) for one in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.12g}"
    return "–" if value is None else str(value)
