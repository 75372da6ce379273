"""How far poses may be off and still come back: the share that does, by the disturbance's size."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.refine import measure_pose_changes, refine_by_tracks, refine_pose
from gsut.run import TrainOptions
from gsut.sfm import compare_poses
from tests.bench.refine_disturb import Disturbance, disturbed, disturbed_pose

BASIN_COLUMNS = (
    ("by", "basin", ""),
    ("disturbance [deg]", "degrees", "g"),
    ("[m]", "distance", "g"),
    ("poses", "poses", "d"),
    ("come back", "share", ".2f"),
)
BASIN_DEGREES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
# World units a degree, as in the disturbances; and what counts as come back.
_DISTANCE = 0.04
_BACK_DEGREES, _BACK_UNITS = 0.1, 0.01


def tracks_row(truth: Scene, degrees: float, seed: int, threads: int) -> dict[str, Any]:
    """Training views perturbed by so much, and the share that `refine_by_tracks` brings back.

    That is what `gsut train --refine-poses` begins with; errors after the best similarity.
    """
    by = Disturbance("basin", degrees=degrees, distance=_DISTANCE * degrees)
    start = disturbed(truth, by, seed)
    found = refine_by_tracks(start, TrainOptions(threads=threads, refine_poses=True)).scene
    poses = [scene.poses(truth.train_indices) for scene in (found, truth)]
    errors = compare_poses(*poses)
    return _row(degrees, _is_back(errors.rotation_degrees, errors.center_distances))


def colors_row(
    gaussians: Gaussians, scene: Scene, degrees: float, seed: int, repeats: int
) -> dict[str, Any]:
    """Test views perturbed `repeats` times each, and the share that `refine_pose` brings back.

    Args:
        gaussians: a scene trained with `scene`'s poses, which are true.
        scene: see gaussians.
        degrees, seed, repeats: of the disturbance.
    """
    rng = np.random.default_rng([seed, 2, round(1000 * degrees)])
    back = []
    for index in [index for index in scene.test_indices for _ in range(repeats)]:
        true = scene.views[index].camera_from_world
        start = disturbed_pose(rng, true, degrees, _DISTANCE * degrees)
        try:
            found = refine_pose(
                gaussians, scene.camera(index), start, scene.image(index), scene.mask(index)
            )
        except SolveError:
            back.append(False)
            continue
        change = measure_pose_changes(found.camera_from_world[None], true[None])
        back.append(bool(_is_back(change.degrees, change.distances)[0]))
    return _row(degrees, np.array(back))


def _is_back(degrees: np.ndarray, distances: np.ndarray) -> np.ndarray:
    return (degrees <= _BACK_DEGREES) & (distances <= _BACK_UNITS)


def _row(degrees: float, back: np.ndarray) -> dict[str, Any]:
    return {
        "distance": _DISTANCE * degrees,
        "poses": len(back),
        "share": float(np.mean(back)),
    }
