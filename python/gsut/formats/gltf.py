"""glTF binary files with the extension KHR_gaussian_splatting: every value in float32."""

from __future__ import annotations

import dataclasses
import json
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import create_file, open_binary, parse_json, reading, register_reader
from gsut.formats._axes import place_in_world, turn_half
from gsut.formats._fields import Fields
from gsut.formats._format import Format, SceneFile, WriteSettings, Written
from gsut.formats._quantize import (
    logits_from_opacity,
    normalize_quats,
    opacity_from_logits,
    to_bytes,
)
from gsut.gaussians import SH_C0, Gaussians, rotations_from_quaternions

_EXTENSION = "KHR_gaussian_splatting"
_HEAD = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
_FLOAT = 5126  # glTF's code of float32
_BYTE = 5121  # glTF's code of uint8
# Types of numbers by glTF's code; integers are the extension's quantised attributes.
_NUMBERS = {5120: "<i1", _BYTE: "<u1", 5122: "<i2", 5123: "<u2", _FLOAT: "<f4"}
_POINTS = 0  # glTF's mode of primitives that are points
_KINDS = {"ROTATION": "VEC4", "OPACITY": "SCALAR"}  # of attributes that are no VEC3
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
# How Gaussians are drawn, as the extension says it.
_DRAWN_SO = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "projection": "perspective",
}
# In the primitive's extras: the response and the order by which the Gaussians are drawn; without
# them the maximum and the distance.
_KNOWN_RULES = {"response": Gaussians.RESPONSES, "order": Gaussians.ORDERS}
_RULE_KEYS = {kind: f"gsut: {kind}" for kind in _KNOWN_RULES}
_MOST_STRIDE = 252  # bytes, of glTF
_OPACITY_ROUNDING = 1e-3  # beyond 0 and 1 that a writer's rounding may leave
_MOST_JSON = 1 << 24  # bytes of a file's description; more is an attack


def _name_harmonics(degree: int) -> list[str]:
    return [
        f"{_EXTENSION}:SH_DEGREE_{each}_COEF_{order}"
        for each in range(degree + 1)
        for order in range(2 * each + 1)
    ]


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    g = turn_half(gaussians)
    opacity = opacity_from_logits(g.opacity_logits)
    # For programs that do not know the extension: coloured points, in linear light.
    shown = np.clip(0.5 + SH_C0 * g.sh[:, 0].astype(np.float64), 0.0, 1.0)
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    fallback, _ = to_bytes(255 * np.concatenate([linear, opacity[:, None]], axis=1))
    arrays = {
        "POSITION": g.means,
        "COLOR_0": fallback,
        f"{_EXTENSION}:ROTATION": normalize_quats(g.quats)[:, [1, 2, 3, 0]].astype(np.float32),
        f"{_EXTENSION}:SCALE": np.exp(g.log_scales.astype(np.float64)).astype(np.float32),
        f"{_EXTENSION}:OPACITY": opacity,
        **{name: g.sh[:, k] for k, name in enumerate(_name_harmonics(g.sh_degree))},
    }
    document = _build_document(arrays)
    rule = {kind: getattr(g, kind) for kind in _RULE_KEYS}
    if extras := {_RULE_KEYS[k]: name for k, name in rule.items() if name != _KNOWN_RULES[k][0]}:
        document["meshes"][0]["primitives"][0]["extras"] = extras
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = document["buffers"][0]["byteLength"]
    total = _HEAD.size + 2 * _CHUNK.size + len(text) + size
    if total >= 2**32:
        raise InputError(f"{path}: {total:,} bytes are more than a .glb file can have (4 GiB)")
    with create_file(path) as file:
        file.write(_HEAD.pack(b"glTF", 2, total))
        file.write(_CHUNK.pack(len(text), b"JSON") + text + _CHUNK.pack(size, b"BIN\0"))
        for array in arrays.values():
            file.write(np.ascontiguousarray(array).tobytes())
    left_out = ("glTF cannot say that a scene is antialiased",) if settings.antialiased else ()
    return Written(None, {}, left_out)


