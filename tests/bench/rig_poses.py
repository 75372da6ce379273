"""`./run bench poses DATA --rig RIG`: poses and scale with and without it, against the truth."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gsut._core import SolveError
from gsut.data.poses import inverse
from gsut.data.rigs import Rig, read_rig, relative_changes, write_rig
from gsut.sfm import PosesOptions, compare_datasets, find_poses

DISTURBED_DEGREES = 0.5
DISTURBED_SHARE = 0.01  # of the baseline
_SEED = 1  # of the disturbance
# (heading, key of the row, format)
RIG_COLUMNS = (
    ("data", "data", ""),
    ("way", "way", ""),
    ("registered", "registered", "d"),
    ("images", "images", "d"),
    ("scale error [%]", "scale_error_percent", ".3f"),
    ("ATE [% of extent]", "ate_percent", ".4f"),
    ("in the rig's unit", "metric_ate_percent", ".4f"),
    ("rotation median [deg]", "rotation_median_degrees", ".4f"),
    ("max", "rotation_max_degrees", ".4f"),
    ("residual median [px]", "error_px", ".3f"),
    ("rig's turn left [deg]", "rig_turn_degrees", ".4f"),
    ("shift left [% of baseline]", "rig_shift_percent", ".3f"),
    ("total [s]", "total_seconds", ".1f"),
)
# What is measured: words, with a rig, the rig disturbed, and refined.
WAYS = (
    ("one by one", False, False, False),
    ("--rig", True, False, False),
    ("--rig --refine-rig", True, False, True),
    ("--rig, disturbed", True, True, False),
    ("--rig --refine-rig, disturbed", True, True, True),
)


@dataclasses.dataclass(frozen=True)
class RigBenchOptions:
    """What is measured.

    Args:
        data: dataset with true poses, in the rig's unit; its images lie in one folder a camera.
        rig: its true rig.
        threads: 0 for all.
    """

    data: str
    rig: str
    threads: int = 0


def rig_bench(options: RigBenchOptions, on_progress: Callable[[str], None]) -> list[dict[str, Any]]:
    """One row for each of WAYS; None for what does not apply.

    Args:
        options: see RigBenchOptions.
        on_progress: told what begins.

    Raises:
        InputError: dataset or rig cannot be read.
    """
    rows = []
    for words, with_rig, wrong, refined in WAYS:
        on_progress(words)
        rows.append(_measure(options, words, with_rig, wrong, refined))
    return rows


def disturbed(rig: Rig) -> Rig:
    """Each camera but the first turned and moved, across its distance from the first.

    By DISTURBED_DEGREES, and by DISTURBED_SHARE of that distance, which stays: it is the scale, and
    no image could tell it.
    """
    rng = np.random.default_rng(_SEED)
    poses = [rig.camera_from_reference[0]]
    first = inverse(poses[0])[:3, 3]
    for pose in rig.camera_from_reference[1:]:
        axis, side = rng.standard_normal((2, 3))
        turn = cv2.Rodrigues(np.radians(DISTURBED_DEGREES) * axis / np.linalg.norm(axis))[0]
        apart = inverse(pose)[:3, 3] - first
        across = np.cross(apart, side)
        length = max(float(np.linalg.norm(across)), 1e-300)
        across *= DISTURBED_SHARE * np.linalg.norm(apart) / length
        moved = (apart + across) / np.hypot(1.0, DISTURBED_SHARE)
        changed = np.eye(4)
        changed[:3, :3] = turn @ pose[:3, :3]
        changed[:3, 3] = -changed[:3, :3] @ (first + moved)
        poses.append(changed)
    return dataclasses.replace(rig, camera_from_reference=np.array(poses))


def _measure(
    options: RigBenchOptions, words: str, with_rig: bool, wrong: bool, refined: bool
) -> dict[str, Any]:
    data, truth = Path(options.data), read_rig(options.rig)
    row: dict[str, Any] = {
        **{key: None for _, key, _ in RIG_COLUMNS}, "data": data.name, "way": words
    }  # fmt: skip
    settings = PosesOptions(threads=options.threads)
    with tempfile.TemporaryDirectory(prefix="gsut-rig-") as folder:
        out, rig = Path(folder) / "found", Path(folder) / "rig.json"
        try:
            if with_rig:
                write_rig(disturbed(truth) if wrong else truth, rig)
                result = find_poses(data, out, rig=rig, refine_rig=refined, options=settings)
            else:
                result = find_poses(data, out, options=settings)
        except SolveError as error:
            return {**row, "failure": str(error)}
        figures = result.figures
        errors = compare_datasets(data, out)
        row.update(
            registered=figures["registered"],
            images=figures["images"],
            error_px=figures["reprojection_error_px"]["median"],
            total_seconds=figures["seconds"]["total"],
            ate_percent=errors.ate_percent,
            rotation_median_degrees=float(np.median(errors.rotation_degrees)),
            rotation_max_degrees=float(errors.rotation_degrees.max()),
        )
        if with_rig:
            found = np.array([c["camera_from_reference"] for c in figures["rig"]["cameras"]])
            changes = relative_changes(truth, found)
            row.update(
                scale_error_percent=errors.scale_error_percent,
                metric_ate_percent=100.0 * errors.metric_ate / errors.extent,
                rig_turn_degrees=float(np.degrees(max(turn for turn, _ in changes))),
                rig_shift_percent=100.0 * max(shift for _, shift in changes) / truth.baseline,
            )
    return row
