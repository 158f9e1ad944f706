"""What an experiment hands back, and the bar that it moves."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@dataclass(frozen=True)
class Outcome:
    """What an experiment found, beside the files it wrote.

    Attributes:
        inputs: Facts on each image, for the manifest.
        facts: Other facts for the manifest; finite numbers, strings and lists.
        report: What the terminal shows.
    """

    inputs: list[dict[str, object]]
    facts: dict[str, object]
    report: list[RenderableType]


@contextmanager
def progress_bar(console: Console, description: str, total: int) -> Iterator[Callable[[int], None]]:
    """Shows a bar while the block runs; gives the function that moves it."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(description, total=total)
        yield lambda steps: bar.advance(task, steps)
