"""Mesh files for the commands: which files are meshes, and errors in the words of the command line."""

from pathlib import Path
from typing import TYPE_CHECKING

from jaxlens.cli.errors import CommandError

if TYPE_CHECKING:
    from jaxlens.surfaces import Mesh

_SUFFIXES = (".obj", ".ply", ".stl")


def is_mesh(path: Path) -> bool:
    """Tells by its suffix whether a file is a mesh; anything else is taken for a picture."""
    return path.suffix.lower() in _SUFFIXES


def load_mesh(path: Path) -> "Mesh":
    """Reads a mesh.

    Raises:
        CommandError: it cannot be read, or trimesh is not installed.
    """
    from jaxlens import meshes

    try:
        return meshes.read(path)
    except (ValueError, ImportError) as error:
        raise CommandError(f"{str(path)!r}: {error}") from error
    except OSError as error:
        raise CommandError(f"cannot read {str(path)!r}: {error.strerror or error}") from error


def store_mesh(path: Path, mesh: "Mesh", *, overwrite: bool) -> None:
    """Writes a mesh, whole or not at all.

    Raises:
        CommandError: it cannot be written.
    """
    from jaxlens import meshes

    try:
        meshes.write(path, mesh, overwrite=overwrite)
    except FileExistsError:
        raise CommandError(f"{str(path)!r} exists; pass --overwrite to replace it") from None
    except (ValueError, ImportError, OSError) as error:
        raise CommandError(f"cannot write {str(path)!r}: {error}") from error
