"""A made flight straight down over the ground: features, matches, poses and a lens to estimate."""

import numpy as np

import gsut
from gsut import _core
from gsut.sfm import PosesOptions
from gsut.sfm.mapping import Mapping, PosesLog
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Images, Photographs
from gsut.sfm.solution import Adjustment, adjust_poses
from synthetic_walk import observe

LENS = gsut.Camera("kannala_brandt", [520, 520, 320, 240, 1 / 3, 0.13, 0, 0], 640, 480)
FREE = np.array([2, 2, 0, 0, 1, 0, 0, 0], np.uint8)
OPTIONS = PosesOptions(extend_rounds=0)
HEIGHT = 10.0


# Centres of the cameras, which look along z, in units of a tenth of the height.
CENTERS = np.array([[1.6 * (i % 4) - 2.4, 1.6 * (i // 4) - 1.6, 0.0] for i in range(12)])


def fly(rng, relief, stretch=0.0, turn=0.0):
    """A flight over the ground, adjusted with its lens: a finished run.

    relief: of the ground in heights. stretch: standard deviation of an error of scale that all
    features of an image share. turn: about the vertical, radians from one image to the next.
    """
    span = np.array([9.0, 7.0, relief * HEIGHT])
    points = np.array([0, 0, HEIGHT]) + rng.uniform(-span, span, (400, 3))
    poses, features, seen = [], [], []
    for i in range(12):
        pose = _core.exp_pose([0, 0, 0, 0, turn * (i % 3), turn * i])
        pose[:3, 3] = -pose[:3, :3] @ CENTERS[i]
        pixels, valid = LENS.project(points @ pose[:3, :3].T + pose[:3, 3])
        pixels = (pixels - [320, 240]) * (1 + stretch * rng.standard_normal()) + [320, 240]
        rows, found = observe(rng, LENS, pixels, valid, 0.3, np.ones((len(points), 128)))
        poses.append(pose), features.append(found), seen.append(rows)
    pairs = []
    for i in range(12):
        for j in range(i + 1, 12):
            _, a, b = np.intersect1d(seen[i], seen[j], return_indices=True)
            second_from_first = poses[j] @ np.linalg.inv(poses[i])
            matches = np.stack([a, b], axis=1).astype(np.int32)
            pairs.append(PairMatches(i, j, matches, second_from_first, 0, 0.2))
    names = [f"{i:02d}.jpg" for i in range(12)]
    solution = adjust_poses(
        Images(names, [LENS] * 12, features), pairs, poses, OPTIONS, adjustment=Adjustment(FREE)
    )
    photographs = Photographs(None, names, [], [None] * 12, solution.cameras)
    return Mapping(
        photographs, OPTIONS, PosesLog(), features=features, pairs=pairs, solution=solution,
        lens_free=FREE,
    )  # fmt: skip
