"""Estimates the rig's pose at each frame, and the scale, from images placed one by one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.data.rigs import Rig
from gsut.gaussians import (
    find_nearest_rotation,
    find_rotation_vectors,
    measure_rotation_angles,
)
from gsut.judge import SAME_DEGREES, SURE

FEWEST_FRAMES = 4  # that a mean turn is taken over


@dataclasses.dataclass(frozen=True)
class RigStart:
    """The poses of a rig, from images placed one by one.

    Args:
        camera_from_world: (N, 4, 4) of all images in the rig's unit, by their frame's pose;
            identity where no image of the frame was placed.
        known: (N,) bool, whether the frame has a pose.
        scale: the rig's unit over that of the poses given.
        scale_spread: median relative difference of single frames' scales from it.
        frames: number of frames that the scale comes from.
        turn_degrees: mean over the frames of the rotation between two cameras against the rig's, of
            the two that differ most from it.
        turn_sigma_degrees: standard error of that mean.
    """

    camera_from_world: np.ndarray
    known: np.ndarray
    scale: float
    scale_spread: float
    frames: int
    turn_degrees: float
    turn_sigma_degrees: float


def place_rig(
    camera_from_world: np.ndarray,
    registered: np.ndarray,
    frames: np.ndarray,
    rig_cameras: np.ndarray,
    rig: Rig,
    observations: np.ndarray,
) -> RigStart:
    """Estimates the rig's pose at each frame, and the scale, from images placed one by one.

    Args:
        camera_from_world: (N, 4, 4), in any unit.
        registered: (N,) bool, the poses that are known.
        frames, rig_cameras: (N,) of each image.
        rig: its cameras' poses.
        observations: (N,) of each image; of two images that disagree the one with more is right.

    Raises:
        SolveError: no frame has two placed images of cameras that are apart, or they contradict
            the rig.
    """
    camera_from_reference = rig.camera_from_reference
    seats = find_centers(camera_from_reference)
    centers = find_centers(camera_from_world)
    # world -> reference, by each image alone.
    turns = (
        camera_from_reference[rig_cameras, :3, :3].transpose(0, 2, 1)
        @ (camera_from_world[:, :3, :3])
    )
    groups = [
        np.flatnonzero(registered & (frames == m)) for m in range(int(frames.max(initial=-1)) + 1)
    ]
    scales, weights = [], []
    turned: dict[tuple[int, int], list[np.ndarray]] = {}
    for frame in groups:
        for place, i in enumerate(frame):
            for j in frame[place + 1 :]:
                of_two = (int(rig_cameras[i]), int(rig_cameras[j]))
                vector = find_rotation_vectors((turns[i] @ turns[j].T)[None])[0]
                turned.setdefault(of_two, []).append(np.degrees(vector))
                best = i if observations[i] >= observations[j] else j
                apart = turns[best].T @ (seats[rig_cameras[j]] - seats[rig_cameras[i]])
                squared = float(apart @ apart)
                if np.linalg.norm(turned[of_two][-1]) > SAME_DEGREES or squared <= 0.0:
                    continue
                scales.append(float(apart @ (centers[j] - centers[i])) / squared)
                weights.append(squared)
    angles = [np.linalg.norm(vector) for vectors in turned.values() for vector in vectors]
    if angles and np.median(angles) > SURE * SAME_DEGREES:
        raise SolveError(
            "in the images the rotation between two cameras differs by "
            f"{np.median(angles):.0f} degrees from that in {rig.source}: is "
            "camera_from_reference the right way round, and does each folder hold its own "
            "camera's images?"
        )
    if not scales:
        raise SolveError(
            f"no frame has two images with poses, so the baseline of {rig.source} sets no scale: "
            f"{int(registered.sum())} of {len(registered)} images were placed by themselves, in "
            f"{sum(len(m) > 0 for m in groups)} of {len(groups)} frames; the cameras must see "
            "parts of one scene, at the same frame or later"
        )
    per_unit = _find_weighted_median(np.array(scales), np.array(weights))
    if per_unit <= 0.0:
        raise SolveError(
            f"the images show the cameras on the other side of each other than {rig.source} says: "
            f"are the folders {rig.names[0]} and {rig.names[1]} swapped, or is a rolling shutter "
            "taken for global (leave --shutter global out, and state it in the rig's file)?"
        )
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    known = np.zeros(len(frames), bool)
    for number, placed in enumerate(groups):
        if not len(placed):
            continue
        reference = _average_poses(
            turns[placed],
            centers[placed] / per_unit,
            seats[rig_cameras[placed]],
            observations[placed],
        )
        own = frames == number
        poses[own] = camera_from_reference[rig_cameras[own]] @ reference
        known |= own
    spread = np.median(np.abs(np.array(scales) / per_unit - 1.0))
    counted = sum(len(m) > 1 for m in groups)
    return RigStart(poses, known, 1.0 / per_unit, float(spread), counted, *_average_turns(turned))


def _average_turns(turned: Mapping[tuple[int, int], list[np.ndarray]]) -> tuple[float, float]:
    """Returns the largest mean turn between two cameras and its standard error, in degrees.

    Args:
        turned: rotation vectors in degrees by pair of cameras.
    """
    largest = (0.0, 0.0)
    for vectors in turned.values():
        kept = np.array([v for v in vectors if np.linalg.norm(v) <= SAME_DEGREES]).reshape(-1, 3)
        if len(kept) < FEWEST_FRAMES:
            continue
        sigma = np.sqrt(kept.var(axis=0, ddof=1).sum() / len(kept))
        largest = max(largest, (float(np.linalg.norm(kept.mean(axis=0))), float(sigma)))
    return largest


def _average_poses(
    turns: np.ndarray, centers: np.ndarray, seats: np.ndarray, observations: np.ndarray
) -> np.ndarray:
    """Averages (4, 4) reference_from_world of a frame over its images that agree with the best.

    Args:
        turns: (M, 3, 3) reference_from_world by each image.
        centers: (M, 3) of the cameras in the world.
        seats: (M, 3) of the cameras in the reference frame.
        observations: (M,) of each image.
    """
    best = int(np.argmax(observations))
    angles = measure_rotation_angles(turns[best] @ turns.transpose(0, 2, 1))
    good = np.degrees(angles) <= SAME_DEGREES
    pose = np.eye(4)
    pose[:3, :3] = find_nearest_rotation(turns[good].sum(axis=0))
    pose[:3, 3] = (seats[good] - centers[good] @ pose[:3, :3].T).mean(axis=0)
    return pose


def _find_weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
