"""Meshes in files: PLY, OBJ and GLB out; PLY and OBJ in."""

from __future__ import annotations

import dataclasses
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.files import read_bytes, reading, register_reader, write_file
from gsut.surface.mesh import Mesh

# Coordinates that float32 would move by more than this share of their extent are written in double.
_FLOAT_SHARE = 1e-6
_CHANNELS = ("red", "green", "blue")  # PLY's names
_GLB_HEAD = struct.Struct("<4sII")
_GLB_CHUNK = struct.Struct("<I4s")
_FLOAT = 5126  # glTF's code of float32
_UNSIGNED = 5125  # of uint32


@name_wrong_kinds
def save_mesh(path: str | os.PathLike[str], mesh: Mesh) -> None:
    """Writes a mesh with normals and colours, in the dataset's coordinates and axes.

    Args:
        path: .ply (binary), .obj or .glb. In a .glb the vertices lie about their middle,
            which is the node's translation; colours are linear there, as glTF wants them.
        mesh: what to write.

    Raises:
        InputError: another suffix.
        InputError, also an OSError: the file cannot be written.
    """
    path = Path(path)
    content = _choose_writer(path)(mesh)
    write_file(path, content)


def check_mesh_name(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless a mesh can be written by this name."""
    _choose_writer(Path(path))


def _choose_writer(path: Path) -> Callable[[Mesh], bytes]:
    writers = {".ply": _write_ply, ".obj": _write_obj, ".glb": _write_glb}
    if path.suffix.lower() not in writers:
        raise InputError(f"{path}: meshes are written as {', '.join(writers)}")
    return writers[path.suffix.lower()]


def _to_levels(colors: np.ndarray) -> np.ndarray:
    return np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8)


def _from_levels(levels: np.ndarray | None) -> np.ndarray | None:
    return None if levels is None else levels.astype(np.float32) / np.float32(255)


def _write_ply(mesh: Mesh) -> bytes:
    extent = float(np.ptp(mesh.vertices, axis=0).max()) if len(mesh.vertices) else 1.0
    moved = np.abs(mesh.vertices - mesh.vertices.astype(np.float32)).max(initial=0.0)
    kind = ("double", "<f8") if moved > _FLOAT_SHARE * extent else ("float", "<f4")
    fields = [(axis, kind[1]) for axis in "xyz"] + [(f"n{axis}", "<f4") for axis in "xyz"]
    names = [f"property {kind[0]} {axis}" for axis in "xyz"]
    names += [f"property float n{axis}" for axis in "xyz"]
    if mesh.colors is not None:
        fields += [(name, "u1") for name in _CHANNELS]
        names += [f"property uchar {name}" for name in _CHANNELS]
    rows = np.zeros(len(mesh.vertices), fields)
    normals = mesh.compute_normals()
    for k, axis in enumerate("xyz"):
        rows[axis], rows[f"n{axis}"] = mesh.vertices[:, k], normals[:, k]
    if mesh.colors is not None:
        for k, name in enumerate(_CHANNELS):
            rows[name] = _to_levels(mesh.colors[:, k])
    faces = np.zeros(len(mesh.faces), [("count", "u1"), ("of", "<i4", 3)])
    faces["count"], faces["of"] = 3, mesh.faces
    header = [
        *("ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *names),
        *(f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"),
    ]
    return ("\n".join(header) + "\n").encode() + rows.tobytes() + faces.tobytes()


def _write_obj(mesh: Mesh) -> bytes:
    tail = [""] * len(mesh.vertices)
    if mesh.colors is not None:
        tail = [" {:.4f} {:.4f} {:.4f}".format(*color) for color in mesh.colors]
    rows = [
        "v {:.9g} {:.9g} {:.9g}".format(*vertex) + color
        for vertex, color in zip(mesh.vertices, tail, strict=True)
    ]
    rows += ["vn {:.4f} {:.4f} {:.4f}".format(*normal) for normal in mesh.compute_normals()]
    rows += ["f {0}//{0} {1}//{1} {2}//{2}".format(*face) for face in mesh.faces + np.uint32(1)]
    return ("\n".join(rows) + "\n").encode()


def _write_glb(mesh: Mesh) -> bytes:
    middle = mesh.vertices.mean(axis=0) if len(mesh.vertices) else np.zeros(3)
    places = (mesh.vertices - middle).astype(np.float32)
    arrays: list[tuple[str, np.ndarray]] = [("POSITION", places)]
    arrays.append(("NORMAL", mesh.compute_normals().astype(np.float32)))
    if mesh.colors is not None:
        c = np.clip(mesh.colors, 0, 1).astype(np.float64)
        linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        arrays.append(("COLOR_0", linear.astype(np.float32)))
    arrays.append(("", mesh.faces.astype(np.uint32)))
    views, accessors, begin = [], [], 0
    for number, (name, array) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": begin, "byteLength": array.nbytes})
        accessors.append(
            {"bufferView": number, "componentType": _FLOAT, "count": len(array), "type": "VEC3"}
            if name
            else {"bufferView": number, "componentType": _UNSIGNED, "count": array.size,
                  "type": "SCALAR"}
        )  # fmt: skip
        begin += array.nbytes
    bounds = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
    accessors[0] |= bounds if len(places) else {}
    primitive = {
        "attributes": {name: number for number, (name, _) in enumerate(arrays) if name},
        "indices": len(arrays) - 1,
        "material": 0,
    }
    matt = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    document = {
        "asset": {"version": "2.0", "generator": "gsut"},
        "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": middle.tolist()}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": matt, "doubleSided": True}],
        "buffers": [{"byteLength": begin}], "bufferViews": views, "accessors": accessors,
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = _GLB_HEAD.size + 2 * _GLB_CHUNK.size + len(text) + begin
    if total >= 2**32:
        raise InputError(f"{total:,} bytes are more than a .glb file can have; write a .ply")
    head = _GLB_HEAD.pack(b"glTF", 2, total) + _GLB_CHUNK.pack(len(text), b"JSON") + text
    return b"".join(
        [head, _GLB_CHUNK.pack(begin, b"BIN\0"), *(array.tobytes() for _, array in arrays)]
    )


@register_reader("mesh", ".ply", ".obj")
def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Reads a mesh, or a cloud of points, with the colours of its vertices.

    Args:
        path: binary .ply of triangles, or .obj, whose faces of more corners are cut into triangles.

    Returns:
        The mesh; of a cloud without faces. Colours are those of `save_mesh`: 8 bits a channel in
        .ply, fractions in .obj.

    Raises:
        InputError: the file is absent, damaged or of another format.
    """
    path = Path(path)
    readers = {".ply": _read_ply, ".obj": _read_obj}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path}: meshes are read from {', '.join(readers)}")
    content = read_bytes(path)
    with reading(path, "it is damaged, or no mesh that gsut reads"):
        mesh = readers[path.suffix.lower()](path, content)
    if not len(mesh.vertices):
        raise InputError(f"{path} holds no vertices: it is empty, or no mesh that gsut reads")
    if not all(np.isfinite(a).all() for a in (mesh.vertices, mesh.colors) if a is not None):
        raise InputError(f"{path} is damaged: a vertex or its colour is not finite")
    low, high = mesh.faces.min(initial=0), mesh.faces.max(initial=-1)
    if low < 0 or high >= len(mesh.vertices):
        raise InputError(
            f"{path} is damaged: a face names vertex {low if low < 0 else high}, which is not there"
        )
    return dataclasses.replace(mesh, faces=mesh.faces.astype(np.uint32))


