"""TUM's RGB-D layout: rgb.txt (or associations.txt), groundtruth.txt and a lens file.

DATA/rgb.txt             lines `time rgb/FILE`; or associations.txt, `time rgb/FILE time depth/FILE`
DATA/groundtruth.txt     lines `time tx ty tz qx qy qz qw`, camera-to-world; or trajectory.txt
DATA/lens.yaml           any lens file: TUM's own sets have none
"""

from __future__ import annotations

import functools
from pathlib import Path

from gsut.data.findings import DatasetError, some_names
from gsut.data.layouts._layout import Layout
from gsut.data.layouts._write_tum import write_tum
from gsut.data.layouts.folder import POINT_FILES, find_lens_file
from gsut.data.mounts import read_mounts
from gsut.data.recording import Recording, Stream
from gsut.data.text_files import rows_of

_LISTS = ("rgb.txt", "associations.txt", "associate.txt", "associated.txt")
_POSES = ("groundtruth.txt", "trajectory.txt", "poses.txt")
_TIME_AND_FILE = 2


def _list_file(path: Path) -> Path | None:
    return next((path / n for n in _LISTS if (path / n).is_file()), None)


def record(path: Path) -> Recording:
    """The pictures that the list names; poses and lens may be absent."""
    table = _list_file(path) or path / _LISTS[0]
    stream = Stream("", [], [])
    missing = []
    for number, fields in rows_of(table):
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
        what = f"{len(missing)} pictures do not exist and are left out: {some_names(missing)}"
        recording.notes.append(f"{table}: {what}")
    lens = find_lens_file(path)
    if lens is not None:
        recording.mounts = functools.partial(read_mounts, lens)
    recording.poses = next((path / n for n in _POSES if (path / n).is_file()), None)
    recording.points = next((path / n for n in POINT_FILES if (path / n).is_file()), None)
    return recording


LAYOUT = Layout(
    "tum",
    "rgb.txt and groundtruth.txt (TUM RGB-D)",
    rank=50,
    holds=lambda path: path.is_dir() and _list_file(path) is not None,
    record=record,
    write=write_tum,
)
