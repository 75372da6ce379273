"""Writes TUM's layout: rgb/, rgb.txt, groundtruth.txt, and the lens beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.export import POINTS, Export, frame_times_ns, losses
from gsut.data.times import seconds_text
from gsut.data.trajectory import format_tum
from gsut.files import write_file
from gsut.lens import OWN_SUFFIX


def write_tum(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: several cameras, or two images of one time.
    """
    lenses = {frame.camera for frame in export.frames}
    if len(lenses) > 1:
        raise InputError(
            f"TUM's layout holds one camera, found {len(lenses)}; choose one with --cameras, or "
            "another layout"
        )
    times, known = frame_times_ns(export.frames)
    if len(set(times)) < len(times):
        raise InputError("two images have the same time: TUM's layout holds one camera")
    order = sorted(range(len(times)), key=times.__getitem__)
    labels = [seconds_text(times[i]) for i in order]
    rows = ["# color images", "# timestamp filename"]
    for i, label in zip(order, labels, strict=True):
        source = export.frames[i].image_path
        name = f"rgb/{label}{source.suffix.lower()}"
        export.place(source, folder / name)
        rows.append(f"{label} {name}")
    write_file(folder / "rgb.txt", "\n".join(rows) + "\n")
    poses = np.array([export.frames[i].world_from_camera for i in order])
    write_file(folder / "groundtruth.txt", format_tum(labels, poses))
    (lens,) = lenses
    lens.save(folder / f"lens{OWN_SUFFIX}")
    export.write_points(folder / POINTS)
    notes = losses(export, "TUM")
    if not known:
        notes.append("the images have no times: they are named as if taken ten a second")
    return notes
