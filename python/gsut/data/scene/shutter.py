"""How a scene's images were read out: as its files say, at once, or line by line."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from gsut._core import InputError, Shutter, interpolate_pose
from gsut.data.poses import invert_pose
from gsut.data.scene.scene import Scene, View

_FROM_END = re.compile(r"(\D*)(\d*)")  # of a name written backward


def with_shutter(
    scene: Scene,
    shutter: str = "auto",
    readout_time: float | None = None,
    direction: str = "top_to_bottom",
) -> Scene:
    """Sets the shutters of the scene's views.

    Args:
        scene: views with one pose each, or with a start and an end pose.
        shutter: "auto": as the data says, rolling where `readout_time` is given; "global": one pose
            an image; "rolling": start and end poses of the data, or `readout_time`.
        readout_time: time from the first line to the last, over the time between two frames of the
            video. Views without a start and an end pose get them from the velocity between their
            neighbours, frames in the order of the numbers in their names.
        direction: of these views' shutter, see `Shutter`.

    Raises:
        InputError: "rolling" without poses or a readout time, "global" with a readout time, or
            fewer than two frames.
    """
    if shutter == "global":
        if readout_time is not None:
            raise InputError("--shutter global and --readout-time contradict each other: drop one")
        views = [
            dataclasses.replace(
                view, camera_from_world_start=None, camera_from_world_end=None, shutter=None
            )
            for view in scene.views
        ]
        return scene.replace(views=views)
    still = [i for i, view in enumerate(scene.views) if view.shutter is None]
    if not still or (shutter == "auto" and readout_time is None):
        return scene
    if readout_time is None:
        raise InputError(
            f"--shutter rolling, but {len(still)} of the {len(scene.views)} views of {scene.path} "
            "have no transform_matrix_start and _end; give --readout-time"
        )
    moving = _set_views_moving(scene.views, readout_time, Shutter(direction))
    return scene.replace(
        views=[moving[i] if view.shutter is None else view for i, view in enumerate(scene.views)]
    )


def _set_views_moving(views: Sequence[View], readout_time: float, shutter: Shutter) -> list[View]:
    """Gives the views a start and an end pose by their neighbours in time."""
    if len(views) < 2:
        raise InputError("--readout-time needs at least two frames to find the camera's velocity")
    moving = []
    for view, (before, after, time) in zip(views, _find_time_neighbours(views), strict=True):
        start, end = _shift_along_path(view, views[before], views[after], 0.5 * readout_time / time)
        moving.append(
            dataclasses.replace(
                view, camera_from_world_start=start, camera_from_world_end=end, shutter=shutter
            )
        )
    return moving


def _find_time_neighbours(views: Sequence[View]) -> list[tuple[int, int, float]]:
    """Finds each view's neighbours before and after it, and the time between them in frames.

    The first and the last are neighbours of themselves. Frames are in the order of the numbers in
    their names.
    """
    times = order_frames([view.name for view in views])
    order = np.argsort(times, kind="stable")
    place = np.argsort(order)
    sides = [order[np.clip(place + side, 0, len(views) - 1)].tolist() for side in (-1, 1)]
    return [(a, b, float(times[b] - times[a])) for a, b in zip(*sides, strict=True)]


def order_frames(names: Sequence[str]) -> np.ndarray:
    """Returns the last number (N,) of each name, or its place in the list if these repeat."""
    found = [split_last_number(name)[1] for name in names]
    numbers = [float(number) for number in found if number]
    if len(set(numbers)) == len(names):
        return np.array(numbers)
    return np.arange(len(names), dtype=np.float64)


def _shift_along_path(
    view: View, before: View, after: View, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the poses `share` of the way from `before` to `after` before and after the view's."""
    turn = after.camera_from_world[:3, :3] @ before.camera_from_world[:3, :3].T
    whole = np.eye(4)
    whole[:3, :3] = turn
    part = np.array(interpolate_pose(np.eye(4), whole, min(share, 1.0)))[:3, :3]
    step = share * (after.camera_center - before.camera_center)
    poses = []
    for rotation, shift in ((part.T, -step), (part, step)):
        world_from_camera = invert_pose(view.camera_from_world)
        world_from_camera[:3, :3] = world_from_camera[:3, :3] @ rotation.T
        world_from_camera[:3, 3] += shift
        poses.append(invert_pose(world_from_camera))
    return poses[0], poses[1]


def split_last_number(name: str) -> tuple[str, str, str]:
    """Splits a name into what stands before its last whole number, the number, and the rest.

    Without a number all of it is the rest.
    """
    backward = _FROM_END.match(name[::-1])  # forward, each digit would be a start to try
    rest, number = backward.groups() if backward else ("", "")
    end = len(name) - len(rest)
    return name[: end - len(number)], number[::-1], name[end:]
