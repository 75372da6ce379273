"""Brings a recording's pictures, lenses and poses together: by time, name or order."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError, OnError, list_some
from gsut.data.images import MaskLookup, normalize_name
from gsut.data.listing import Frame, Listing
from gsut.data.poses import (
    NANOSECONDS,
    UNITS,
    Trajectory,
    format_range,
    format_seconds,
    guess_unit,
    interpolate_between,
    invert_pose,
    read_trajectory,
    to_nanoseconds,
)
from gsut.data.recordings.recording import Recording, Stream
from gsut.data.rigs import OWN, Mount, find_body_from_camera


def pair_recording(recording: Recording, on_error: OnError) -> Listing:
    """Brings pictures, lenses and poses together.

    Poses whose labels are all numbers are found by time: the two around a picture are interpolated
    (centre along the line, rotation along the shorter arc) where the nearer one is within the
    tolerance. Others are found by the picture's name; poses alone (KITTI) by their order.

    Raises:
        DatasetError: pictures, lens or poses are missing, or none belong together.
    """
    streams = _choose_streams(recording)
    if recording.mounts is None:
        raise DatasetError(
            recording.path,
            "there is no lens file",
            "put one beside the pictures (lens.yaml, camchain.yaml, ...); `gsut calibrate` makes "
            "one, `gsut scene` finds lens and poses of photographs",
        )
    if recording.poses is None:
        raise DatasetError(
            recording.path,
            f"{sum(len(s.images) for s in streams)} pictures and a lens, but no poses",
            "put a trajectory beside them (poses.txt, lines 'time tx ty tz qx qy qz qw'), or let "
            "`gsut poses` find them",
        )
    mounts = recording.mounts([stream.name for stream in recording.streams])
    trajectory = read_trajectory(recording.poses, on_error)
    if recording.body_from_poses is not None:
        moved = trajectory.poses @ invert_pose(recording.body_from_poses)
        trajectory = dataclasses.replace(trajectory, poses=moved)
    listing = Listing(recording.path, trajectory.source, notes=list(recording.notes))
    named: set[int] = set()
    poses_of = recording.poses_of
    labels = None if trajectory.is_timed else trajectory.labels
    is_named = labels is not None
    if poses_of is None and is_named and all(m.from_body is None for m in mounts.values()):
        poses_of = OWN  # a pose of a picture is that of the camera that took it
    elif poses_of is None and is_named:
        listing.notes.append(
            f"{trajectory.source}: the poses are taken to be the body's, on which T_cam_imu, "
            "T_imu_cam or T_BS of the lens file places the cameras; if they are the cameras' own "
            "write `poses_of: camera` into dataset.yaml"
        )
    if is_named and poses_of == OWN:
        _require_own_names(streams, trajectory, recording)
    for stream in streams if len(trajectory) else ():
        place = find_body_from_camera(stream.name, mounts, poses_of)
        if trajectory.is_timed:
            poses, times = _pair_by_time(stream, mounts[stream.name], trajectory, recording)
        elif trajectory.labels is None:
            poses, times = _pair_by_order(stream, trajectory, recording)
        else:
            poses, times = _pair_by_name(stream, trajectory, recording, named)
        _add_frames(listing, stream, mounts[stream.name], place, poses, times, recording)
    if labels is not None:
        rows = [label for i, label in enumerate(labels) if i not in named]
        listing.missing += rows
    if recording.points is not None:
        try:
            listing.take_points(recording.points)
        except InputError as error:
            on_error(error)
    return listing


def _choose_streams(recording: Recording) -> list[Stream]:
    names = [stream.name for stream in recording.streams]
    unknown = [name for name in recording.cameras if name not in names]
    if unknown:
        raise DatasetError(
            recording.path,
            f"there is no camera {unknown[0]}, only {', '.join(names)}",
            "name one of them",
        )
    streams = [s for s in recording.streams if not recording.cameras or s.name in recording.cameras]
    if not any(stream.images for stream in streams):
        raise DatasetError(
            recording.path, "there are no images", "put PNG or JPEG files into 'images'"
        )
    return streams


def _add_frames(
    listing: Listing,
    stream: Stream,
    mount: Mount,
    body_from_this: np.ndarray,
    poses: list[np.ndarray | None],
    times: list[int | None],
    recording: Recording,
) -> None:
    root = recording.names_from or recording.path
    without, masks = [], MaskLookup(recording.masks)
    for path, pose, time in zip(stream.images, poses, times, strict=True):
        name = path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name
        if pose is None:
            without.append(name)
            continue
        listing.frames.append(
            Frame(
                name, path, mount.camera, pose @ body_from_this,
                mask_path=masks.find(name) or stream.mask,
                depth_path=stream.depths.get(path), depth_form=stream.depth_form, time_ns=time,
            )
        )  # fmt: skip
    if without:
        listing.notes.append(
            f"{listing.source}: {len(without)} of {len(stream.images)} images have no pose"
            f"{_format_tolerance(recording, times)} and are left out: {list_some(without)}"
        )


def _format_tolerance(recording: Recording, times: Sequence[int | None]) -> str:
    timed = any(time is not None for time in times)
    return f" within {recording.time_tolerance:g} s" if timed else ""


def _pair_by_name(
    stream: Stream, trajectory: Trajectory, recording: Recording, named: set[int]
) -> tuple[list[np.ndarray | None], list[int | None]]:
    """Pairs poses by the paths, file names or stems of pictures; `named` collects those in use."""
    found = _index_names(stream.images, recording)
    poses: dict[Path, np.ndarray] = {}
    alike = {normalize_name(name): images for name, images in found.items()}
    for row, label in enumerate(trajectory.labels or ()):
        images = found.get(label) or alike.get(normalize_name(label))
        if images:
            named.add(row)
            poses.setdefault(images[0], trajectory.poses[row])
    return [poses.get(image) for image in stream.images], [None] * len(stream.images)


def _index_names(images: Sequence[Path], recording: Recording) -> dict[str, list[Path]]:
    """Finds the pictures of each name that a trajectory may use for them.

    That is a path from either root, else a file name, else a stem: a picture's path is not taken
    for another's file name.
    """
    found: dict[str, list[Path]] = {}
    for root in (recording.names_from or recording.path, recording.path):
        paths = [image for image in images if image.is_relative_to(root)]
        found = _group(paths, [p.relative_to(root).as_posix() for p in paths]) | found
    return (
        _group(images, [p.stem for p in images]) | _group(images, [p.name for p in images]) | found
    )


def _group(images: Sequence[Path], names: Sequence[str]) -> dict[str, list[Path]]:
    """Groups pictures by their names, one each."""
    groups: dict[str, list[Path]] = {}
    for image, name in zip(images, names, strict=True):
        groups.setdefault(name, []).append(image)
    return groups


def _require_own_names(
    streams: Sequence[Stream], trajectory: Trajectory, recording: Recording
) -> None:
    """Requires that no name of a pose fits several pictures.

    Raises:
        DatasetError: one does: which of them has the pose is open.
    """
    found = _index_names([image for stream in streams for image in stream.images], recording)
    root = recording.names_from or recording.path
    for label in trajectory.labels or ():
        images = found.get(label, [])
        if len(images) > 1:
            names = [os.path.relpath(image, root) for image in images]
            raise DatasetError(
                trajectory.source, f"'{label}' fits {len(images)} pictures: {list_some(names)}",
                "begin each line with the picture's folder and name",
            )  # fmt: skip


def _pair_by_order(
    stream: Stream, trajectory: Trajectory, recording: Recording
) -> tuple[list[np.ndarray | None], list[int | None]]:
    if len(stream.images) != len(trajectory):
        raise DatasetError(
            trajectory.source,
            f"it holds {len(trajectory)} poses without times, and there are {len(stream.images)} "
            f"pictures of camera {stream.name or stream.images[0].parent}",
            "these belong together by their order: give one pose for each picture, or poses with "
            "times or names",
        )
    texts = stream.list_times()
    times: list[int | None] = [None] * len(texts)
    if stream.times is not None and all(texts):
        unit = recording.image_times or guess_unit(texts)
        times = [int(t) for t in to_nanoseconds(texts, unit)]
    return list(trajectory.poses), times


def _pair_by_time(
    stream: Stream, mount: Mount, trajectory: Trajectory, recording: Recording
) -> tuple[list[np.ndarray | None], list[int | None]]:
    texts = stream.list_times()
    rows = [i for i, text in enumerate(texts) if text]
    poses: list[np.ndarray | None] = [None] * len(texts)
    times: list[int | None] = [None] * len(texts)
    if not rows:
        raise DatasetError(
            trajectory.source,
            f"its poses have times, and the names of the pictures ({stream.images[0].name} ...) "
            "are none",
            "name each picture by its time, or begin each line with the picture's name",
        )
    unit = recording.image_times or guess_unit(texts[i] for i in rows)
    image_ns = to_nanoseconds([texts[i] for i in rows], unit)
    for row, stamp in zip(rows, image_ns, strict=True):
        times[row] = int(stamp)
    labels = trajectory.labels or ()
    pose_unit = recording.pose_times or guess_unit(labels)
    pose_ns = to_nanoseconds(labels, pose_unit)
    order = np.argsort(pose_ns, kind="stable")
    shift = round(recording.time_offset * NANOSECONDS) + mount.clock_shift
    clock = _Clock(pose_ns[order], image_ns + shift, recording.time_tolerance)
    if not clock.near.any():
        ranges = (
            f"pictures of {stream.name or stream.images[0].parent} are from "
            f"{format_range((texts[i] for i in rows), unit)}, its poses from "
            f"{format_range(labels, pose_unit)}"
        )
        raise _explain_no_pose(stream, trajectory, recording, clock, ranges)
    for k, row in enumerate(rows):
        if clock.near[k]:
            low, high, share = clock.find_around(k)
            poses[row] = interpolate_between(
                trajectory.poses[order[low]], trajectory.poses[order[high]], share
            )
    return poses, times


@dataclasses.dataclass
class _Clock:
    """Sorted times of poses beside those of pictures, in nanoseconds."""

    poses: np.ndarray
    images: np.ndarray
    tolerance: float

    def __post_init__(self) -> None:
        last = len(self.poses) - 1
        self.high = np.searchsorted(self.poses, self.images, side="left")
        before = np.abs(self.images - self.poses[np.clip(self.high - 1, 0, last)])
        after = np.abs(self.poses[np.clip(self.high, 0, last)] - self.images)
        self.distance = np.minimum(before, after)
        self.near = self.distance <= round(self.tolerance * NANOSECONDS)

    def find_around(self, k: int) -> tuple[int, int, float]:
        """Returns the poses around picture k, the same at the ends, and the share."""
        high = int(self.high[k])
        if high == len(self.poses):
            return high - 1, high - 1, 0.0
        if high == 0 or self.poses[high] == self.images[k]:
            return high, high, 0.0
        step = int(self.poses[high]) - int(self.poses[high - 1])
        return high - 1, high, (int(self.images[k]) - int(self.poses[high - 1])) / step


def _explain_no_pose(
    stream: Stream, trajectory: Trajectory, recording: Recording, clock: _Clock, ranges: str
) -> DatasetError:
    """Explains why no picture has a pose: other units or clocks, or too small a tolerance."""
    images, poses = clock.images, clock.poses
    overlap = images.max() >= poses[0] and poses[-1] >= images.min()
    if overlap:
        nearest = float(np.median(clock.distance)) / NANOSECONDS
        return DatasetError(
            trajectory.source,
            f"no picture has a pose within {recording.time_tolerance:g} s: {ranges}, and the "
            f"nearest pose is {nearest:.3g} s away (median)",
            f"if that is right write `time_tolerance: {1.5 * nearest:.2g}` into dataset.yaml",
        )
    if _are_counted(stream):
        return DatasetError(
            trajectory.source,
            f"no picture has a pose: {ranges}; the pictures' names count them and are no times",
            "begin each line with the picture's name; or list lines 'time rgb/FILE' in rgb.txt, "
            "as TUM does",
        )
    fitting = _try_other_units(stream, trajectory, clock)
    if fitting is not None:
        return DatasetError(
            trajectory.source,
            f"no picture has a pose: {ranges}; they overlap if {fitting[0]}",
            f"if that is right write `{fitting[1]}` into dataset.yaml",
        )
    return DatasetError(
        trajectory.source,
        f"no picture has a pose, as their times do not overlap: {ranges}",
        "take the poses of this recording; or, where both clocks began at once, write "
        f"`time_offset: {format_seconds(int(poses[0]) - int(images.min()))}` into dataset.yaml",
    )


def _are_counted(stream: Stream) -> bool:
    """Returns whether the names of pictures count them: 000, 001, 002 ..."""
    stems = [path.stem for path in stream.images]
    if stream.times is not None or len(stems) < 2 or not all(s.isdecimal() for s in stems):
        return False
    return bool((np.diff([int(stem) for stem in stems]) == 1).all())


def _try_other_units(
    stream: Stream, trajectory: Trajectory, clock: _Clock
) -> tuple[str, str] | None:
    texts = [text for text in stream.list_times() if text]
    for key, mine, others in (
        ("image_times", texts, clock.poses),
        ("pose_times", list(trajectory.labels or ()), clock.images),
    ):
        for unit in UNITS:
            times = to_nanoseconds(mine, unit)
            if times.max() >= others.min() and others.max() >= times.min() and np.ptp(times) > 0:
                words = "pictures" if key == "image_times" else "poses"
                return f"the times of {words} are in {unit}", f"{key}: {unit}"
    return None
