"""A bar on a terminal that shows how far a long computation has come."""

import contextlib
import sys
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def progress_of(description: str) -> Iterator[Callable[[int, int], None] | None]:
    """Shows a bar while the block runs, with the time that is left; gives the function that moves it.

    Args:
        description: What is computed.

    Yields:
        Takes how much is done, and of how much; it may be called from any thread. None where there is no terminal.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
