"""A made flight straight down over the ground: features, matches, poses and a lens to estimate."""

import dataclasses
import functools
from pathlib import Path

import numpy as np

import gsut
from gsut import Shutter, _core
from gsut.data.rigs import Rig
from gsut.sfm import PosesOptions
from gsut.sfm.mapping import Findings, Mapping, PosesLog, RigFit
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Images, Photographs
from gsut.sfm.solution import Adjustment, ReadoutMotion, RigConstraint, adjust_poses
from synthetic_walk import observe

LENS = gsut.Camera("kannala_brandt", [520, 520, 320, 240, 1 / 3, 0.13, 0, 0], 640, 480)
FREE = np.array([2, 2, 0, 0, 1, 0, 0, 0], np.uint8)
OPTIONS = PosesOptions()
HEIGHT = 10.0


# Centres of the cameras, which look along z, in units of a tenth of the height.
CENTERS = np.array([[1.6 * (i % 4) - 2.4, 1.6 * (i // 4) - 1.6, 0.0] for i in range(12)])


DOWN = Shutter("top_to_bottom")


def project(points, pose, velocity):
    """Pixels of points in a camera that moves while its lines are read, and which have one."""
    pixels, valid = LENS.project(points @ pose[:3, :3].T + pose[:3, 3])
    for _ in range(6 if np.any(velocity) else 0):  # the line that sees a point: a fixed point
        times = np.nan_to_num(pixels[:, 1]) / LENS.height - 0.5
        moved = np.array([_core.moved_pose(pose, velocity, time) for time in times])
        p = np.einsum("nij,nj->ni", moved[:, :3, :3], points) + moved[:, :3, 3]
        pixels, valid = LENS.project(p)
    return pixels, valid


def list_true_poses(turn):
    """The camera_from_world (12, 4, 4) of a flight."""
    poses = []
    for i, center in enumerate(CENTERS):
        pose = _core.exp_pose([0, 0, 0, 0, turn * (i % 3), turn * i])
        pose[:3, 3] = -pose[:3, :3] @ center
        poses.append(pose)
    return np.array(poses)


def fly(rng, relief, stretch=0.0, turn=0.0, speed=0.0, mounts=()):
    """A flight over the ground, adjusted with its lens: a finished run.

    relief: of the ground in heights. stretch: standard deviation of an error of scale that all
    features of an image share. turn: about the vertical, radians from one image to the next.
    speed: along x while an image is read. mounts: (4, 4) of further cameras on a rig.
    """
    span = np.array([9.0, 7.0, relief * HEIGHT])
    points = np.array([0, 0, HEIGHT]) + rng.uniform(-span, span, (400, 3))
    bodies, poses, features, seen = list_true_poses(turn), [], [], []
    velocity = np.array([speed, 0, 0, 0, 0, 0])
    for mount in (np.eye(4), *mounts):
        for body in bodies:
            poses.append(mount @ body)
            pixels, valid = project(points, poses[-1], velocity)
            pixels = (pixels - [320, 240]) * (1 + stretch * rng.standard_normal()) + [320, 240]
            rows, found = observe(rng, LENS, pixels, valid, 0.3, np.ones((len(points), 128)))
            features.append(found), seen.append(rows)
    pairs = []
    for i in range(len(poses)):
        for j in range(i + 1, len(poses)):
            _, a, b = np.intersect1d(seen[i], seen[j], return_indices=True)
            second_from_first = poses[j] @ np.linalg.inv(poses[i])
            matches = np.stack([a, b], axis=1).astype(np.int32)
            pairs.append(PairMatches(i, j, matches, second_from_first, 0, 0.2))
    names = [f"{i:02d}.jpg" for i in range(len(poses))]
    frames, cameras = np.arange(len(poses)) % 12, np.arange(len(poses)) // 12
    motion = rig = fit = None
    if speed:
        rates = np.tile(velocity, (len(poses), 1)) * rng.normal(1, 0.05, (len(poses), 1))
        motion = ReadoutMotion(DOWN, 1.0, rates)
    if mounts:
        rig = RigConstraint(frames, cameras - 1, np.array(mounts), np.ones(len(poses), bool))
        lenses = (LENS,) * (1 + len(mounts))
        files = tuple((Path("lens.yaml"), None) for _ in lenses)
        whole = Rig(Path("rig.json"), ("a", "b"), lenses, np.array([np.eye(4), *mounts]), files)
        rows = [{"camera_from_reference": each.tolist()} for each in whole.camera_from_reference]
        fit = RigFit(whole, {"baseline": whole.baseline, "cameras": rows}, [])
    solution = adjust_poses(
        Images(names, [LENS] * len(poses), features), pairs, poses, OPTIONS,
        adjustment=Adjustment(FREE, rig=rig, motion=motion, extend=motion is not None),
    )  # fmt: skip
    photographs = Photographs(
        None, names, [], [None] * len(poses), solution.cameras,
        frames=frames if mounts else None, rig_cameras=cameras if mounts else None,
    )  # fmt: skip
    return Mapping(
        photographs, OPTIONS, PosesLog(), features=features, pairs=pairs, solution=solution,
        lens_free=FREE, found=Findings(rig=fit),
    )  # fmt: skip


@functools.cache
def _fly_once(seed, relief, turn, speed):
    return fly(np.random.default_rng(seed), relief, turn=turn, speed=speed)


def fly_again(seed, relief, turn=0.0, speed=0.0):
    """A flight as `fly` makes it from a seed, made once for all tests; its log is its own."""
    return dataclasses.replace(_fly_once(seed, relief, turn, speed), log=PosesLog())
