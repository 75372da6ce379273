"""Frames of ROS: those that rest on each other, and those that move, joined to one track."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gsut.data.errors import DatasetError
from gsut.data.layouts._bag_messages import strip_slash
from gsut.data.poses import interpolate_between, invert_pose


@dataclasses.dataclass
class Track:
    """Poses as the bag has them: parent_from_child at nanoseconds."""

    topic: str
    parent: str = ""
    child: str = ""
    times: list[int] = dataclasses.field(default_factory=list)
    poses: list[np.ndarray] = dataclasses.field(default_factory=list)


class FrameTree:
    """Places of coordinate frames that do not move against each other (/tf_static)."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}

    def add(self, parent: str, child: str, parent_from_child: np.ndarray) -> None:
        self._parents[strip_slash(child)] = (strip_slash(parent), parent_from_child)

    def _to_root(self, frame: str) -> tuple[str, np.ndarray]:
        root_from_frame, seen = np.eye(4), {frame}
        while frame in self._parents:
            frame, step = self._parents[frame]
            root_from_frame = step @ root_from_frame
            if frame in seen:
                break
            seen.add(frame)
        return frame, root_from_frame

    def find_transform(self, target: str, source: str) -> np.ndarray | None:
        """Returns target_from_source (4, 4); None if the two are not connected."""
        (root, root_from_target), (other, root_from_source) = (
            self._to_root(strip_slash(frame)) for frame in (target, source)
        )
        return invert_pose(root_from_target) @ root_from_source if root == other else None

    def find_root(self, frame: str) -> str:
        return self._to_root(strip_slash(frame))[0]


def join_tracks(
    moving: Mapping[tuple[str, str], Track], tree: FrameTree, frames: Sequence[str], bag: Path
) -> Track:
    """Joins the moving transforms above the cameras' frames, such as map to odom to base, to one.

    Poses are those at the times of the lowest transform, while the others have any.

    Args:
        moving: of /tf, by the names of parent and child.
        tree: of /tf_static.
        frames: of the cameras.
        bag: for messages.

    Raises:
        DatasetError: there is none, or more than one way up.
    """
    below = {tree.find_root(frame) for frame in frames}
    joined, used = None, set()
    while True:
        above = [track for (_, child), track in moving.items() if tree.find_root(child) in below]
        if joined is not None and not above:
            return joined
        if len(above) != 1 or id(above[0]) in used:
            edges = ", ".join(f"{parent} to {child}" for parent, child in moving) or "none"
            raise DatasetError(
                bag,
                "no topic of poses, and /tf holds no single way of moving transforms above the "
                f"frames {', '.join(sorted(below))}: {edges}",
                "record odometry, or give a trajectory with --poses FILE; `gsut data convert BAG "
                "OUT --to films` makes films, whose poses `gsut scene` finds",
            )
        used.add(id(above[0]))
        joined = above[0] if joined is None else _join_two(above[0], joined, tree)
        below = {tree.find_root(joined.parent)}


def _join_two(upper: Track, lower: Track, tree: FrameTree) -> Track:
    joined = Track(lower.topic, upper.parent, lower.child)
    between = tree.find_transform(upper.child, lower.parent)
    assert between is not None  # both have one root
    order = np.argsort(upper.times, kind="stable")
    times = np.array(upper.times)[order]
    for time, pose in zip(lower.times, lower.poses, strict=True):
        high = int(np.searchsorted(times, time))
        if high == len(times) or (high == 0 and times[0] != time):
            continue
        low = max(0, high - 1)
        share = 0.0 if high == low else (time - times[low]) / (times[high] - times[low])
        above = interpolate_between(upper.poses[order[low]], upper.poses[order[high]], float(share))
        joined.times.append(time)
        joined.poses.append(above @ between @ pose)
    return joined