def _read_triangles(polygons: list[np.ndarray]) -> np.ndarray:
    rows = [(row[0], row[k], row[k + 1]) for row in polygons for k in range(1, len(row) - 1)]
    return np.array(rows, np.int64).reshape(-1, 3)


def _read_obj(path: Path, content: bytes) -> Mesh:
    vertices: list[list[float]] = []
    polygons, colors = [], []
    for line in content.decode().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(word) for word in words[1:4]])
            if len(words) == 7:
                colors.append([float(word) for word in words[4:]])
        elif words[:1] == ["f"]:
            named = np.array([int(word.split("/")[0]) for word in words[1:]])
            polygons.append(np.where(named < 0, len(vertices) + named, named - 1))
    all_colored = len(colors) == len(vertices) > 0
    return Mesh(
        np.array(vertices, np.float64).reshape(-1, 3), _read_triangles(polygons),
        np.array(colors, np.float32) if all_colored else None,
    )  # fmt: skip


def _read_ply(path: Path, content: bytes) -> Mesh:
    order, elements, _, begin = _core.read_ply_header(os.fsencode(path))
    if not order:
        raise ValueError("it is of text: save it as a binary PLY")
    vertices, faces, levels = np.zeros((0, 3)), np.zeros((0, 3), np.int64), None
    for name, count, properties in elements:
        if any(length for *_, length in properties):
            # Triangles only, which is what meshes are.
            (_, kind, length), *more = properties
            if more or {kind[0], length[:1]} - set("iu"):
                raise ValueError(f"element {name} has more than one list of whole numbers")
            row = np.dtype([("count", order + length), ("of", order + kind, 3)])
            rows = np.frombuffer(content, row, count, begin)
            if np.any(rows["count"] != 3):
                raise ValueError("binary faces must be triangles")
            if name == "face":
                faces = rows["of"].astype(np.int64)
            begin += row.itemsize * count
        elif properties:
            row = np.dtype([(each, order + kind) for each, kind, _ in properties])
            rows = np.frombuffer(content, row, count, begin)
            if name == "vertex":
                vertices = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)
                kinds = {each: kind for each, kind, _ in properties}
                if all(kinds.get(channel) == "u1" for channel in _CHANNELS):
                    levels = np.stack([rows[channel] for channel in _CHANNELS], axis=1)
            begin += row.itemsize * count
    return Mesh(vertices, faces, _from_levels(levels))
