"""Figures as files, for the commands."""

from pathlib import Path
from typing import TYPE_CHECKING

from jaxlens.cli.errors import CommandError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_figure(path: Path, figure: "Figure", *, overwrite: bool) -> None:
    """Writes a figure as PNG, whole or not at all.

    Raises:
        CommandError: it exists, or cannot be written.
    """
    from jaxlens.figures.style import save, style
    from jaxlens.files import atomic_write

    try:
        with atomic_write(path, overwrite=overwrite) as temporary, style():
            save(figure, temporary)
    except FileExistsError:
        raise CommandError(f"{str(path)!r} exists; pass --overwrite to replace it") from None
    except OSError as error:
        raise CommandError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