def _build_document(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    begin = 0
    for array in arrays.values():
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[array.shape[1] if array.ndim == 2 else 1]
        views.append({"buffer": 0, "byteOffset": begin, "byteLength": array.nbytes})
        accessor = {
            "bufferView": len(accessors),
            "componentType": _BYTE if array.dtype == np.uint8 else _FLOAT,
            "count": len(array),
            "type": kind,
        }
        if array.dtype == np.uint8:
            accessor["normalized"] = True
        accessors.append(accessor)
        begin += array.nbytes
    positions = arrays["POSITION"]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    primitive = {
        "mode": _POINTS,
        "attributes": {name: index for index, name in enumerate(arrays)},
        "extensions": {_EXTENSION: {**_DRAWN_SO, "sortingMethod": "cameraDistance"}},
    }
    return {
        "asset": {"version": "2.0", "generator": "gsut"},
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": begin}],
    }


@register_reader("glTF of Gaussians", ".glb")
def _read(path: Path) -> SceneFile:
    document, begin, size = _parse(path)
    with reading(path, "it is no glTF file of Gaussians"):
        primitive = _find_primitive(path, document)
        attributes = Fields(path, primitive.get("attributes"), "attributes")
        arrays = {
            name: _read_array(Fields(path, document), attributes, name, begin, size)
            for name in attributes.values
            if name == "POSITION" or name.startswith(_EXTENSION)
        }
        gaussians = dataclasses.replace(
            _decode_gaussians(path, arrays), **_read_rule(path, primitive)
        )
        placed_so = place_in_world(gaussians, _place_of(path, document), f"{path}: its mesh")
        return SceneFile(turn_half(placed_so))


def _parse(path: Path) -> tuple[dict[str, Any], int, int]:
    """Reads the description, and where the binary chunk begins and how long it is."""
    with open_binary(path) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(_HEAD.size + _CHUNK.size)
        if len(head) < _HEAD.size + _CHUNK.size or head[:4] != b"glTF":
            raise InputError(f"{path}: no binary glTF file (it does not begin with glTF)")
        version = _HEAD.unpack_from(head)[1]
        length, kind = _CHUNK.unpack_from(head, _HEAD.size)
        if version != 2 or kind != b"JSON" or not length <= min(size, _MOST_JSON):
            raise InputError(f"{path}: glTF version {version}, {length:,} bytes of {kind!r} first")
        text = file.read(length)
        rest = file.read(_CHUNK.size)
    document = parse_json(text, f"{path}, its description", {})
    begin = len(head) + len(text) + len(rest)
    there = size - begin
    if len(rest) < _CHUNK.size or rest[4:] != b"BIN\0" or _CHUNK.unpack(rest)[0] > there:
        raise InputError(f"{path}: truncated, or its data is in another file; give one .glb file")
    return document, begin, there


def _find_primitive(path: Path, document: dict[str, Any]) -> dict[str, Any]:
    """Finds the one primitive that has Gaussians, and checks how it is drawn."""
    found = [
        primitive
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
        if _EXTENSION in primitive.get("extensions", {})
    ]
    if len(found) != 1:
        raise InputError(f"{path}: {len(found)} meshes with {_EXTENSION}; gsut reads one")
    about = Fields(path, found[0]["extensions"][_EXTENSION], _EXTENSION)
    for field, value in _DRAWN_SO.items():
        about.require(field, value)
    inner = about.values.get("extensions", {})
    if inner:
        raise InputError(f"{path}: compressed by {', '.join(inner)}, which gsut does not read")
    Fields(path, found[0], "primitive").require("mode", _POINTS)
    return found[0]


def _read_rule(path: Path, primitive: dict[str, Any]) -> dict[str, Any]:
    """Reads response and order from the primitive's extras, which may be anything."""
    extras, rule = primitive.get("extras"), {}
    for kind, known in _KNOWN_RULES.items():
        name = extras.get(_RULE_KEYS[kind]) if isinstance(extras, dict) else None
        rule[kind] = known[0] if name is None else name
        if rule[kind] not in known:
            raise InputError(
                f'{path}: extras name the unknown {kind} "{name}"; known: {", ".join(known)}; a '
                "newer gsut may have written it"
            )
    return rule


def _place_of(path: Path, document: dict[str, Any]) -> np.ndarray:
    """Composes world <- mesh (4, 4) of the Gaussians from the nodes above them."""
    (mesh,) = (
        number
        for number, each in enumerate(document["meshes"])
        if any(_EXTENSION in primitive.get("extensions", {}) for primitive in each["primitives"])
    )
    nodes = document.get("nodes", [])
    users = [number for number, node in enumerate(nodes) if node.get("mesh") == mesh]
    if len(users) > 1:
        raise InputError(f"{path}: {len(users)} nodes show its Gaussians; gsut reads one")
    parents = {child: number for number, node in enumerate(nodes)
               for child in node.get("children", [])}  # fmt: skip
    place, at, seen = np.eye(4), users[0] if users else None, set[int]()
    while at is not None:
        if at in seen:
            raise InputError(f"{path}: its nodes are their own parents")
        seen.add(at)
        place = _compose_matrix(nodes[at]) @ place
        at = parents.get(at)
    return place


def _compose_matrix(node: dict[str, Any]) -> np.ndarray:
    """Composes the matrix (4, 4) of one node from its columns or from its parts."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = rotations_from_quaternions(
        np.array([[w, x, y, z]]) / np.linalg.norm([w, x, y, z])
    )[0]
    matrix[:3, :3] *= np.array(node.get("scale", [1, 1, 1]), np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    return matrix


def _read_array(
    document: Fields, attributes: Fields, name: str, begin: int, size: int
) -> np.ndarray:
    path = document.path
    index = attributes.read_whole(name, 0, len(document.values["accessors"]) - 1)
    accessor = document.read_fields("accessors", index)
    accessor.require("sparse")
    component = accessor.read_whole("componentType", min(_NUMBERS), max(_NUMBERS))
    if component not in _NUMBERS:
        accessor.require("componentType", _FLOAT)
    number = np.dtype(_NUMBERS[component])
    is_whole, is_normalized = number.kind != "f", accessor.values.get("normalized") is True
    if is_whole and not is_normalized and name != "POSITION":
        raise InputError(
            f"{path}: {name} has whole numbers that are not normalized, and gsut reads it as "
            "float32 or normalized; write it so"
        )
    kind = _KINDS.get(name.removeprefix(f"{_EXTENSION}:"), "VEC3")
    accessor.require("type", kind)
    width, count = _WIDTHS[kind], accessor.read_whole("count", 1, size)
    if count != document.read_fields("accessors", attributes.values["POSITION"]).values["count"]:
        raise InputError(f"{path}: damaged: {name} has {count:,} values, POSITION another number")
    views = len(document.values["bufferViews"])
    view = document.read_fields("bufferViews", accessor.read_whole("bufferView", 0, views - 1))
    view.read_whole("buffer", 0, 0)
    document.read_fields("buffers", 0).require("uri")
    place = view.read_whole("byteOffset", 0, size, 0)
    inside = accessor.read_whole("byteOffset", 0, size, 0)
    row = number.itemsize * width
    stride = view.read_whole("byteStride", row, _MOST_STRIDE, row)
    needed = (count - 1) * stride + row
    if inside + needed > view.read_whole("byteLength", 1, size - place):
        raise InputError(
            f"{path}: truncated or damaged: {name} needs {inside + needed:,} bytes of {view.name}, "
            f"whose byteLength is {view.values['byteLength']:,}"
        )
    with open_binary(path) as file:
        file.seek(begin + place + inside)
        data = np.frombuffer(file.read(needed), np.uint8)
    rows = np.lib.stride_tricks.as_strided(data, (count, row), (stride, 1))
    values = np.ascontiguousarray(rows).view(number)
    if not is_whole:
        return values
    unit = np.iinfo(number).max if is_normalized else 1
    return np.maximum(values / np.float32(unit), -1.0 if is_normalized else -np.inf).astype("<f4")


def _decode_gaussians(path: Path, arrays: dict[str, np.ndarray]) -> Gaussians:
    degree, there = 0, {name for name in arrays if ":SH_" in name}
    while degree < 3 and there != set(_name_harmonics(degree)):
        degree += 1
    lacking = set(_name_harmonics(degree)) ^ there
    if lacking:
        raise InputError(
            f"{path}: its harmonics are none of degree 0 to 3: {', '.join(sorted(lacking)[:3])} "
            "should be there, or should not"
        )
    opacity = arrays[f"{_EXTENSION}:OPACITY"][:, 0]
    wrong = (opacity < -_OPACITY_ROUNDING) | (opacity > 1 + _OPACITY_ROUNDING)
    if wrong.any():
        raise InputError(
            f"{path}: {_EXTENSION}:OPACITY has values such as {opacity[wrong][0]:g}; 0 to 1 are "
            "possible"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(arrays[f"{_EXTENSION}:SCALE"])
    return Gaussians(
        arrays["POSITION"],
        arrays[f"{_EXTENSION}:ROTATION"][:, [3, 0, 1, 2]],
        log_scales,
        logits_from_opacity(opacity),
        np.stack([arrays[name] for name in _name_harmonics(degree)], axis=1),
    )


FORMAT = Format(
    "glTF", (".glb",), _write, _read, lambda head: head.startswith(b"glTF"), keeps_rule=True
)
