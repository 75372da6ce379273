"""Writes EuRoC's layout: mav0 with cam0 ..., their lenses and places, and the body's poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.export import Export, frame_times_ns, losses, seats_of
from gsut.files import write_file
from gsut.gaussians import quaternion_from_rotation
from gsut.lens import format_euroc

_POSES = "state_groundtruth_estimate0"
_HEADING = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
)


def write_euroc(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: a lens that Kalibr does not have, or cameras that do not move as one body.
    """
    seats, bodies = seats_of(export.frames, "EuRoC")
    texts = [format_euroc(seat.camera, seat.body_from_camera) for seat in seats]
    root = folder / "mav0"
    for number, (seat, text) in enumerate(zip(seats, texts, strict=True)):
        place = root / f"cam{number}"
        rows = ["#timestamp [ns],filename"]
        for frame, time in zip(seat.frames, seat.times, strict=True):
            name = f"{time}{frame.image_path.suffix.lower()}"
            export.place(frame.image_path, place / "data" / name)
            rows.append(f"{time},{name}")
        if len(set(rows)) != len(rows):
            raise InputError("two images of one camera have the same time; EuRoC names by time")
        write_file(place / "data.csv", "\n".join(rows) + "\n")
        write_file(place / "sensor.yaml", text)
    (root / _POSES).mkdir(parents=True)
    order = sorted(bodies)
    quaternions = quaternion_from_rotation(np.array([bodies[time][:3, :3] for time in order]))
    rows = [_HEADING]
    for time, quaternion in zip(order, quaternions, strict=True):
        values = (*bodies[time][:3, 3], *quaternion)
        rows.append(f"{time}," + ",".join(repr(float(v)) for v in values))
    write_file(root / _POSES / "data.csv", "\n".join(rows) + "\n")
    export.write_points(root / "pointcloud0" / "data.ply")
    notes = losses(export, "EuRoC")
    if not frame_times_ns(export.frames)[1]:
        notes.append("the images have no times: they are named as if taken ten a second")
    return notes
