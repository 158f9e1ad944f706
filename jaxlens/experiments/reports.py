"""Tables for the terminal."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text


def new_table(title: str) -> Table:
    """Returns an empty table in the reports' style; its title is shown as it is, brackets too."""
    return Table(
        title=Text(title), title_justify="left", title_style="bold", header_style="", box=SIMPLE_HEAD, pad_edge=False
    )


def plain_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Returns a table with its first column to the left and the others to the right."""
    table = new_table(title)
    for index, name in enumerate(header):
        table.add_column(name, justify="right" if index else "left")
    for row in rows:
        table.add_row(*row)
    return table
