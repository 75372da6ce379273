"""Scene files that are wrong in one place: refused by its name before memory is asked for."""

from __future__ import annotations

import functools
import gzip
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from formats.scene_cases import plain_scene
from gsut import InputError, formats

COUNT = 300
EXTENSION = "KHR_gaussian_splatting"
ATTRIBUTES = ["meshes", 0, "primitives", 0, "attributes"]
ABOUT = ["meshes", 0, "primitives", 0, "extensions", EXTENSION]
OPACITY, SCALE = f"{EXTENSION}:OPACITY", f"{EXTENSION}:SCALE"


def put(values: Any, place: list[Any], value: Any) -> None:
    """Sets a value of nested lists and objects; None takes it out."""
    *way, last = place
    for key in way:
        values = values[key]
    if value is None:
        del values[last]
    else:
        values[last] = value


def repack(path: Path, method: int, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path) as source:
        members = {name: source.read(name) for name in source.namelist()} | members
    with zipfile.ZipFile(path, "w", method) as target:
        for name, content in members.items():
            target.writestr(name, content)


def change_sog(path: Path, place: list[Any], value: Any) -> None:
    with zipfile.ZipFile(path) as source:
        meta = json.loads(source.read("meta.json"))
    put(meta, place, value)
    repack(path, zipfile.ZIP_STORED, {"meta.json": json.dumps(meta).encode()})


def replace_image(path: Path, name: str, side: tuple[int, int], lossless: bool = True) -> None:
    """Puts a black picture of (width, height) in the place of another."""
    quality = [cv2.IMWRITE_WEBP_QUALITY, 101 if lossless else 50]
    black = np.zeros((side[1], side[0], 3), np.uint8)
    repack(path, zipfile.ZIP_STORED, {name: cv2.imencode(".webp", black, quality)[1].tobytes()})


def drop_meta(path: Path) -> None:
    with zipfile.ZipFile(path) as source:
        members = {name: source.read(name) for name in source.namelist() if name != "meta.json"}
    with zipfile.ZipFile(path, "w") as target:
        for name, content in members.items():
            target.writestr(name, content)


def mark_encrypted(path: Path) -> None:
    """Sets the flag of each member, in both of its headers."""
    data = bytearray(path.read_bytes())
    for magic, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        for found in re.finditer(re.escape(magic), bytes(data)):
            data[found.start() + offset] |= 1
    path.write_bytes(data)


def change_glb(path: Path, place: list[Any], value: Any) -> None:
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    put(document, place, value)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, len(data) - length + len(text))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :])


def raise_opacity(path: Path) -> None:
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    begin = 28 + length + json.loads(data[20 : 20 + length])["bufferViews"][4]["byteOffset"]
    path.write_bytes(data[:begin] + struct.pack("<f", 7.5) + data[begin + 4 :])


def set_fractional_bits(path: Path, bits: int) -> None:
    data = bytearray(gzip.decompress(path.read_bytes()))
    data[13] = bits
    path.write_bytes(gzip.compress(bytes(data)))


def write_spz(
    path: Path, count: int, body: bytes = b"", version: int = 3, degree: int = 0,
    magic: int = 0x5053474E,
) -> None:  # fmt: skip
    data = struct.pack("<IIIBBBB", magic, version, count, degree, 12, 0, 0) + body
    compressor = zlib.compressobj(9, zlib.DEFLATED, 31)
    path.write_bytes(compressor.compress(data) + compressor.flush())


def write_glb(path: Path, text: bytes) -> None:
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 0, b"BIN\0")
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def set_first_bound(path: Path, value: float) -> None:
    head, end, data = path.read_bytes().partition(b"end_header\n")
    path.write_bytes(head + end + struct.pack("<f", value) + data[4:])


SOG = {
    "one mins for three": (["means", "mins"], [0.0], "means.mins"),
    "mins above maxs": (["means", "mins"], [9e1, 0, 0], "means.mins"),
    "maxs that no float has": (["means", "maxs"], [500, 500, 500], "means.maxs"),
    "one file for both halves": (["means", "files"], 2 * ["means_l.webp"], "means.files"),
    "a short codebook": (["scales", "codebook"], [0.0, 1.0], "scales.codebook"),
    "words in a codebook": (["sh0", "codebook"], ["x"] * 256, "sh0.codebook"),
    "no quats": (["quats"], None, "quats is missing"),
    "colours as rotations": (["quats", "files"], ["sh0.webp"], "quats"),
    "half a count": (["count"], 150.5, "count"),
    "no Gaussians": (["count"], 0, "count is 0"),
    "bands of 4": (["shN", "bands"], 4, "shN.bands"),
    "a palette below its labels": (["shN", "count"], 3, "shN"),
    "a huge claim": (["count"], 10**12, "claims 1,000,000,000,000"),
    "more than its images hold": (["count"], 9000, "9,000 are needed"),
    "version 1": (["version"], 1, "SOG version 1"),
}

