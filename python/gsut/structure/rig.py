"""Poses of a rig's images: first one by one, then one pose a moment, in the rig's unit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.data.poses import inverse
from gsut.structure.align import centers_of, rotation_angles
from gsut.structure.features import Features
from gsut.structure.inputs import Photographs
from gsut.structure.matching import PairMatches
from gsut.structure.options import PosesOptions
from gsut.structure.rig_file import Rig, relative_changes
from gsut.structure.solution import OnRig, Solution, refine, solve

# Two cameras of one moment that are turned to each other this much otherwise than the rig says:
# one of them was placed wrongly.
_SAME_DEGREES = 5.0
# Median over all moments beyond which it is the rig that is wrong.
_WRONG_DEGREES = 15.0
# Growth of the median residual, with one pose a moment, that is worth a word: as in `gsut
# calibrate`, whose boards show that images were not taken together.
_SHAKY = 1.5
_FEWEST_PX = 0.2  # residuals below this need no word: no photograph's features are that exact


# Of poses.json, in place of the words for single images.
COVARIANCE_OF = (
    "centre in the world, turn in the camera frame (radians); the rig's pose at one moment is "
    "held, with one component of another's centre where the rig was refined; the cameras' poses on "
    "it count as known"
)


@dataclasses.dataclass(frozen=True)
class RigStart:
    """The rig as images placed one by one show it.

    Args:
        camera_from_world: (N, 4, 4) of all images in the rig's unit, by their moment's pose;
            identity where no image of the moment was placed.
        known: (N,) bool, whether there is such a pose.
        scale: the rig's unit over that of the poses given.
        scale_spread: median distance of the scales of single moments from it, relative.
        moments: number of moments that the scale comes from.
        turn_degrees: median angle between two cameras' turn to each other and the rig's.
    """

    camera_from_world: np.ndarray
    known: np.ndarray
    scale: float
    scale_spread: float
    moments: int
    turn_degrees: float


@dataclasses.dataclass(frozen=True)
class RigFit:
    """What became of the rig.

    Args:
        rig: with its poses as they are now.
        figures: of poses.json, under "rig".
        notes: what a user should know, one sentence each.
    """

    rig: Rig
    figures: dict[str, Any]
    notes: list[str]


def refuse_beside_rig(options: PosesOptions, others: Mapping[str, object]) -> None:
    """Refuses what contradicts a rig.

    Args:
        options: see PosesOptions.
        others: values of further flags by name; None or False: not given.

    Raises:
        InputError: names the flag to leave out.
    """
    for flag, value in others.items():
        if value is not None and value is not False:
            raise InputError(f"--{flag} contradicts --rig, whose file names the lenses; drop one")
    if options.shutter == "rolling" or options.readout_time is not None:
        raise InputError(
            "--rig takes its cameras for still while an image is read; leave --shutter rolling and "
            "--readout-time out"
        )


def solve_rig(
    photographs: Photographs,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    *,
    rig: Rig,
    adjust: bool = False,
) -> tuple[Solution, RigFit]:
    """Poses and points in the rig's unit, one pose of the rig a moment.

    First each image by itself, through its own lens; then the rig's pose at each moment from the
    images placed, the scale from its baselines, and all images' poses from the rig's; then bundle
    adjustment over all sights with one pose a moment. Moments without a placed image are placed by
    the points found.

    Args:
        photographs: see `find_rig_photographs`.
        features, pairs, options, on_progress: as for `solution.solve`.
        rig: see `read_rig`.
        adjust: the cameras' poses on the rig are adjusted too; its size is kept.

    Raises:
        SolveError: nothing could be reconstructed; no moment has two placed images, so nothing
            sets the scale; or images contradict the rig.
    """
    assert photographs.moments is not None and photographs.rig_cameras is not None
    cameras = [c for c in photographs.cameras if c is not None]
    # With tracks extended as in the end: in pieces they fit any poses, and residuals say little.
    alone = solve(photographs.names, cameras, features, pairs, options, on_progress)
    start = place_rig(
        alone.camera_from_world, alone.registered, photographs.moments, photographs.rig_cameras,
        rig, np.bincount(alone.sights[:, 1], minlength=len(photographs)),
    )  # fmt: skip
    first = rig.camera_from_reference[0]
    camera_from_body = rig.camera_from_reference[1:] @ inverse(first)
    solution = refine(
        photographs.names, cameras, features, pairs, list(start.camera_from_world), options,
        on_progress,
        on_rig=OnRig(
            photographs.moments, photographs.rig_cameras - 1, camera_from_body, start.known, adjust
        ),
    )  # fmt: skip
    solution = dataclasses.replace(
        solution, initial_pair=alone.initial_pair, restarts=alone.restarts
    )
    mounts = solution.camera_from_body
    assert mounts is not None
    found = np.concatenate([first[None], mounts @ first]) if adjust else rig.camera_from_reference
    return solution, _fit(photographs, rig, found, start, alone, solution, adjust)


def place_rig(
    camera_from_world: np.ndarray,
    registered: np.ndarray,
    moments: np.ndarray,
    rig_cameras: np.ndarray,
    rig: Rig,
    sights: np.ndarray,
) -> RigStart:
    """The rig's pose at each moment, and the scale, from images placed one by one.

    Args:
        camera_from_world: (N, 4, 4), in any unit.
        registered: (N,) bool, which of them are known.
        moments, rig_cameras: (N,) of each image.
        rig: its cameras' poses.
        sights: (N,) how many points each image sees: of two that disagree the one with more counts.

    Raises:
        SolveError: no moment has two placed images of cameras that are apart, or they contradict
            the rig.
    """
    camera_from_reference = rig.camera_from_reference
    seats = centers_of(camera_from_reference)
    centers = centers_of(camera_from_world)
    # world -> reference, by each image alone.
    turns = (
        camera_from_reference[rig_cameras, :3, :3].transpose(0, 2, 1)
        @ (camera_from_world[:, :3, :3])
    )
    groups = [
        np.flatnonzero(registered & (moments == m)) for m in range(int(moments.max(initial=-1)) + 1)
    ]
    scales, weights, angles = [], [], []
    for moment in groups:
        for place, i in enumerate(moment):
            for j in moment[place + 1 :]:
                angles.append(_angle_degrees(turns[i], turns[j]))
                best = i if sights[i] >= sights[j] else j
                apart = turns[best].T @ (seats[rig_cameras[j]] - seats[rig_cameras[i]])
                squared = float(apart @ apart)
                if angles[-1] > _SAME_DEGREES or squared <= 0.0:
                    continue
                scales.append(float(apart @ (centers[j] - centers[i])) / squared)
                weights.append(squared)
    turn = float(np.median(angles)) if angles else 0.0
    if turn > _WRONG_DEGREES:
        raise SolveError(
            f"in the images the cameras are turned to each other by {turn:.0f} degrees (median) "
            f"otherwise than {rig.source} says: is camera_from_reference the right way round, and "
            "does each folder hold its own camera's images?"
        )
    if not scales:
        raise SolveError(
            f"no moment has two images with poses, so the baseline of {rig.source} sets no scale: "
            f"{int(registered.sum())} of {len(registered)} images were placed by themselves, in "
            f"{sum(len(m) > 0 for m in groups)} of {len(groups)} moments; the cameras must see "
            "parts of one scene, at the same moment or later"
        )
    per_unit = _weighted_median(np.array(scales), np.array(weights))
    if per_unit <= 0.0:
        raise SolveError(
            f"the images show the cameras on the other side of each other than {rig.source} says: "
            f"are the folders {rig.names[0]} and {rig.names[1]} swapped?"
        )
    poses = np.tile(np.eye(4), (len(moments), 1, 1))
    known = np.zeros(len(moments), bool)
    for number, placed in enumerate(groups):
        if not len(placed):
            continue
        reference = _reference_pose(
            turns[placed], centers[placed] / per_unit, seats[rig_cameras[placed]], sights[placed]
        )
        own = moments == number
        poses[own] = camera_from_reference[rig_cameras[own]] @ reference
        known |= own
    spread = np.median(np.abs(np.array(scales) / per_unit - 1.0))
    counted = sum(len(m) > 1 for m in groups)
    return RigStart(poses, known, 1.0 / per_unit, float(spread), counted, turn)


def _reference_pose(
    turns: np.ndarray, centers: np.ndarray, seats: np.ndarray, sights: np.ndarray
) -> np.ndarray:
    """(4, 4) reference_from_world of a moment: the mean of its images that agree with the best.

    Args:
        turns: (M, 3, 3) reference_from_world by each. centers: (M, 3) of the cameras in the world.
        seats: (M, 3) of the cameras in the reference frame. sights: (M,) of each.
    """
    best = int(np.argmax(sights))
    good = np.array([_angle_degrees(turns[best], turn) <= _SAME_DEGREES for turn in turns])
    left, _, right = np.linalg.svd(turns[good].sum(axis=0))
    pose = np.eye(4)
    pose[:3, :3] = left @ right  # near a rotation: its determinant is 1
    pose[:3, 3] = (seats[good] - centers[good] @ pose[:3, :3].T).mean(axis=0)
    return pose


def _angle_degrees(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.degrees(rotation_angles((first @ second.T)[None])[0]))


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _same_sights(alone: Solution, solution: Solution) -> tuple[float, float]:
    """Median residuals in pixels of the sights that both have."""
    keys = [
        each.sights[:, 1].astype(np.int64) << 32 | each.sights[:, 2] for each in (alone, solution)
    ]
    _, first, second = np.intersect1d(*keys, return_indices=True)
    if not len(first):
        return alone.median, solution.median
    lengths = [
        np.linalg.norm(each.residuals[rows], axis=1)
        for each, rows in ((alone, first), (solution, second))
    ]
    return float(np.nanmedian(lengths[0])), float(np.nanmedian(lengths[1]))


def _fit(
    photographs: Photographs,
    rig: Rig,
    found: np.ndarray,
    start: RigStart,
    alone: Solution,
    solution: Solution,
    adjust: bool,
) -> RigFit:
    moments, cameras = photographs.moments, photographs.rig_cameras
    assert moments is not None and cameras is not None
    table: list[list[str | None]] = [
        [None] * len(rig) for _ in range(int(moments.max(initial=-1)) + 1)
    ]
    for name, moment, camera in zip(photographs.names, moments, cameras, strict=True):
        table[moment][camera] = name
    brought = [
        name
        for name, before, after in zip(
            photographs.names, alone.registered, solution.registered, strict=True
        )
        if after and not before
    ]
    before_px, after_px = _same_sights(alone, solution)
    incomplete = sum(None in row for row in table)
    how = "by name" if photographs.paired_by == "name" else "in order, as names differ"
    notes = [
        f"{len(photographs)} images of {len(rig)} cameras in {len(table)} moments, paired {how}"
        + (f"; {incomplete} moments lack an image" if incomplete else "")
    ]
    if after_px > max(_SHAKY * before_px, _FEWEST_PX):
        notes.append(
            f"with one pose of the rig a moment the residuals are {after_px:.2f} px "
            f"(median), each image by itself has {before_px:.2f}: the images of one moment were "
            "not taken together, or the rig is not as "
            + (f"{rig.source} says; try --refine-rig" if not adjust else "rigid as assumed")
        )
    now = dataclasses.replace(rig, camera_from_reference=found)
    changes = relative_changes(rig, found)
    registered = solution.registered
    figures: dict[str, Any] = {
        "file": str(rig.source),
        "refined": adjust,
        "unit": "that of the rig's file, which all poses and points are in",
        "paired_by": photographs.paired_by,
        "moments_total": len(table),
        "moments_registered": len(np.unique(moments[registered])),
        "placed_by_their_moment": brought,
        "scale_from_moments": start.moments,
        "scale_spread_percent": 100.0 * start.scale_spread,
        "turn_before_degrees": start.turn_degrees,
        "baseline": rig.baseline,
        "residual_alone_px": before_px,
        "residual_px": after_px,
        "cameras": [
            {
                "name": name,
                "camera_from_reference": pose.tolist(),
                "given": before.tolist(),
                "turned_degrees": float(np.degrees(turn)),
                "shifted": shift,
                "registered": int(registered[cameras == number].sum()),
                "images": int((cameras == number).sum()),
            }
            for number, (name, pose, before, (turn, shift)) in enumerate(
                zip(rig.names, found, rig.camera_from_reference, changes, strict=True)
            )
        ],
        "moments": table,
    }
    return RigFit(now, figures, notes)
