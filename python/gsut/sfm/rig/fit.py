"""Poses of a rig's images: first one by one, then one pose a frame, in the rig's unit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.poses import find_centers, invert_pose
from gsut.data.rigs import Rig, measure_changes
from gsut.lens import Camera
from gsut.sfm.core import (
    Features,
    OnRig,
    PairMatches,
    Photographs,
    PosesOptions,
    Solution,
    refine,
    solve,
)
from gsut.sfm.rig.start import RigStart, place_rig

# Growth of the median residual, with one pose a frame, that is worth a word: as in `gsut
# calibrate`, whose boards show that images were not taken together.
_SHAKY = 1.5
# A mean turn against the rig's that is worth a word: so large, and so many standard errors.
_TURNED_DEGREES = 0.1
_TURNED_SIGMAS = 5.0
_FEWEST_PX = 0.2  # residuals below this need no word: no photograph's features are that exact
# Of poses.json, in place of the words for single images.
COVARIANCE_OF = (
    "centre in the world, turn in the camera frame (radians); the rig's pose at one frame is "
    "held, with one component of another's centre where the rig was refined; the cameras' poses on "
    "it count as known"
)


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
    on_rig_progress: Callable[[int, int, int, str], None],
    *,
    rig: Rig,
    adjust: bool = False,
) -> tuple[Solution, RigFit]:
    """Poses and points in the rig's unit, one pose of the rig a frame.

    First each image by itself, through its own lens; then the rig's pose at each frame from the
    images placed, the scale from its baselines, and all images' poses from the rig's; then bundle
    adjustment of all observations with one pose a frame. Frames without a placed image are placed
    by the points found.

    Args:
        photographs: see `find_rig_photographs`.
        features, pairs, options: as for `solution.solve`; images without any feature get no pose.
        on_progress: told (registered, images, points, step) while images are placed one by one.
        on_rig_progress: the same, with one pose a frame.
        rig: see `read_rig`.
        adjust: the cameras' poses on the rig are adjusted too; its size is kept.

    Raises:
        SolveError: nothing could be reconstructed; no frame has two placed images, so nothing
            sets the scale; or images contradict the rig.
    """
    cameras = photographs.lenses
    # With tracks extended as in the end: in pieces they fit any poses, and residuals say little.
    alone = solve(photographs.names, cameras, features, pairs, options, on_progress)
    return put_on_rig(
        alone, photographs, cameras, features, pairs, options, on_rig_progress, rig, adjust
    )


def put_on_rig(
    alone: Solution,
    photographs: Photographs,
    cameras: Sequence[Camera],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    rig: Rig,
    adjust: bool,
    lens_free: np.ndarray | None = None,
) -> tuple[Solution, RigFit]:
    """One pose of the rig a frame, from images placed one by one.

    Args:
        alone: their poses.
        cameras: the lens of each image.
        lens_free: which parameters of the lenses are estimated too, see `solve`.
        others: see `solve_rig`.

    Raises:
        SolveError: see `solve_rig`.
    """
    assert photographs.frames is not None and photographs.rig_cameras is not None
    start = place_rig(
        alone.camera_from_world, alone.registered, photographs.frames, photographs.rig_cameras,
        rig, np.bincount(alone.observations[:, 1], minlength=len(photographs)),
    )  # fmt: skip
    first = rig.camera_from_reference[0]
    camera_from_body = rig.camera_from_reference[1:] @ invert_pose(first)
    solution = refine(
        photographs.names, cameras, features, pairs, list(start.camera_from_world), options,
        on_progress, lens_free=lens_free,
        on_rig=OnRig(
            photographs.frames, photographs.rig_cameras - 1, camera_from_body, start.known, adjust
        ),
    )  # fmt: skip
    # An image that could not be read has no features: its frame's pose must not register it.
    readable = np.array([len(f) > 0 for f in features])
    solution = dataclasses.replace(
        solution, initial_pair=alone.initial_pair, restarts=alone.restarts,
        registered=solution.registered & readable,
    )  # fmt: skip
    mounts = solution.camera_from_body
    assert mounts is not None
    now = rig
    if adjust:
        found = np.concatenate([first[None], mounts @ first])
        now = dataclasses.replace(rig, camera_from_reference=found)
    figures = _figures(photographs, rig, now, start, alone, solution, adjust)
    return solution, RigFit(now, figures, _notes(rig, figures))


def _median_residuals(alone: Solution, solution: Solution) -> tuple[float, float]:
    """In pixels, each over the observations that both have."""
    keys = [
        each.observations[:, 1].astype(np.int64) << 32 | each.observations[:, 2]
        for each in (alone, solution)
    ]
    _, first, second = np.intersect1d(*keys, return_indices=True)
    if not len(first):
        return alone.median, solution.median
    lengths = [
        np.linalg.norm(each.residuals[rows], axis=1)
        for each, rows in ((alone, first), (solution, second))
    ]
    return float(np.nanmedian(lengths[0])), float(np.nanmedian(lengths[1]))


def _scale_sigma(solution: Solution) -> float | None:
    """Relative standard error of lengths, the rig's own taken for exact; None: not known.

    That of the distance of each image from the frame whose pose is held: the smallest, of those
    far away, has least of the image's own.
    """
    centers = find_centers(solution.camera_from_world)
    spread = solution.covariances[:, :3, :3]
    held = solution.registered & ~solution.covariances.any(axis=(1, 2))
    if not held.any():
        return None
    away = centers - centers[np.argmax(held)]
    squared = (away**2).sum(axis=1)
    along = np.einsum("ni,nij,nj->n", away, spread, away)
    good = solution.registered & ~held & np.isfinite(along) & (along > 0.0)
    if not good.any():
        return None
    return float(np.sqrt(along[good] / squared[good] ** 2).min())


def _figures(
    photographs: Photographs,
    rig: Rig,
    now: Rig,
    start: RigStart,
    alone: Solution,
    solution: Solution,
    adjust: bool,
) -> dict[str, Any]:
    """Of poses.json: the rig as given, as it is now, and what the images say about it."""
    frames, cameras = photographs.frames, photographs.rig_cameras
    assert frames is not None and cameras is not None
    names, registered = np.array(photographs.names), solution.registered
    table: list[list[str | None]] = [
        [None] * len(rig) for _ in range(int(frames.max(initial=-1)) + 1)
    ]
    for name, frame, camera in zip(photographs.names, frames, cameras, strict=True):
        table[frame][camera] = name
    before_px, after_px = _median_residuals(alone, solution)
    # Where the rig is refined a pose holds the scale meanwhile, and covariances lack it.
    scale_sigma = None if adjust else _scale_sigma(solution)
    changes = measure_changes(rig, now.camera_from_reference)
    return {
        "file": str(rig.source),
        "refined": adjust,
        "unit": "that of the rig's file, which all poses and points are in",
        "paired_by": photographs.paired_by,
        "frames_total": len(table),
        "frames_registered": len(np.unique(frames[registered])),
        "placed_by_their_frame": names[registered & ~alone.registered].tolist(),
        "scale_from_frames": start.frames,
        "scale_spread_percent": 100.0 * start.scale_spread,
        "turn_against_file_degrees": start.turn_degrees,
        "turn_against_file_sigma_degrees": start.turn_sigma_degrees,
        "scale_sigma_percent": None if scale_sigma is None else 100.0 * scale_sigma,
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
                zip(rig.names, now.camera_from_reference, rig.camera_from_reference, changes,
                    strict=True)
            )
        ],
        "frames": table,
    }  # fmt: skip


def _notes(rig: Rig, figures: dict[str, Any]) -> list[str]:
    """What a user should know of the rig, one sentence each."""
    images = sum(camera["images"] for camera in figures["cameras"])
    how = "by name" if figures["paired_by"] == "name" else "in order, as names differ"
    incomplete = sum(None in row for row in figures["frames"])
    notes = [
        f"{images} images of {len(rig)} cameras in {figures['frames_total']} frames, paired {how}"
        + (f"; {incomplete} without the image of a camera" if incomplete else "")
    ]
    before_px, after_px = figures["residual_alone_px"], figures["residual_px"]
    if after_px > max(_SHAKY * before_px, _FEWEST_PX):
        notes.append(
            f"with one pose of the rig a frame the residuals are {after_px:.2f} px "
            f"(median), each image by itself has {before_px:.2f}: the images of one frame were "
            "not taken together, or the rig is not as "
            + ("rigid as assumed" if figures["refined"] else f"{rig.source} says; try --refine-rig")
        )
    turn, sigma = (
        figures["turn_against_file_degrees"], figures["turn_against_file_sigma_degrees"]
    )  # fmt: skip
    if turn > max(_TURNED_DEGREES, _TURNED_SIGMAS * sigma) and not figures["refined"]:
        notes.append(
            f"in the images, placed one by one, the rotation between two cameras differs by "
            f"{turn:.2f} degrees (standard error {sigma:.2f}) from that in {rig.source}; try "
            "--refine-rig"
        )
    return notes
