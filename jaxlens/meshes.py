"""Meshes as files: OBJ, PLY and STL through trimesh, none of them trusted."""

import io
import os
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from jaxlens.files import atomic_write
from jaxlens.surfaces import Mesh

SUFFIXES = (".obj", ".ply", ".stl")
"""Endings of the files that are read and written, in lower case."""
_LARGEST = 2**29


def read(path: str | os.PathLike[str], *, largest: int = _LARGEST) -> Mesh:
    """Reads a mesh from a file: OBJ, PLY or STL.

    Only the file itself is read: materials and textures that it names are not looked for. Several objects in a file
    become one mesh. Faces with more than three corners are cut into triangles. Needs the extra `meshes`.

    Args:
        path: The file; its ending tells the format.
        largest: The most bytes to read; a larger file is refused.

    Returns:
        The `Mesh`, with texture coordinates where all of the file's objects have them, in JAX's default precision.

    Raises:
        ValueError: another ending, a file too large or that is not what its ending says, no faces (a point cloud), a
            vertex that is not finite, a face that names a vertex that is not there.
        ImportError: trimesh is not installed.
        OSError: the file cannot be read.
    """
    parts = _parts(path, largest)
    for part in parts:  # each by itself, before the offsets hide a wrong index
        Mesh(np.zeros_like(part.vertices), np.asarray(part.faces))
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([np.asarray(part.vertices, np.float64) for part in parts])
    faces = np.concatenate([np.asarray(part.faces) + offset for part, offset in zip(parts, offsets[:-1], strict=True)])
    textures = [getattr(part.visual, "uv", None) for part in parts]
    if any(uv is None or len(uv) != len(part.vertices) for uv, part in zip(textures, parts, strict=True)):
        return Mesh(vertices, faces)
    coordinates = np.concatenate([np.asarray(uv, np.float64)[:, :2] for uv in textures])
    return Mesh(vertices, faces, texture_coordinates=coordinates)


def write(path: str | os.PathLike[str], mesh: Mesh, *, overwrite: bool = False) -> None:
    """Writes a mesh, whole or not at all: OBJ, PLY (binary) or STL (binary, single precision, no texture coordinates).

    Args:
        path: The file to write; its ending tells the format.
        mesh: The mesh.
        overwrite: Replace an existing file.

    Raises:
        ValueError: another ending.
        ImportError: trimesh is not installed.
        OSError: as `jaxlens.files.atomic_write`.
    """
    suffix = _format(path)
    trimesh = _trimesh()
    visual = None
    if mesh.texture_coordinates is not None and suffix != ".stl":
        visual = trimesh.visual.TextureVisuals(uv=np.asarray(mesh.texture_coordinates))
    written = trimesh.Trimesh(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False, validate=False, visual=visual
    )
    options = {"include_texture": visual is not None, "write_texture": False} if suffix == ".obj" else {}
    data = written.export(file_type=suffix[1:], **options)
    with atomic_write(path, overwrite=overwrite) as temporary:
        temporary.write_bytes(data.encode() if isinstance(data, str) else data)


def _parts(path: str | os.PathLike[str], largest: int) -> list[Any]:
    """Returns the objects of a file that have faces, as trimesh reads them."""
    suffix = _format(path)
    trimesh = _trimesh()
    with open(path, "rb") as file:
        data = file.read(largest + 1)
    if len(data) > largest:
        raise ValueError(f"{str(path)!r} is larger than {largest} bytes; pass largest=… if it can be trusted")
    try:
        with warnings.catch_warnings():
            # NumPy warns where text is no number, and stops there: half a mesh is none.
            warnings.simplefilter("error", DeprecationWarning)
            warnings.simplefilter("ignore", RuntimeWarning)  # of numbers that are not finite, which are found below
            # A stream without a name: there is no folder in which anything else could be looked for.
            scene = trimesh.load_scene(
                io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=True, maintain_order=True
            )
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
        points = sum(len(part.vertices) for part in scene.dump())
    except Exception as error:  # a parser's ways to fail are many
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"{str(path)!r} could not be read as {suffix[1:].upper()} ({reason})") from error
    if not parts:
        raise ValueError(
            f"{str(path)!r} has no faces ({points} points); a surface needs triangles: mesh the points first"
        )
    return parts


def _format(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"a mesh file ends in {', '.join(SUFFIXES)}, got {str(path)!r}; convert it first")
    return suffix


def _trimesh() -> ModuleType:
    try:
        import trimesh
    except ImportError as error:
        raise ImportError("mesh files need trimesh: pip install 'jaxlens[meshes]'") from error
    return trimesh
