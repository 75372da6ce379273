"""TUM's RGB-D layout: rgb.txt (or associations.txt), groundtruth.txt and a lens file.

DATA/rgb.txt             lines `time rgb/FILE`; or associations.txt, `time rgb/FILE time depth/FILE`
DATA/groundtruth.txt     lines `time tx ty tz qx qy qz qw`, camera-to-world; or trajectory.txt
DATA/lens.yaml           any lens file: TUM's own sets have none
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, list_some
from gsut.data.export import POINTS, Export, find_frame_times, list_losses, require_one_lens
from gsut.data.layouts._layout import Layout
from gsut.data.layouts.folder import POINT_FILES, find_lens_file
from gsut.data.poses import format_seconds, format_tum
from gsut.data.recordings import Recording, Stream
from gsut.data.rigs import read_mounts
from gsut.data.text_files import read_rows
from gsut.files import write_file
from gsut.lens import save_camera
from gsut.lens.files import OWN_SUFFIX

_LISTS = ("rgb.txt", "associations.txt", "associate.txt", "associated.txt")
_POSES = ("groundtruth.txt", "trajectory.txt", "poses.txt")
_TIME_AND_FILE = 2


def _list_file(path: Path) -> Path | None:
    return next((path / n for n in _LISTS if (path / n).is_file()), None)


def record(path: Path) -> Recording:
    """Records the pictures that the list names; poses and lens may be absent."""
    table = _list_file(path) or path / _LISTS[0]
    stream = Stream("", [], [])
    missing = []
    for number, fields in read_rows(table):
        pairs = [fields[i : i + _TIME_AND_FILE] for i in range(0, len(fields), _TIME_AND_FILE)]
        colour = [p for p in pairs if len(p) == _TIME_AND_FILE and not p[1].startswith("depth")]
        if not colour:
            raise DatasetError(
                f"{table}, line {number}",
                f"expected 'time rgb/FILE', found '{' '.join(fields)}'",
                "correct the line",
            )
        time, name = colour[0]
        if not (path / name).is_file():
            missing.append(name)
            continue
        stream.images.append(path / name)
        assert stream.times is not None
        stream.times.append(time)
    recording = Recording(path, [stream], names_from=path)
    if missing:
        what = f"{len(missing)} pictures do not exist and are left out: {list_some(missing)}"
        recording.notes.append(f"{table}: {what}")
    lens = find_lens_file(path)
    if lens is not None:
        recording.mounts = functools.partial(read_mounts, lens)
    recording.poses = next((path / n for n in _POSES if (path / n).is_file()), None)
    recording.points = next((path / n for n in POINT_FILES if (path / n).is_file()), None)
    return recording


def write_tum(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: several cameras, or two images of one time.
    """
    lens = require_one_lens(export, "TUM")
    times, _ = find_frame_times(export.frames)
    if len(set(times)) < len(times):
        raise InputError("two images have the same time: TUM's layout holds one camera")
    order = sorted(range(len(times)), key=times.__getitem__)
    labels = [format_seconds(times[i]) for i in order]
    rows = ["# color images", "# timestamp filename"]
    for i, label in zip(order, labels, strict=True):
        source = export.frames[i].image_path
        name = f"rgb/{label}{source.suffix.lower()}"
        export.place(source, folder / name)
        rows.append(f"{label} {name}")
    write_file(folder / "rgb.txt", "\n".join(rows) + "\n")
    poses = np.array([export.frames[i].world_from_camera for i in order])
    write_file(folder / "groundtruth.txt", format_tum(labels, poses))
    save_camera(lens, folder / f"lens{OWN_SUFFIX}")
    export.write_points(folder / POINTS)
    return list_losses(export, "TUM", times=True)


LAYOUT = Layout(
    "tum",
    "rgb.txt and groundtruth.txt (TUM RGB-D)",
    rank=50,
    holds=lambda path: path.is_dir() and _list_file(path) is not None,
    record=record,
    write=write_tum,
)
