"""Lines of a rolling shutter from matches with places."""

import numpy as np

import tolerances
from gsut import _core
from gsut._core import Shutter
from gsut.refine.matched_lines import find_line_poses
from gsut.refine.pixel_rows import find_line_times
from random_scenes import pinhole, random_pose, subtract_poses


def test_matches_of_a_turning_camera_give_its_pose_and_motion(rng):
    """A fifth of the matches is wrong, and a global pose is off by many degrees."""
    camera, pose, shutter = pinhole(200, 160), random_pose(rng), Shutter("top_to_bottom")
    motion = np.array([0.1, -0.05, 0.1, -0.2, 0.05, 0.02])
    pixels = rng.uniform([2, 2], [198, 158], (400, 2))
    column, row = pixels.astype(int).T
    times = find_line_times(shutter, row * 200 + column, 200, 160)
    rays, valid = camera.unproject(pixels)
    assert valid.all()
    in_camera = rays * rng.uniform(2, 8, (400, 1))
    lines = [_core.moved_pose(pose, motion, time) for time in times]
    places = np.stack(
        [line[:3, :3].T @ (p - line[:3, 3]) for line, p in zip(lines, in_camera, strict=True)]
    )
    wrong = np.arange(400) < 80
    seen = np.where(wrong[:, None], rng.uniform(0, 160, (400, 2)), pixels)
    start = _core.moved_pose(pose, np.array([0.2, 0.1, -0.1, 0.05, -0.05, 0.1]), 1.0)
    found, moved, agree = find_line_poses(camera, shutter, start, seen, places, 1.0)
    off = np.concatenate([subtract_poses(found, pose), moved - motion])
    print(np.abs(off).max(), np.count_nonzero(agree[~wrong]), np.count_nonzero(agree[wrong]))
    assert np.abs(off).max() < tolerances.MATCHED_LINES
    assert np.mean(agree[~wrong]) > 0.98 and np.count_nonzero(agree[wrong]) <= 4
