"""When photographs were taken, and how a film's camera turned in between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.data import DatasetError
from gsut.data.scene import order_frames
from gsut.files import Array, read_npz, register_reader


@register_reader("turns beside capture.json", ".npz", fails=DatasetError)
def read_turns(folder: Path, captured: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Reads how a film's camera turned, as far as it recorded that.

    Args:
        folder: the one of capture.json.
        captured: its content.

    Returns:
        By source, "gyroscope" or "orientations", (N, 4) seconds and rad/s in the axes of the
        frames, each row until the next one; NaN: not recorded until then.

    Raises:
        DatasetError: the file of the records is missing or damaged.
    """
    turns = captured.get("turns")
    if not turns:
        return {}
    fields = {row["source"]: Array("f", (None, 4), finite=False) for row in turns["records"]}
    return read_npz(folder / turns["path"], fields, fails=DatasetError)


def order_by_folder(names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Returns (N,) when images were taken, in frames, and (N,) the folder that each is in.

    Each folder holds the images of one camera, whose frames are ordered by themselves.
    """
    folders = [name.rpartition("/")[0] for name in names]
    of_image = np.array([list(dict.fromkeys(folders)).index(folder) for folder in folders])
    times = np.zeros(len(names))
    for folder in range(int(of_image.max(initial=-1)) + 1):
        own = np.flatnonzero(of_image == folder)
        times[own] = order_frames([names[int(i)] for i in own])
    return times, of_image
