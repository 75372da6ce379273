"""Hypotheses of poses that are wrong along the path: clock, shutter, drifts, names."""

from __future__ import annotations

import itertools

import numpy as np

from gsut._core import exp_pose
from gsut.data.poses import invert_pose
from gsut.gaussians import find_nearest_rotation
from gsut.judge.epipolar import MOMENTS
from gsut.judge.hypotheses import Dataset, Hypothesis, Rate, Variant, Variants, climb

_MOST_VIEWS = 60  # among which poses are exchanged: each is tried in place of each


def shift_frames(data: Dataset, frames: np.ndarray) -> Dataset:
    """Takes each pose (of each of B moments) some frames (B,) later on the path of its camera."""
    table = np.repeat(data.poses, len(frames), axis=1) if data.poses.shape[1] == 1 else data.poses
    moved = table.copy()
    for path in data.paths:
        if len(path) > 1:
            at = np.clip(np.arange(len(path))[:, None] + frames, 0, len(path) - 1)
            low = np.minimum(at.astype(int), len(path) - 2)
            share, moment = (at - low)[..., None, None], np.arange(len(frames))
            one, two = (table[np.array(path)[k], moment] for k in (low, low + 1))
            moved[path] = (1 - share) * one + share * two
            moved[path, :, :3, :3] = find_nearest_rotation(moved[path, :, :3, :3])
    return data.place(moved)


def _suppose_clocks(data: Dataset, rate: Rate) -> Variants:
    moments = data.poses.shape[1]

    def suppose(x: np.ndarray) -> Dataset:
        return shift_frames(data, np.full(moments, x[0]))

    x = climb(suppose, rate, [[k] for k in (-3, -2, -1, -0.5, 0.5, 1, 2, 3)], [0.25])
    frames = f"{abs(x[0]):.2g} frame{'' if abs(x[0]) == 1 else 's'}"
    yield Variant(f"{frames} {'later' if x[0] > 0 else 'earlier'}", "", suppose(x))


def _suppose_shutters(data: Dataset, _: Rate) -> Variants:
    moments = data.poses.shape[1]
    if moments > 1:
        middle = np.repeat(data.poses[:, moments // 2 :][:, :1], moments, axis=1)
        yield Variant("of a global shutter", "train with --shutter global", data.place(middle))
        yield Variant(
            "with the shutter's direction reversed",
            "write the other direction into 'rolling_shutter', or swap start and end poses",
            data.place(data.poses[:, ::-1]),
        )


def _suppose_readouts(data: Dataset, rate: Rate) -> Variants:
    if data.poses.shape[1] > 1:
        return
    along = (np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5

    def suppose(x: np.ndarray) -> Dataset:
        return shift_frames(data, x[0] * along)

    x = climb(suppose, rate, [[-0.6], [-0.2], [0.2], [0.6]], [0.1])
    way = "first to the last" if x[0] > 0 else "last to the first"
    words = f"from the {way} line takes {abs(x[0]):.2f}"
    if abs(x[0]) <= 1:
        yield Variant(words, "", suppose(x))


def _suppose_headings(data: Dataset, rate: Rate) -> Variants:
    def suppose(x: np.ndarray) -> Dataset:
        turn, poses = exp_pose([0.0, 0.0, 0.0, *x]), data.poses.copy()
        for path in data.paths:
            change = np.eye(4)
            for before, view in itertools.pairwise(path):
                pose = data.poses[before, 0]
                change = change @ pose @ turn @ invert_pose(pose)
                poses[view] = change @ data.poses[view]
        return data.place(poses)

    x = climb(suppose, rate, [np.zeros(3)], np.full(3, 0.02))
    count = max(map(len, data.paths)) - 1
    yield Variant(f"{np.degrees(np.linalg.norm(x)) * count:.1f}", "", suppose(x))


def _suppose_scales(data: Dataset, rate: Rate) -> Variants:
    def suppose(x: np.ndarray) -> Dataset:
        poses = data.poses.copy()
        for path in data.paths:
            centers = data.poses[path, 0, :3, 3]
            factors = np.exp(x[0] * np.arange(len(path)) / max(1, len(path) - 1))
            steps = factors[1:, None] * np.diff(centers, axis=0)
            moved = centers[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
            inside = factors[:, None, None] * (poses[path, :, :3, 3] - centers[:, None])
            poses[path, :, :3, 3] = moved[:, None] + inside
        return data.place(poses)

    x = climb(suppose, rate, [[k] for k in np.linspace(-1.2, 1.2, 13)], [0.1])
    yield Variant(f"{np.exp(-x[0]):.2f}", "", suppose(x))


def _suppose_scale_steps(data: Dataset, rate: Rate) -> Variants:
    for path in data.paths:
        starts = [(k, s) for k in np.linspace(1, len(path) - 2, 12) for s in (-0.4, 0.4)]

        def suppose(x: np.ndarray, path: list[int] = path) -> Dataset:
            poses, place = data.poses.copy(), int(np.clip(round(x[0]), 0, len(path) - 2))
            center = data.poses[path[place], 0, :3, 3]
            late = path[place + 1 :]
            poses[late, :, :3, 3] = center + np.exp(x[1]) * (poses[late, :, :3, 3] - center)
            return data.place(poses)

        if len(path) > 2:
            x = climb(suppose, rate, starts, [len(path) / 16, 0.1])
            yield Variant(f"{np.exp(-x[1]):.2f}", "", suppose(x))


def _suppose_other_names(data: Dataset, rate: Rate) -> Variants:
    """Gives views the poses of other views, one after another, where that fits better."""
    best = float(np.mean(rate(data)))
    changed: list[int] = []
    for view in range(len(data.poses)) if len(data.poses) <= _MOST_VIEWS else ():
        tried = []
        for other in range(len(data.poses)):
            poses = data.poses.copy()
            poses[view] = poses[other]
            tried.append((float(np.mean(rate(data.place(poses)))), other))
        if max(tried)[0] > best:
            best, other = max(tried)
            poses = data.poses.copy()
            poses[view] = poses[other]
            data, changed = data.place(poses), [*changed, view]
    if changed:
        yield Variant(f"{len(changed)}", "", data)


PATH_ERRORS: tuple[Hypothesis, ...] = (
    Hypothesis("these poses when each image takes the pose of {}",
               "shift the poses' clock against the images' by as much, or pair names and poses "
               "again", "poses", _suppose_clocks, free=1),
    Hypothesis("these poses {}", "{}", "poses", _suppose_shutters),
    Hypothesis("a rolling shutter, whose readout {} of the time between two images",
               "find poses of the lines (`gsut poses --shutter rolling`), or write "
               "transform_matrix_start and _end of each image", "poses", _suppose_readouts, free=1),
    Hypothesis("poses without the turn of about {} degrees that these accumulate along the path",
               "the poses drift, as odometry does: adjust all of them at once (`gsut poses`)",
               "poses", _suppose_headings, is_everywhere=True, free=3),
    Hypothesis("poses whose scale does not drift by a factor of about {} along the path",
               "the poses drift, as odometry does: adjust all of them at once (`gsut poses`)",
               "poses", _suppose_scales, free=1),
    Hypothesis("poses whose scale does not change by a factor of {} at one place",
               "find poses of all images at once (`gsut poses`), or scale one part's positions",
               "poses", _suppose_scale_steps, free=2),
    Hypothesis("other images' poses in {} of the images",
               "check names, order and time stamps: pair names and poses again", "poses",
               _suppose_other_names, is_gross=True),
)  # fmt: skip
