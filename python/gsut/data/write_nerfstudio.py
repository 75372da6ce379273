"""Writes a dataset in nerfstudio's form: transforms.json, its lens files and the points' PLY."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.listing import Frame
from gsut.data.poses import OPENGL_FROM_OPENCV
from gsut.data.scene import DISTANCES
from gsut.files import parse_json, write_file
from gsut.lens import Camera, save_camera
from gsut.lens.files import LENS_FILE, OWN_SUFFIX, format_nerfstudio

_PIXEL_CENTER = 0.5  # of the first pixel, written for other readers: cx = w / 2 is the middle


def write_transforms(
    path: Path,
    frames: Sequence[Frame],
    *,
    points_file: str | None = None,
    test: Collection[str] | None = None,
    up: np.typing.ArrayLike | None = None,
) -> None:
    """Writes a transforms.json, and beside it a lens file for each lens nerfstudio has no name for.

    The lens stands at the top, or in each frame where there are several. Files are named by their
    paths from the folder. Each file is written as a whole or not at all, lens files first.

    Args:
        path: DATA/transforms.json; lens files become DATA/transforms.lens.json, or
            transforms.0.lens.json ... where there are several.
        frames: one for each image; shutters of several directions are written frame by frame.
        points_file: name of the points' PLY in the folder.
        test: names of the frames that are for testing; None: the reader chooses.
        up: (3,) in the world; None: not known.

    Raises:
        OSError: a file cannot be written.
    """
    lenses = list(dict.fromkeys(frame.camera for frame in frames))
    texts = _describe_lenses(lenses, path)
    text = _format_transforms(frames, path.parent, texts, points_file, test, up)
    for lens, values in texts.items():
        if LENS_FILE in values:
            save_camera(lens, path.parent / values[LENS_FILE])
    write_file(path, text)


def _describe_lenses(lenses: Sequence[Camera], path: Path) -> dict[Camera, dict[str, Any]]:
    """Describes each lens by nerfstudio's keys, or by the name of its file."""
    texts: dict[Camera, dict[str, Any]] = {}
    for lens in lenses:
        try:
            texts[lens] = parse_json(format_nerfstudio(lens), "lens")
        except InputError:
            texts[lens] = {}
    unnamed = [lens for lens in lenses if not texts[lens]]
    for number, lens in enumerate(unnamed):
        middle = f".{number}" if len(unnamed) > 1 else ""
        texts[lens] = {
            LENS_FILE: f"{path.stem}{middle}{OWN_SUFFIX}", "w": lens.width, "h": lens.height
        }  # fmt: skip
    return texts


def _format_transforms(
    frames: Sequence[Frame],
    folder: Path,
    texts: dict[Camera, dict[str, Any]],
    points_file: str | None,
    test: Collection[str] | None,
    up: np.typing.ArrayLike | None,
) -> str:
    lenses = list(texts)
    values: dict[str, Any] = dict(texts[lenses[0]]) if len(lenses) == 1 else {}
    values["pixel_center"] = _PIXEL_CENTER
    if up is not None:
        values["up"] = np.asarray(up, np.float64).tolist()
    if points_file is not None:
        values["ply_file_path"] = points_file
    directions = {frame.shutter.direction for frame in frames if frame.shutter is not None}
    is_shared = len(directions) == 1
    if is_shared:
        values["rolling_shutter"] = {"direction": min(directions)}
    rows = [
        (texts[frame.camera] if len(lenses) > 1 else {}) | _describe_frame(frame, folder)
        for frame in frames
    ]
    for frame, row in zip(frames, rows, strict=True):
        if frame.shutter is not None and not is_shared:  # cameras of a rig that differ
            row["rolling_shutter"] = {"direction": frame.shutter.direction}
    if test is not None:
        named = [
            (row["file_path"], frame.name in test) for row, frame in zip(rows, frames, strict=True)
        ]
        values["train_filenames"] = [name for name, is_test in named if not is_test]
        values["test_filenames"] = [name for name, is_test in named if is_test]
        # nerfstudio reads this list in training and refuses a file that has only the others.
        values["val_filenames"] = values["test_filenames"]
    return json.dumps({**values, "frames": rows}, indent=1) + "\n"


def _describe_frame(frame: Frame, folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = {"file_path": _name_relative(frame.image_path, folder)}
    if frame.time is not None:
        values["timestamp"] = frame.time
    if frame.time_ns is not None:
        values["timestamp_ns"] = frame.time_ns
    for ending in ("", "_start", "_end"):
        pose = getattr(frame, f"world_from_camera{ending}")
        if pose is not None:
            values[f"transform_matrix{ending}"] = (pose @ OPENGL_FROM_OPENCV).tolist()
    files = {
        "mask_path": frame.mask_path,
        "depth_file_path": frame.depth_path,
        "confidence_file_path": frame.depth_form.confidence_path,
    }
    for key, path in files.items():
        if path is not None:
            values[key] = _name_relative(path, folder)
    if frame.depth_path is not None and frame.depth_form != DISTANCES:
        form = frame.depth_form
        values |= {"depth_unit": form.unit, "depth_along": "z" if form.is_z else "ray"}
        values["least_confidence"] = form.least_confidence
    return values


def _name_relative(path: Path, folder: Path) -> str:
    place = path.parent.resolve() / path.name  # a link stands for itself
    return Path(os.path.relpath(place, folder.resolve())).as_posix()
