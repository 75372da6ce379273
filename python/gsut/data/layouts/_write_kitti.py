"""Writes KITTI's odometry layout: sequences/00 with calib.txt, times.txt, image_2; poses/00.txt."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.export import POINTS, Export, frame_times_ns, losses
from gsut.data.images import decode_image
from gsut.data.times import NANOSECONDS
from gsut.data.trajectory import format_kitti
from gsut.files import write_file

_PIXEL_SHIFT = 0.5  # KITTI's pixel (0, 0) is gsut's (0.5, 0.5)
_CAMERAS = 4


def write_kitti(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold.

    Raises:
        InputError: several cameras, or a lens with distortion.
    """
    lenses = {frame.camera for frame in export.frames}
    if len(lenses) > 1:
        raise InputError(
            f"gsut writes KITTI's layout with one camera, found {len(lenses)}; choose one with "
            "--cameras, or another layout"
        )
    (lens,) = lenses
    if lens.model != "pinhole":
        raise InputError(
            f"KITTI's calib.txt holds pinhole cameras without distortion only, and the lens is "
            f"'{lens.model}': undistort the images first, or choose nerfstudio, colmap or folder"
        )
    times, known = frame_times_ns(export.frames)
    order = sorted(range(len(times)), key=times.__getitem__)
    sequence = folder / "sequences" / "00"
    for row, i in enumerate(order):
        _place_png(export, export.frames[i].image_path, sequence / "image_2" / f"{row:06d}.png")
    fx, fy, cx, cy = (float(value) for value in lens.params)
    matrix = [fx, 0.0, cx - _PIXEL_SHIFT, 0.0, 0.0, fy, cy - _PIXEL_SHIFT, 0.0, 0.0, 0.0, 1.0, 0.0]
    text = " ".join(repr(value) for value in matrix)
    write_file(
        sequence / "calib.txt", "".join(f"P{number}: {text}\n" for number in range(_CAMERAS))
    )
    first = times[order[0]] if order else 0
    seconds = [(times[i] - first) / NANOSECONDS for i in order]
    write_file(sequence / "times.txt", "".join(f"{value:.9e}\n" for value in seconds))
    (folder / "poses").mkdir()
    poses = np.array([export.frames[i].world_from_camera for i in order])
    write_file(folder / "poses" / "00.txt", format_kitti(poses))
    export.write_points(sequence / POINTS)
    notes = losses(export, "KITTI")
    if not known:
        notes.append("the images have no times: they are written as if taken ten a second")
    return notes


def _place_png(export: Export, source: Path, target: Path) -> None:
    """KITTI's readers want PNG: others are decoded and stored without a loss."""
    if source.suffix.lower() == ".png":
        export.place(source, target)
        return
    import cv2

    target.parent.mkdir(parents=True, exist_ok=True)
    pixels = decode_image(source)[0]
    write_file(target, cv2.imencode(".png", pixels[..., ::-1])[1].tobytes())