GLTF = {
    "a negative accessor": ([*ATTRIBUTES, SCALE], -1, "SCALE is -1"),
    "a negative view": (["accessors", 3, "bufferView"], -1, "accessors[3].bufferView is -1"),
    "a sparse accessor": (["accessors", 3, "sparse"], {"count": 1}, "accessors[3].sparse"),
    "another buffer": (["bufferViews", 3, "buffer"], 1, "bufferViews[3].buffer"),
    "no Gaussians": (["accessors", 0, "count"], 0, "accessors[0].count is 0"),
    "a negative offset": (["bufferViews", 3, "byteOffset"], -4, "bufferViews[3].byteOffset"),
    "beyond its view": (["accessors", 3, "byteOffset"], 4, "bufferViews[3]"),
    "overlapping rows": (["bufferViews", 3, "byteStride"], 4, "bufferViews[3].byteStride"),
    "scales of four": (["accessors", 3, "type"], "VEC4", "accessors[3].type"),
    "half of a degree": ([*ATTRIBUTES, f"{EXTENSION}:SH_DEGREE_1_COEF_1"], None, "SH_DEGREE_1"),
    "linear colours": ([*ABOUT, "colorSpace"], "lin_rec709_display", "colorSpace"),
    "another kernel": ([*ABOUT, "kernel"], "box", "kernel"),
    "triangles": (["meshes", 0, "primitives", 0, "mode"], 4, "primitive.mode"),
}

SPZ: dict[str, tuple[dict[str, Any], str]] = {
    "a huge claim": ({"count": 4_000_000_000}, "claims 4,000,000,000"),
    "more than gzip can hold": ({"count": 60_000}, "bytes of gzip can hold"),
    "a byte too few": ({"count": 1, "body": bytes(19)}, "need 20 bytes, 19"),
    "a bomb": ({"count": 1, "body": bytes(10_000_000)}, "need 20 bytes, 21 or more"),
    "version 1": ({"count": 1, "body": bytes(20), "version": 1}, "SPZ version 1"),
    "degree 4": ({"count": 1, "body": bytes(20), "degree": 4}, "degree 4"),
    "another magic": ({"count": 1, "body": bytes(20), "magic": 1}, "no SPZ file"),
}

GLB = {
    "deep brackets": (b"[" * 100000, "nested too deeply"),
    "an empty object": (b"{}", "no glTF file of Gaussians"),
}

# (suffix, what is wrong) -> what is done to a file, and what the sentence must say.
WRONG: dict[tuple[str, str], tuple[Callable[[Path], object], str]] = {
    **{
        (".sog", name): (functools.partial(change_sog, place=place, value=value), said)
        for name, (place, value, said) in SOG.items()
    },
    **{
        (".glb", name): (functools.partial(change_glb, place=place, value=value), said)
        for name, (place, value, said) in GLTF.items()
    },
    **{
        (".spz", name): (functools.partial(write_spz, **values), said)
        for name, (values, said) in SPZ.items()
    },
    **{
        (".glb", name): (functools.partial(write_glb, text=text), said)
        for name, (text, said) in GLB.items()
    },
    (".spz", "no gzip around it"): (
        lambda path: path.write_bytes(gzip.decompress(path.read_bytes())),
        "without the gzip around it",
    ),
    (".ply", "a pointer"): (
        lambda path: path.write_bytes(b"version https://git-lfs.github.com/spec/v1\n"),
        "a pointer of Git LFS in place of the file",
    ),
    (".ply", "empty"): (lambda path: path.write_bytes(b""), "it is empty"),
    (".spz", "an archive"): (lambda path: path.write_bytes(b"PK\3\4"), "does not look like one"),
    (".sog", "deep brackets"): (
        lambda path: repack(path, zipfile.ZIP_DEFLATED, {"meta.json": b"[" * 100000}),
        "nested too deeply",
    ),
    (".sog", "no meta.json"): (drop_meta, "meta.json is missing"),
    (".sog", "a huge image"): (
        functools.partial(replace_image, name="quats.webp", side=(4000, 4000)),
        "4000 x 4000 pixels",
    ),
    (".sog", "a lossy image"): (
        functools.partial(replace_image, name="quats.webp", side=(20, 16), lossless=False),
        "no lossless WebP",
    ),
    (".sog", "a bomb"): (
        lambda path: repack(path, zipfile.ZIP_DEFLATED, {"scales.webp": bytes(10**8)}),
        "scales.webp: has 100,000,000 bytes",
    ),
    (".sog", "LZMA"): (lambda path: repack(path, zipfile.ZIP_LZMA, {}), "packed by method 14"),
    (".sog", "encrypted"): (mark_encrypted, "is encrypted"),
    (".glb", "an opacity of 7.5"): (raise_opacity, "OPACITY has values"),
    (".spz", "255 fractional bits"): (
        functools.partial(set_fractional_bits, bits=255),
        "fractional bits are 255",
    ),
    (".compressed.ply", "a bound that is no number"): (
        functools.partial(set_first_bound, value=float("nan")),
        "max_x is below its min_x",
    ),
}


@pytest.mark.parametrize(("suffix", "case"), WRONG)
def test_wrong_file_is_refused_by_the_name_of_what_is_wrong(tmp_path, suffix, case):
    path = tmp_path / f"a{suffix}"
    formats.save_gaussians(path, plain_scene(np.random.default_rng(1), COUNT))
    spoil, said = WRONG[suffix, case]
    spoil(path)
    with pytest.raises(InputError, match=re.escape(said)):
        formats.load_gaussians(path)
