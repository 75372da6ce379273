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
from gsut.data.errors import DatasetError, list_some
from gsut.data.export import POINTS, Export, find_frame_times, list_losses, require_one_lens
from gsut.data.images import decode_image, read_header
from gsut.data.layouts._layout import Layout
from gsut.data.layouts.folder import POINT_FILES
from gsut.data.poses import NANOSECONDS, format_kitti
from gsut.data.recordings import Recording, Stream, list_pictures
from gsut.data.rigs import BODY, Mount
from gsut.data.text_files import read_text
from gsut.files import write_file
from gsut.lens import Camera

_CAMERAS = (("image_2", "image_3"), ("image_0", "image_1"))  # colour before grey
_ALL = tuple(sorted(name for pair in _CAMERAS for name in pair))
_PIXEL_SHIFT = 0.5  # KITTI's pixel (0, 0) is gsut's (0.5, 0.5)


def _find_sequence(path: Path) -> Path | None:
    if (path / "calib.txt").is_file() and any((path / name).is_dir() for name in _ALL):
        return path
    if path.name in _ALL and (path.parent / "calib.txt").is_file():
        return path.parent
    found = _list_sequences(path)
    return found[0] if found else None


def _list_sequences(path: Path) -> list[Path]:
    return sorted(
        f.parent for f in path.glob("sequences/*/calib.txt")
        if any((f.parent / name).is_dir() for name in _ALL)
    )  # fmt: skip


def record(path: Path) -> Recording:
    """Records a sequence; its poses may be absent."""
    sequence = _find_sequence(path) or path
    several = _list_sequences(path)
    if len(several) > 1:
        raise DatasetError(
            path,
            f"it holds {len(several)} sequences: {list_some([s.name for s in several])}",
            f"give one of them, such as {several[0]}",
        )
    names = [name for name in _ALL if list_pictures(sequence / name)]
    chosen: tuple[str, ...] = tuple(n for n in _CAMERAS[0] if n in names) or tuple(names)
    if path.name in _ALL:
        chosen = (path.name,)
    times = sequence / "times.txt"
    texts = [line.strip() for line in read_text(times).splitlines() if line.strip()] if (
        times.is_file()
    ) else None  # fmt: skip
    streams = []
    for name in names:
        images = list_pictures(sequence / name)
        if texts is not None and len(texts) < len(images):
            raise DatasetError(
                times, f"it has {len(texts)} times for {len(images)} pictures of {name}",
                "copy the file again",
            )  # fmt: skip
        streams.append(Stream(name, images, None if texts is None else texts[: len(images)]))
    recording = Recording(sequence, streams, cameras=chosen, names_from=sequence, poses_of=BODY)
    sizes = {stream.name: read_header(stream.images[0]) for stream in streams}

    def make_mounts(wanted: Sequence[str]) -> dict[str, Mount]:
        return {
            name: _mount(sequence / "calib.txt", name, sizes[name].width, sizes[name].height)
            for name in wanted
        }

    recording.mounts = make_mounts
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
    """Mounts a rectified camera: P = K [I | t], from camera 0."""
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


_CALIB_CAMERAS = 4  # P0 to P3: readers expect all of them


def write_kitti(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: several cameras, or a lens with distortion.
    """
    lens = require_one_lens(export, "KITTI")
    if lens.model != "pinhole":
        raise InputError(
            f"KITTI's calib.txt holds pinhole cameras without distortion only, and the lens is "
            f"'{lens.model}': undistort the images first, or choose nerfstudio, colmap or folder"
        )
    times, _ = find_frame_times(export.frames)
    order = sorted(range(len(times)), key=times.__getitem__)
    sequence = folder / "sequences" / "00"
    for row, i in enumerate(order):
        _place_png(export, export.frames[i].image_path, sequence / "image_2" / f"{row:06d}.png")
    fx, fy, cx, cy = (float(value) for value in lens.params)
    matrix = [fx, 0.0, cx - _PIXEL_SHIFT, 0.0, 0.0, fy, cy - _PIXEL_SHIFT, 0.0, 0.0, 0.0, 1.0, 0.0]
    text = " ".join(repr(value) for value in matrix)
    write_file(
        sequence / "calib.txt", "".join(f"P{number}: {text}\n" for number in range(_CALIB_CAMERAS))
    )
    first = times[order[0]] if order else 0
    seconds = [(times[i] - first) / NANOSECONDS for i in order]
    write_file(sequence / "times.txt", "".join(f"{value:.9e}\n" for value in seconds))
    (folder / "poses").mkdir()
    poses = np.array([export.frames[i].world_from_camera for i in order])
    write_file(folder / "poses" / "00.txt", format_kitti(poses))
    export.write_points(sequence / POINTS)
    return list_losses(export, "KITTI", times=True, lens_limits=False)


def _place_png(export: Export, source: Path, target: Path) -> None:
    """Places a picture as PNG, which KITTI's readers expect; others are converted without loss."""
    if source.suffix.lower() == ".png":
        export.place(source, target)
        return
    import cv2

    target.parent.mkdir(parents=True, exist_ok=True)
    pixels = decode_image(source)[0]
    write_file(target, cv2.imencode(".png", pixels[..., ::-1])[1].tobytes())


LAYOUT = Layout(
    "kitti",
    "calib.txt and image_0 ... (KITTI odometry)",
    rank=20,
    holds=lambda path: path.is_dir() and _find_sequence(path) is not None,
    record=record,
    write=write_kitti,
)
