"""Two lenses that took each frame together, as 360-degree cameras do: their rig, from the images.

Nothing is known of the rig beforehand. Poses found image by image say how one lens stands to the
other; then all images share one pose a frame, and each lens has parameters of its own.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import invert_pose
from gsut.data.rigs import Rig
from gsut.lens import save_camera
from gsut.sfm.core import (
    Features,
    PairMatches,
    Photographs,
    PosesOptions,
    Solution,
    rotation_angles,
)
from gsut.sfm.rig.fit import RigFit, put_on_rig

LENS_NAMES = ("front", "back")
_FEWEST = 4  # frames of which both images have a pose
_SAME = math.radians(5.0)  # that turns between the lenses differ from their middle by, at most
_RIGID = 1.5  # growth of the median residual, with one pose a frame, that speaks against a rig
# Lenses of equal parameters are one to the solver: the second one's differ in the last digits.
_APART = 1e-9
_CENTER, _FREE = (2, 3), 1  # of the parameters: the principal point


def find_lens_pair(
    alone: Solution,
    photographs: Photographs,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    flags: np.ndarray,
    folder: Path,
    on_progress: Callable[[int, int, int, str], None],
) -> tuple[Solution, RigFit | None, str]:
    """The rig of two lenses, and all images' poses on it.

    Args:
        alone: poses image by image, through one lens for both.
        photographs: with the frame and the lens of each.
        features, pairs, options: see `solve`. flags: of the lens' parameters, see `search_lens`.
        folder: where the rig and both lenses will be written.
        on_progress: of the mapper.

    Returns:
        Poses with what became of the rig, or `alone` and None; and a sentence.
    """
    start = _back_from_front(alone, photographs)
    if start is None:
        return alone, None, (
            f"fewer than {_FEWEST} frames have poses of both lenses that agree: their images are "
            "placed one by one, not as those of a rig"
        )  # fmt: skip
    lens = alone.cameras[0]
    second = lens.with_params(lens.params * (1 + _APART))
    files = tuple((folder / f"{name}.yaml", None) for name in LENS_NAMES)
    rig = Rig(folder / "rig.json", LENS_NAMES, (lens, second), np.stack([np.eye(4), start]), files)
    assert photographs.rig_cameras is not None
    cameras = [rig.cameras[camera] for camera in photographs.rig_cameras]
    flags = flags.copy()
    flags[list(_CENTER)] = _FREE  # circles are found to a pixel only
    try:
        solution, fit = put_on_rig(
            alone, photographs, cameras, features, pairs, options, on_progress, rig, True, flags
        )
    except SolveError as error:
        return alone, None, f"the images' poses make no rig of two lenses: {error}"
    before, after = fit.figures["residual_alone_px"], fit.figures["residual_px"]
    if after > _RIGID * before or solution.num_registered < alone.num_registered:
        return alone, None, (
            f"with one pose a frame {solution.num_registered} of {len(photographs)} images are "
            f"off by {after:.2f} px, one by one {alone.num_registered} by {before:.2f}: the two "
            "lenses were not read in one moment, and their images are placed one by one"
        )  # fmt: skip
    fit = _with_lenses(fit, solution, photographs.rig_cameras)
    turn = float(np.degrees(rotation_angles(fit.rig.camera_from_reference[1:, :3, :3])[0]))
    fit.figures.update(found=True, turn_degrees=turn)
    return solution, fit, (
        f"the two lenses are a rig: {fit.figures['frames_registered']} frames, the back one turned "
        f"by {turn:.2f} degrees against the front one (rig.json)"
    )  # fmt: skip


def _back_from_front(alone: Solution, photographs: Photographs) -> np.ndarray | None:
    """(4, 4) back_from_front, the middle of the frames whose poses agree; None: too few do."""
    frames, lens_of = photographs.frames, photographs.rig_cameras
    assert frames is not None and lens_of is not None
    found = []
    for frame in range(int(frames.max(initial=-1)) + 1):
        rows = [np.flatnonzero((frames == frame) & (lens_of == k) & alone.registered)
                for k in (0, 1)]  # fmt: skip
        if len(rows[0]) and len(rows[1]):
            front, back = (alone.camera_from_world[row[0]] for row in rows)
            found.append(back @ invert_pose(front))
    if len(found) < _FEWEST:
        return None
    poses = np.array(found)
    apart = np.array([rotation_angles(poses[:, :3, :3] @ pose[:3, :3].T) for pose in poses])
    middle = int(np.argmin(np.median(apart, axis=1)))
    good = apart[middle] <= _SAME
    if good.sum() < max(_FEWEST, len(poses) / 2):
        return None
    left, _, right = np.linalg.svd(poses[good, :3, :3].sum(axis=0))
    result = np.eye(4)
    result[:3, :3] = left @ right
    # The place of the back lens in the front one's frame, where it does not turn with the rest.
    place = np.median([invert_pose(pose)[:3, 3] for pose in poses[good]], axis=0)
    result[:3, 3] = -result[:3, :3] @ place
    return result


def scaled_rig(fit: RigFit, scale: float) -> RigFit:
    """The rig in another unit."""
    poses = fit.rig.camera_from_reference.copy()
    poses[:, :3, 3] *= scale
    fit.figures["baseline"] *= scale
    for row, pose in zip(fit.figures["cameras"], poses, strict=True):
        row["camera_from_reference"] = pose.tolist()
    return dataclasses.replace(fit, rig=dataclasses.replace(fit.rig, camera_from_reference=poses))


def write_lens_pair(fit: RigFit) -> None:
    """Writes both lenses beside the rig."""
    for camera, (path, _) in zip(fit.rig.cameras, fit.rig.lens_files, strict=True):
        save_camera(camera, path)


def _with_lenses(fit: RigFit, solution: Solution, lens_of: np.ndarray) -> RigFit:
    """With the lenses that were estimated."""
    cameras = tuple(solution.cameras[int(np.argmax(lens_of == k))] for k in (0, 1))
    return dataclasses.replace(fit, rig=dataclasses.replace(fit.rig, cameras=cameras))
