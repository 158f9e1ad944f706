"""Meshes as files: of all kinds, the hostile ones too."""

import struct
import sys

import numpy as np
import pytest

from jaxlens import meshes
from jaxlens.surfaces import Mesh, from_mesh

pytest.importorskip("trimesh", reason="the extra `meshes` is not installed")

SQUARE = ([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]])


def _with_texture():
    coordinates = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return Mesh(np.asarray(SQUARE[0]), np.asarray(SQUARE[1]), texture_coordinates=coordinates)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "OBJ"])
def test_written_and_read_again(x64, tmp_path, suffix):
    path = tmp_path / f"square.{suffix}"
    meshes.write(path, _with_texture())
    with pytest.raises(FileExistsError):
        meshes.write(path, _with_texture())
    meshes.write(path, _with_texture(), overwrite=True)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    found = meshes.read(path)
    np.testing.assert_allclose(
        np.asarray(found.vertices)[np.asarray(found.faces)], np.asarray(SQUARE[0])[SQUARE[1]], atol=1e-7
    )
    if suffix.lower() != "stl":
        place = [
            np.flatnonzero((np.asarray(SQUARE[0]) == vertex).all(axis=1))[0] for vertex in np.asarray(found.vertices)
        ]
        np.testing.assert_allclose(found.texture_coordinates, np.asarray(_with_texture().texture_coordinates)[place])
    depth_map = from_mesh(found, 6, 7)
    assert bool(depth_map.mask.any())


def test_objects_of_a_file_are_merged_and_polygons_cut(x64, tmp_path):
    text = "o a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\no b\nv 5 0 2\nv 6 0 2\nv 5 1 2\nusemtl other\nf 5 6 7\n"
    (tmp_path / "two.obj").write_text(text)
    mesh = meshes.read(tmp_path / "two.obj")
    assert mesh.faces.shape == (3, 3)
    assert sorted(set(np.asarray(mesh.vertices)[np.asarray(mesh.faces)][..., 2].ravel().tolist())) == [0.0, 2.0]


def test_nothing_beside_the_file_is_read(x64, tmp_path, monkeypatch):
    """Neither material libraries nor textures, wherever they claim to be."""
    opened = []
    (tmp_path / "secret.mtl").write_text("newmtl m\nmap_Kd secret.png\n")
    (tmp_path / "in").mkdir()
    obj = tmp_path / "in" / "a.obj"
    obj.write_text("mtllib ../secret.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    ply = tmp_path / "in" / "a.ply"
    ply.write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile ../secret.mtl\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    meshes.read(obj)  # what is imported late, is imported now

    def hook(event, arguments):
        if event == "open" and watching:
            opened.append(str(arguments[0]))

    watching = True
    sys.addaudithook(hook)
    try:
        meshes.read(obj)
        meshes.read(ply)
    finally:
        watching = False
    assert not [name for name in opened if "secret" in name]


def _binary_ply(count):
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode() + np.zeros((3, 3), "<f4").tobytes() + struct.pack("<B3i", 3, 0, 1, 2)


BAD = {
    "cloud.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces .3 points.; a surface needs triangles"),
    "nan.obj": (b"v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", "finite, got .1.0, nan, 0.0. at index 1"),
    "inf.stl": (
        b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex inf 0 0\nvertex 0 1 0\nendloop\n"
        b"endfacet\nendsolid\n",
        "finite, got .inf, 0.0, 0.0. at index 1",
    ),
    "beyond.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "could not be read as OBJ|must index"),
    "beyond.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
        "could not be read as PLY|must index the 3 vertices, from 0, got .0, 1, 7. at face 0",
    ),
    "words.obj": (b"v 0 0 0\nv one 0 0\nv 0 1 0\nf 1 2 3\n", "could not be read as OBJ|has no faces"),
    "liar.ply": (_binary_ply(10**12), "could not be read as PLY|has no faces"),
    "empty.ply": (b"", "could not be read as PLY|has no faces"),
    "empty.obj": (b"", "could not be read as OBJ|has no faces"),
    "noise.stl": (np.random.default_rng(3).bytes(500), "could not be read as STL|has no faces"),
    "noise.ply": (np.random.default_rng(4).bytes(500), "could not be read as PLY|has no faces"),
    "noise.obj": (np.random.default_rng(5).bytes(500), "could not be read as OBJ|has no faces"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path, name):
    data, message = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=message):
        meshes.read(tmp_path / name)


def test_other_endings_and_too_large_files(tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.obj, \.ply, \.stl, got 'head\.fbx'; convert it first"):
        meshes.read("head.fbx")
    with pytest.raises(FileNotFoundError):
        meshes.read(tmp_path / "none.obj")
    (tmp_path / "a.obj").write_text("v 0 0 0\n" * 100)
    with pytest.raises(ValueError, match="larger than 700 bytes"):
        meshes.read(tmp_path / "a.obj", largest=700)


def test_without_trimesh(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxlens\[meshes\]'"):
        meshes.read(tmp_path / "a.obj")
