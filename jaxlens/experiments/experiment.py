"""What every experiment says in its file, and what it does: the class that a kind of experiment extends."""

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field
from rich.console import Console

from jaxlens.experiments.outcome import Outcome
from jaxlens.experiments.schema import Image, Name, Table

if TYPE_CHECKING:
    from jaxlens.experiments.config import Configuration


class Experiment(Table):
    """A kind of experiment: a subclass adds the keys of its TOML file as fields, and `run`.

    `kind = "rotation"` is the subclass in `rotation.py` beside the TOML file. That module is imported to check the
    file, so it imports what is heavy, JAX and matplotlib, inside functions. Everything else follows from the fields:

    - A key that names a file to read is marked by `InputFile`; the file must be there, and its checksum is recorded.
    - `jaxlens sweep --image` puts a picture in the place of the key `image`; override `with_picture` for another rule.
    - Results depend on all keys but those of `presentation`; they are made again when one changes, or a module that
      the kind's own module imports.

    Attributes:
        name: Of the results' folder.
        title: Of the report and the figures.
        dtype: In which everything is computed.
        seed: Of random patterns.
        order: Of its section on the page that `jaxlens reproduce` writes; the least comes first.
        caption: What the section begins with: what was done, and what came out.
        captions: Of figures and tables, by the names of their files without the suffix, in the order of the page.
        kind: Of the experiment.
    """

    # What is only shown: it changes no result.
    presentation: ClassVar = ("order", "caption", "captions")

    name: Name
    title: str | None = None
    dtype: Literal["float32", "float64"] = "float64"
    seed: int = Field(default=0, ge=0, lt=2**32)
    order: int = 1000
    caption: str = ""
    captions: dict[str, str] = Field(default={})
    kind: str

    @property
    def heading(self) -> str:
        """The title, or the name in its place."""
        return self.title or self.name

    def run(self, configuration: "Configuration", folder: Path, progress: Console) -> Outcome:
        """Computes, and writes tables and figures into a folder.

        JAX computes in `dtype`, and matplotlib draws in the style of `jaxlens.figures`, when this is called.

        Args:
            configuration: Where the experiment was read, and where its input files lie.
            folder: For the results; empty.
            progress: Where a bar may be drawn, see `progress_bar`.

        Raises:
            ConfigError: a key does not suit what was read.
            ExperimentError: it cannot be carried out.
        """
        raise NotImplementedError

    def with_picture(self, path: str) -> "Experiment":
        """Returns the experiment with a picture file, all of it, in place of its image.

        Raises:
            ValueError: it takes no picture.
        """
        image = getattr(self, "image", None)
        if not isinstance(image, Image):
            raise ValueError(f"kind = '{self.kind}' takes no picture; leave the image out")
        return self.model_copy(update={"image": image.replaced_by(path)})

    def as_dict(self) -> dict[str, object]:
        """Returns what decides the results as plain data, defaults included."""
        return self.model_dump(mode="json", exclude_none=True, exclude=set(self.presentation))
