"""Kinds of malformed files, and what readers of binary files make of them: a process a reader.

`python -m malformed READER FOLDER EVERY` prints a line "KIND<tab>OUTCOME" a kind: "read",
"refused", or what went wrong. It ends by itself at a kind that takes too long or too much memory.
"""

from __future__ import annotations

import gc
import itertools
import os
import re
import struct
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

import gsut
import small_datasets
import small_films
import small_videos
from formats.scene_cases import plain_scene
from gsut import formats
from gsut.capture.track import read_film_facts
from gsut.capture.video import Video
from gsut.data.images.decode import decode_image, read_header
from gsut.data.points import find_usable_points, load_points_ply
from gsut.surface import Mesh, load_mesh, save_mesh

COUNT = 300
SECONDS = 2.0  # that a file may take
MEMORY = 500 << 20  # bytes that it may take
HUGE = 4_000_000_000
Kinds = Iterator[tuple[str, bytes]]


class Reader(NamedTuple):
    """A reader of files.

    Attributes:
        make: writes a whole file to a folder; returns it.
        read: reads it.
        is_right: whether what a changed file gave can be used.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], Any]
    is_right: Callable[[Any], bool] = lambda found: True


def _make_scene(suffix: str, version: int = 3) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        scene = plain_scene(np.random.default_rng(1), COUNT)
        settings = formats.WriteSettings(spz_version=version)
        formats.save_gaussians(folder / f"a{suffix}", scene, settings)
        return folder / f"a{suffix}"

    return make


def _make_ply(order: str) -> Callable[[Path], Path]:
    """Another encoding of a PLY file of Gaussians, or of a mesh."""

    def make(folder: Path) -> Path:
        names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
        head = ["ply", f"format {order} 1.0", f"element vertex {COUNT}"]
        head += [f"property float {name}" for name in names.split()]
        rows = np.random.default_rng(2).normal(size=(COUNT, 14))
        text = "".join(" ".join(f"{value:.4f}" for value in row) + "\n" for row in rows).encode()
        body = text if order == "ascii" else rows.astype(">f4").tobytes()
        path = folder / "a.ply"
        path.write_bytes("\n".join([*head, "end_header\n"]).encode() + body)
        return path

    return make


def _make_mesh(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        rng = np.random.default_rng(3)
        faces = rng.integers(0, 30, (40, 3)).astype(np.uint32)
        colors = rng.uniform(size=(30, 3)).astype(np.float32)
        save_mesh(folder / f"a{suffix}", Mesh(rng.normal(size=(30, 3)), faces, colors))
        return folder / f"a{suffix}"

    return make


def _make_points(folder: Path) -> Path:
    small_datasets.write_ply(folder / "a.ply", *small_datasets.points())
    return folder / "a.ply"


def _make_model(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        small_datasets.write_colmap_binary(folder / "set")
        return next((folder / "set").rglob(name))

    return make


def _make_lens(folder: Path) -> Path:
    path = folder / "a.cameramodel"
    gsut.save_camera(gsut.Camera("opencv8", [90, 91, 64, 48, *8 * [0.01]], 128, 96), path)
    return path


def _make_sensors(folder: Path) -> Path:
    device = small_films.make_gpmf(
        small_films.make_places(3), small_films.make_forces([[1, 2, 9.8]] * 5)
    )
    return small_films.make_film(folder / "a.mp4", b"gpmd", [device] * 3)


def _make_subtitles(folder: Path) -> Path:
    _make_sensors(folder)
    cues = (
        f"{i}\n00:00:0{i},000 --> 00:00:0{i + 1},000\n[latitude: 47.{i}] [longitude: 8.5] "
        "[abs_alt: 400]\n\n"
        for i in range(5)
    )
    (folder / "a.srt").write_text("".join(cues))
    return folder / "a.srt"


def _make_image(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        pixels = np.random.default_rng(4).integers(0, 255, (40, 60, 3), np.uint8)
        cv2.imwrite(str(folder / f"a{suffix}"), pixels)
        return folder / f"a{suffix}"

    return make


def _read_film(path: Path) -> tuple[Video, list[Any]]:
    with Video(path) as film:
        pictures = [decode() for _, _, decode in film.read_frames()]
        film.list_notes(len(pictures))
    return film, pictures


def _is_film(found: tuple[Video, list[Any]]) -> bool:
    film, pictures = found
    return all(each is None or each.shape == (film.height, film.width, 3) for each in pictures)


def _is_scene(found: gsut.Gaussians) -> bool:
    return bool(formats._format.find_drawable(found).all()) and len(found) <= 2 * COUNT


def _is_mesh(found: Mesh) -> bool:
    is_finite = np.isfinite(found.vertices).all()
    return bool(is_finite) and found.faces.max(initial=0) < len(found.vertices)


_SCENES: dict[str, Callable[[Path], Path]] = {
    "scene PLY": _make_scene(".ply"), "scene text PLY": _make_ply("ascii"),
    "scene big-endian PLY": _make_ply("binary_big_endian"),
    "scene compressed PLY": _make_scene(".compressed.ply"),
    "scene SPZ": _make_scene(".spz"), "scene SPZ 4": _make_scene(".spz", 4),
    "scene SOG": _make_scene(".sog"), "scene glTF": _make_scene(".glb"),
    "scene splat": _make_scene(".splat"),
}  # fmt: skip
READERS = {
    **{name: Reader(make, formats.load_gaussians, _is_scene) for name, make in _SCENES.items()},
    "large PLY": Reader(_make_scene(".ply"), lambda path: formats.open_ply(path, 10_000)),
    "mesh PLY": Reader(_make_mesh(".ply"), load_mesh, _is_mesh),
    "mesh OBJ": Reader(_make_mesh(".obj"), load_mesh, _is_mesh),
    "points": Reader(_make_points, lambda path: find_usable_points(load_points_ply(path)[0])),
    **{
        f"COLMAP {name}": Reader(
            _make_model(f"{name}.bin"), lambda path: gsut.load_dataset(path.parents[2])
        )
        for name in ("cameras", "images", "points3D")
    },
    "cameramodel": Reader(_make_lens, gsut.load_camera),
    "film": Reader(
        lambda folder: small_videos.walk(folder / "a.mp4", 12), _read_film, _is_film
    ),
    "sensors": Reader(_make_sensors, read_film_facts),
    "subtitles": Reader(_make_subtitles, lambda path: read_film_facts(path.with_suffix(".mp4"))),
    **{
        f"image {suffix}": Reader(
            _make_image(suffix), lambda path: (read_header(path), decode_image(path))
        )
        for suffix in (".png", ".jpg", ".webp", ".tif", ".bmp")
    },
}  # fmt: skip


def _list_parts(data: bytes) -> Kinds:
    """Pieces that lack, are there twice, or are something else."""
    yield "empty", b""
    yield "text", b"hello, this is something else\n" * 40
    yield "zeros", bytes(len(data))
    yield "backwards", data[::-1]
    for size in (1, 4, 16, 96, len(data) // 3, len(data) // 2, len(data) - 7, len(data) - 1):
        yield f"first {size} bytes", data[:size]
    yield "its head and zeros", data[: len(data) // 3] + bytes(2 * len(data) // 3)
    for name, more in {"a line": b"\n", "zeros": bytes(1000), "itself": data}.items():
        yield f"and {name}", data + more
    yield "line ends of Windows", data.replace(b"\n", b"\r\n")
    yield "minus signs", data.replace(b'":', b'":-')
    yield "brackets", data.replace(b"[", b"[[[[")


def _list_numbers(data: bytes) -> Kinds:
    """Each whole number of a binary head, each number of a text, and floats of data, replaced."""
    film = data.find(b"moov")
    starts = {0: 256} | ({film & ~3: len(data)} if film > 0 else {})
    wanted = {
        "<I": (0, 2**31 - 1, 2**32 - 1, 10**9), ">I": (0, 2**31 - 1, 2**32 - 1, 100_000),
        "<Q": (2**40, 2**63 - 1), "<B": (0, 255), ">H": (65500,),
    }  # fmt: skip
    for layout, values in wanted.items():
        size = struct.calcsize(layout)
        for start, end in starts.items():
            for at in range(start, min(end, len(data) - size + 1), max(1, size & ~3)):
                for value in values:
                    changed = data[:at] + struct.pack(layout, value) + data[at + size :]
                    yield f"{layout} {value} at {at}", changed
    words = (b"0", b"-1", b"1" + bytes(20 * [48]), b"1099511627776", b"nan", b"inf", b"1e308",
             b"9" * 400, b"[]", b"null", b"true", b" " * 100_000, b"\n" * 100_000,
             b"9" * 100_000)  # fmt: skip
    numbers = re.finditer(rb"-?\b\d[\d.e+-]*", data[:20_000])
    for found, word in itertools.product(itertools.islice(numbers, 40), words):
        changed = data[: found.start()] + word + data[found.end() :]
        yield f"{word[:20]!r} for the number at {found.start()}", changed
    for value in (np.nan, np.inf, 3e38, -1e30, 1e-45):
        changed = bytearray(data)
        for at in range(len(data) // 2 & ~3, len(data) - 4, 36):
            changed[at : at + 4] = struct.pack("<f", value)
        yield f"floats of {value}", bytes(changed)


def _list_headers(data: bytes) -> Kinds:
    """What the header of a PLY file says."""
    head, end, rows = data.partition(b"end_header\n")
    if not end:
        return
    for name, more in {
        "a header without end": b"comment " + b"a" * 50_000_000,
        "endless comments": b"comment a\n" * 5_000_000,
        "endless properties": b"".join(b"property float q%d\n" % i for i in range(90_000)),
        "endless elements": b"".join(b"element q%d 0\n" % i for i in range(90_000)),
        "a line of blanks": b"comment" + b" " * 10_000_000 + b"\n",
    }.items():
        yield name, head + more + end + rows
    for order in (b"binary_big_endian", b"ascii", b"binary", b""):
        yield f"format {order!r}", re.sub(rb"format \S+", b"format " + order, head) + end + rows
    for line in re.findall(rb"property[^\n]*\n", head)[:20]:
        for name, to in {
            "no": b"", "twice": line * 2,
            "list": line.replace(b"property ", b"property list uchar "),
            "long list": line.replace(b"property ", b"property list double "),
            "type of": re.sub(rb"property \w+", b"property quaternion", line),
        }.items():  # fmt: skip
            yield f"{name} {line[:30]!r}", head.replace(line, to, 1) + end + rows
    for line in re.findall(rb"element[^\n]*\n", head):
        for count in (b"-1", b"0", b"1e9", b"9" * 20, b"9223372036854775807", b"%d" % HUGE, b"4.5"):
            to = re.sub(rb"\S+\n$", count + b"\n", line)
            yield f"count {count!r} in {line!r}", head.replace(line, to, 1) + end + rows
        yield f"twice {line!r}", head.replace(line, line * 2, 1) + end + rows
    nothing = b"element nothing 9223372036854775807\n"
    yield "rows of nothing", head.replace(b"element", nothing + b"element", 1) + end + rows
    with_list = b"element face %d\nproperty list %s int of\n"
    for kind, count, number in (
        ("<b", 2**62, -1),
        ("<d", 1, 1e300),
        ("<d", 1, -3),
        ("<d", 1, np.nan),
    ):
        lists = with_list % (count, b"char" if kind == "<b" else b"double")
        changed = head.replace(b"element", lists + b"element", 1) + end
        binary = struct.pack(kind, number)
        yield (
            f"a list of {number}",
            changed + (b"%g " % number if b"ascii" in head else binary) + rows,
        )


def list_kinds(data: bytes, every: int) -> Kinds:
    """Lists kinds of malformed files; of numbers replaced at each place every so-manieth alone."""
    yield from _list_parts(data)
    yield from _list_headers(data)
    yield from itertools.islice(_list_numbers(data), every // 2, None, every)


def try_kind(reader: Reader, path: Path) -> str:
    """Reads a file; says what became of it."""
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            said = "read" if reader.is_right(reader.read(path)) else "read, and is wrong"
    except gsut.InputError as error:
        text = str(error).strip()
        said = (
            "refused"
            if str(path.parent) in text and "\n" not in text
            else f"refused by: {text[:200]}"
        )
    except Exception:
        said = traceback.format_exc(limit=-3)
    took = time.process_time() - started
    return said if took < SECONDS else f"took {took:.1f} s"


def main(name: str, folder: str, every: str) -> None:
    import resource
    import signal

    reader = READERS[name]
    path = reader.make(Path(folder))
    whole = path.read_bytes()
    print(f"whole\t{try_kind(reader, path)}", flush=True)
    status = Path("/proc/self/status").read_text("ascii")
    taken = 1024 * int(status.partition("VmData:")[2].split()[0])
    resource.setrlimit(resource.RLIMIT_DATA, (taken + MEMORY, taken + MEMORY))
    for kind, content in list_kinds(whole, int(every)):
        path.write_bytes(content)
        print(kind, end="\t", flush=True)
        signal.setitimer(signal.ITIMER_PROF, 2 * SECONDS)  # ends the process
        print(repr(try_kind(reader, path))[1:-1], flush=True)
        signal.setitimer(signal.ITIMER_PROF, 0)
        gc.collect()  # frames of films, which hold themselves and threads
    os._exit(0)  # not after threads that the memory was too small for


if __name__ == "__main__":
    main(*sys.argv[1:])
