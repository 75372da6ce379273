"""Finds the rig of the two lenses of a camera from images that were placed one by one."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import invert_pose
from gsut.data.rigs import Rig
from gsut.gaussians import find_nearest_rotation, measure_rotation_angles
from gsut.judge import SAME_DEGREES
from gsut.judge.checks import SHAKY
from gsut.sfm.mapping import Mapping
from gsut.sfm.photographs import Photographs
from gsut.sfm.rig.fit import RIG, put_on_rig
from gsut.sfm.rig.start import FEWEST_FRAMES
from gsut.sfm.solution import CENTER, LensFlag, Solution

LENS_NAMES = ("front", "back")
# The solver takes lenses of equal parameters for one: the second differs in the last digits.
_DIFFERENCE = 1e-9


def find_lens_pair(mapping: Mapping) -> Mapping:
    """Finds the rig of two lenses, and the poses of all images on it.

    Does nothing where the lens was known or images have no frames. With a rolling shutter the rig
    moves while its images are read.

    Args:
        mapping: poses image by image, through one lens for both.

    Returns:
        The run with the solution on the rig, flags of both lenses and the fit of the rig.
    """
    photographs, alone = mapping.photographs, mapping.solved
    frames, flags = photographs.frames, mapping.one_lens_free
    if flags is None or frames is None:
        return mapping
    start = _find_back_from_front(alone, photographs)
    if start is None:
        mapping.log.note(
            f"fewer than {FEWEST_FRAMES} frames have poses of both lenses that agree: their images "
            "are placed one by one, not as those of a rig"
        )
        return mapping
    lens = alone.cameras[0]
    second = lens.with_params(lens.params * (1 + _DIFFERENCE))
    rig = Rig(Path(RIG), LENS_NAMES, (lens, second), np.stack([np.eye(4), start]), (None, None))
    assert photographs.rig_cameras is not None
    cameras = [rig.cameras[camera] for camera in photographs.rig_cameras]
    flags = flags.copy()
    flags[list(CENTER)] = LensFlag.FREE  # circles are found to a pixel only
    of_rig = dataclasses.replace(photographs, cameras=cameras)
    through_both = dataclasses.replace(alone, cameras=cameras)
    try:
        solution, fit = put_on_rig(
            mapping.replace(photographs=of_rig, lens_free=flags, solution=through_both), rig, True
        )  # fmt: skip
    except SolveError as error:
        mapping.log.note(f"the images' poses make no rig of two lenses: {error}")
        return mapping
    before, after = fit.figures["residual_alone_px"], fit.figures["residual_px"]
    if after > SHAKY * before or solution.num_registered < alone.num_registered:
        mapping.log.note(
            f"with one pose a frame {solution.num_registered} of {len(photographs)} images are "
            f"off by {after:.2f} px, one by one {alone.num_registered} by {before:.2f}: the two "
            "lenses were not read in one moment, and their images are placed one by one"
        )
        return mapping
    turn = float(np.degrees(measure_rotation_angles(fit.rig.camera_from_reference[1:, :3, :3])[0]))
    fit = dataclasses.replace(fit, figures={**fit.figures, "found": True, "turn_degrees": turn})
    mapping.log.note(
        f"the two lenses are a rig: {fit.figures['frames_registered']} frames, the back one turned "
        f"by {turn:.2f} degrees against the front one (rig.json)"
    )
    return mapping.replace(solution=solution, lens_free=flags).add_findings(rig=fit)


def _find_back_from_front(alone: Solution, photographs: Photographs) -> np.ndarray | None:
    """Returns (4, 4) back_from_front, the middle of the frames whose poses agree, or None."""
    frames, lens_of = photographs.frames, photographs.rig_cameras
    assert frames is not None and lens_of is not None
    found = []
    for frame in range(int(frames.max(initial=-1)) + 1):
        rows = [np.flatnonzero((frames == frame) & (lens_of == k) & alone.registered)
                for k in (0, 1)]  # fmt: skip
        if len(rows[0]) and len(rows[1]):
            front, back = (alone.camera_from_world[row[0]] for row in rows)
            found.append(back @ invert_pose(front))
    if len(found) < FEWEST_FRAMES:
        return None
    poses = np.array(found)
    apart = np.array([measure_rotation_angles(poses[:, :3, :3] @ pose[:3, :3].T) for pose in poses])
    middle = int(np.argmin(np.median(apart, axis=1)))
    good = apart[middle] <= math.radians(SAME_DEGREES)
    if good.sum() < max(FEWEST_FRAMES, len(poses) / 2):
        return None
    result = np.eye(4)
    result[:3, :3] = find_nearest_rotation(poses[good, :3, :3].sum(axis=0))
    # The position of the back lens in the front one's frame does not turn with the cameras.
    place = np.median([invert_pose(pose)[:3, 3] for pose in poses[good]], axis=0)
    result[:3, 3] = -result[:3, :3] @ place
    return result
