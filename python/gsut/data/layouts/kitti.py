"""KITTI odometry: a sequence with calib.txt, times.txt and image_0 ... image_3, and its poses.

DATA/image_2/000000.png  DATA/calib.txt  DATA/times.txt      DATA is .../sequences/NN
poses in ../../poses/NN.txt, or DATA/poses.txt, or DATA/NN.txt: 12 numbers a line, of camera 0
DATA may also hold `sequences` with one sequence in it, and `poses` beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.findings import DatasetError, some_names
from gsut.data.images import read_header
from gsut.data.layouts._layout import Layout
from gsut.data.layouts._write_kitti import write_kitti
from gsut.data.layouts.folder import POINT_FILES
from gsut.data.mounts import BODY, Mount
from gsut.data.recording import Recording, Stream, pictures_in
from gsut.data.text_files import read_text
from gsut.lens import Camera

_CAMERAS = (("image_2", "image_3"), ("image_0", "image_1"))  # colour before grey
_ALL = tuple(sorted(name for pair in _CAMERAS for name in pair))
_PIXEL_SHIFT = 0.5  # KITTI's pixel (0, 0) is gsut's (0.5, 0.5)


def _sequence(path: Path) -> Path | None:
    """The folder of calib.txt and image_N."""
    if (path / "calib.txt").is_file() and any((path / name).is_dir() for name in _ALL):
        return path
    if path.name in _ALL and (path.parent / "calib.txt").is_file():
        return path.parent
    found = _sequences(path)
    return found[0] if found else None


def _sequences(path: Path) -> list[Path]:
    return sorted(
        f.parent for f in path.glob("sequences/*/calib.txt")
        if any((f.parent / name).is_dir() for name in _ALL)
    )  # fmt: skip


def record(path: Path) -> Recording:
    """A sequence; its poses may be absent."""
    sequence = _sequence(path) or path
    several = _sequences(path)
    if len(several) > 1:
        raise DatasetError(
            path,
            f"it holds {len(several)} sequences: {some_names([s.name for s in several])}",
            f"give one of them, such as {several[0]}",
        )
    names = [name for name in _ALL if pictures_in(sequence / name)]
    chosen: tuple[str, ...] = tuple(n for n in _CAMERAS[0] if n in names) or tuple(names)
    if path.name in _ALL:
        chosen = (path.name,)
    times = sequence / "times.txt"
    texts = [line.strip() for line in read_text(times).splitlines() if line.strip()] if (
        times.is_file()
    ) else None  # fmt: skip
    streams = []
    for name in names:
        images = pictures_in(sequence / name)
        if texts is not None and len(texts) < len(images):
            raise DatasetError(
                times, f"it has {len(texts)} times for {len(images)} pictures of {name}",
                "copy the file again",
            )  # fmt: skip
        streams.append(Stream(name, images, None if texts is None else texts[: len(images)]))
    recording = Recording(sequence, streams, cameras=chosen, names_from=sequence, poses_of=BODY)
    sizes = {stream.name: read_header(stream.images[0]) for stream in streams}

    def mounts(wanted: Sequence[str]) -> dict[str, Mount]:
        return {
            name: _mount(sequence / "calib.txt", name, sizes[name].width, sizes[name].height)
            for name in wanted
        }

    recording.mounts = mounts
    number = sequence.name
    candidates = (
        sequence.parent.parent / "poses" / f"{number}.txt",
        sequence / "poses.txt", sequence / f"{number}.txt", sequence / "poses" / f"{number}.txt",
    )  # fmt: skip
    recording.poses = next((p for p in candidates if p.is_file()), None)
    recording.points = next((sequence / n for n in POINT_FILES if (sequence / n).is_file()), None)
    if "image_0" in names and "image_2" in chosen:
        recording.notes.append(f"{sequence}: the colour cameras {', '.join(chosen)} are used")
    return recording


def _mount(calib: Path, name: str, width: int, height: int) -> Mount:
    """A rectified camera: P = K [I | t], from camera 0."""
    key = f"P{name[-1]}"
    lines = read_text(calib).splitlines()
    found = [(n, line) for n, line in enumerate(lines, 1) if line.split(":")[0].strip() == key]
    if not found:
        raise DatasetError(calib, f"there is no '{key}:', the camera of {name}", "copy it again")
    number, line = found[0]
    where = f"{calib}, line {number}"
    try:
        matrix = np.reshape([float(v) for v in line.split(":", 1)[1].split()], (3, 4))
    except ValueError as error:
        raise DatasetError(
            where, f"expected '{key}:' and 12 numbers, found '{line}'", "copy the file again"
        ) from error
    k = matrix[:, :3]
    if not np.allclose(k, [[k[0, 0], 0, k[0, 2]], [0, k[1, 1], k[1, 2]], [0, 0, 1]], atol=1e-9):
        raise DatasetError(where, f"{key} is not fx 0 cx, 0 fy cy, 0 0 1", "rectify the pictures")
    place = np.eye(4)
    place[:3, 3] = np.linalg.solve(k, matrix[:, 3])
    params = [k[0, 0], k[1, 1], k[0, 2] + _PIXEL_SHIFT, k[1, 2] + _PIXEL_SHIFT]
    try:
        return Mount(Camera("pinhole", params, width, height), where, from_body=place)
    except InputError as error:
        raise DatasetError(where, str(error), "correct it") from error


LAYOUT = Layout(
    "kitti",
    "calib.txt and image_0 ... (KITTI odometry)",
    rank=20,
    holds=lambda path: path.is_dir() and _sequence(path) is not None,
    record=record,
    write=write_kitti,
)
