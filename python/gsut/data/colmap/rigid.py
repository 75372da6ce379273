"""Finds from a model's images how the cameras of each rig sit on it, and what COLMAP can hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut.data.colmap.records import ColmapImage, RigPlace
from gsut.data.colmap.rigs import FrameRow, RigRow
from gsut.gaussians import quaternion_from_rotation

# Largest difference of a picture's pose from its rig's, in turns and in parts of the distances.
_RIGID = 1e-6


def _group_frames(images: Sequence[ColmapImage]) -> dict[int, dict[int, ColmapImage]]:
    """Groups one rig's images by instant and camera."""
    frames: dict[int, dict[int, ColmapImage]] = {}
    for image in images:
        assert image.rig is not None
        frames.setdefault(image.rig.instant, {})[image.rig.camera] = image
    return frames


def _find_mounts(frames: Sequence[dict[int, ColmapImage]]) -> dict[int, np.ndarray]:
    """Finds camera_from_rig of each camera that shares frames with the first, the origin."""
    mounts = {min(min(frame) for frame in frames): np.eye(4)}
    while True:
        before = len(mounts)
        for frame in frames:
            known = next((camera for camera in frame if camera in mounts), None)
            if known is None:
                continue
            rig_from_world = np.linalg.inv(mounts[known]) @ frame[known].camera_from_world
            for camera, image in frame.items():
                if camera not in mounts:
                    mounts[camera] = image.camera_from_world @ np.linalg.inv(rig_from_world)
        if len(mounts) == before:
            return dict(sorted(mounts.items()))


def _is_rigid(images: Sequence[ColmapImage]) -> bool:
    """Returns whether COLMAP can hold a rig: a lens for each camera, one pose for each frame."""
    frames = _group_frames(images)
    places = [image.rig.camera for image in images if image.rig is not None]
    lenses = {(place, image.camera) for place, image in zip(places, images, strict=True)}
    mounts = _find_mounts(list(frames.values()))
    if len(lenses) > len(set(places)) or set(mounts) != set(places):
        return False
    if sum(map(len, frames.values())) < len(images):  # two pictures of one camera at one instant
        return False
    for frame in frames.values():
        first = next(iter(frame))
        rig_from_world = np.linalg.inv(mounts[first]) @ frame[first].camera_from_world
        for camera, image in frame.items():
            pose = image.camera_from_world
            off = np.abs(mounts[camera] @ rig_from_world - pose)
            length = max(1.0, float(np.abs(pose[:3, 3]).max()))
            if off[:3, :3].max() > _RIGID or off[:3, 3].max() > _RIGID * length:
                return False
    return True


def hold_rigs(images: Sequence[ColmapImage]) -> tuple[list[ColmapImage], list[str]]:
    """Takes images off the rigs that COLMAP cannot hold; returns them all, and a note on each rig.

    A rig of which pictures of one camera are left needs no note.
    """
    by_rig: dict[int, list[ColmapImage]] = {}
    for image in images:
        if image.rig is not None:
            by_rig.setdefault(image.rig.rig, []).append(image)
    alone = {
        rig for rig, own in by_rig.items() if len({i.rig.camera for i in own if i.rig}) < 2
    }  # fmt: skip
    loose = {rig for rig, own in by_rig.items() if rig not in alone and not _is_rigid(own)}
    notes = [
        f"rig {rig} is left out of the COLMAP model: its {len(by_rig[rig])} images do not have one "
        "pose of the rig at each instant and one lens for each camera; each image has its own pose"
        for rig in sorted(loose)
    ]
    held = [
        dataclasses.replace(image, rig=None)
        if image.rig is not None and image.rig.rig in alone | loose
        else image
        for image in images
    ]
    return held, notes


def list_rig_rows(
    images: Sequence[ColmapImage], numbers: Sequence[int]
) -> tuple[list[RigRow], list[FrameRow]]:
    """Lists rigs and frames; an image that is on no rig is a frame of a rig of its camera alone.

    Args:
        images: see `hold_rigs`.
        numbers: of their cameras in the model.
    """
    cameras = dict(zip((image.number for image in images), numbers, strict=True))
    rigs: list[RigRow] = []
    frames: list[FrameRow] = []
    groups: dict[tuple[bool, int], list[ColmapImage]] = {}
    for image, number in zip(images, numbers, strict=True):
        key = (True, number) if image.rig is None else (False, image.rig.rig)
        groups.setdefault(key, []).append(image)
    for rig, ((is_alone, _), own) in enumerate(sorted(groups.items(), key=lambda g: g[0]), 1):
        if is_alone:
            own = [dataclasses.replace(image, rig=RigPlace(rig, 0, image.number)) for image in own]
        by_instant = _group_frames(own)
        mounts = _find_mounts(list(by_instant.values()))
        number_of = {i.rig.camera: cameras[i.number] for i in own if i.rig is not None}
        rigs.append(RigRow(rig, {number_of[c]: pack_pose(m) for c, m in mounts.items()}))
        for _, frame in sorted(by_instant.items()):
            first = min(frame)
            rig_from_world = np.linalg.inv(mounts[first]) @ frame[first].camera_from_world
            seen = [(number_of[camera], frame[camera].number) for camera in sorted(frame)]
            frames.append(FrameRow(len(frames) + 1, rig, pack_pose(rig_from_world), seen))
    return rigs, frames


def pack_pose(pose: np.ndarray) -> list[float]:
    """Packs a rigid transform (4, 4) as quaternion w, x, y, z and translation."""
    return [*map(float, quaternion_from_rotation(pose[:3, :3])), *map(float, pose[:3, 3])]
