"""Places a rig's images with one pose a frame, and finds the rig of two lenses of a camera."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers, invert_pose
from gsut.data.rigs import Rig, measure_changes
from gsut.lens import Camera, save_camera
from gsut.sfm.mapping import Mapping, RigFit
from gsut.sfm.photographs import Photographs
from gsut.sfm.rig.start import RigStart, place_rig
from gsut.sfm.solution import (
    Adjustment,
    RigConstraint,
    Solution,
    adjust_poses,
    measure_rotation_angles,
    solve_poses,
)

# Growth of the median residual with one pose a frame that is reported: as in `gsut calibrate`,
# where boards show that images were not taken together.
_SHAKY = 1.5
_TURNED_DEGREES = 0.1  # mean turn against the rig's that is reported
_TURNED_SIGMAS = 5.0  # standard errors that such a turn must have
_EXACT_PX = 0.2  # residuals below this are not reported: no photograph's features are that exact
# Of poses.json, in place of the sentence for single images.
COVARIANCE_OF = (
    "centre in the world, turn in the camera frame (radians); the rig's pose at one frame is "
    "held, with one component of another's centre where the rig was refined; the cameras' poses on "
    "it count as known"
)
LENS_NAMES = ("front", "back")
_FEWEST = 4  # frames of which both images have a pose
_SAME = math.radians(5.0)  # largest difference of turns between the lenses from their middle
_RIGID = 1.5  # growth of the median residual with one pose a frame that contradicts a rig
# The solver takes lenses of equal parameters for one: the second differs in the last digits.
_DIFFERENCE = 1e-9
_CENTER = (2, 3)  # the parameters of the principal point
_FREE = 1  # flag of a parameter that is estimated by itself


def solve_rig(mapping: Mapping) -> None:
    """Estimates poses and points in the rig's unit, with one pose of the rig a frame.

    First each image by itself, through its own lens; then the rig's pose at each frame from the
    images placed, the scale from its baselines, and all images' poses from the rig's; then bundle
    adjustment of all observations with one pose a frame. Frames without a placed image are placed
    by the points found.

    Sets the mapping's solution and the fit of the rig.

    Raises:
        SolveError: nothing could be reconstructed; no frame has two placed images, so nothing
            sets the scale; or images contradict the rig.
    """
    rig, options = mapping.rig, mapping.options
    assert rig is not None
    # With tracks extended as at the end: short tracks fit any poses, and residuals show little.
    mapping.solution = solve_poses(
        mapping.images, mapping.pairs, options, mapping.log.follow_steps("mapping")
    )
    mapping.solution, mapping.found.rig = put_on_rig(mapping, rig, options.refine_rig)


def put_on_rig(mapping: Mapping, rig: Rig, adjust: bool) -> tuple[Solution, RigFit]:
    """Estimates one pose of the rig a frame, from images placed one by one.

    Args:
        mapping: with the solution of the images one by one.
        adjust: adjust the cameras' poses on the rig too.

    Raises:
        SolveError: see `solve_rig`.
    """
    alone, photographs = mapping.solved, mapping.photographs
    assert photographs.frames is not None and photographs.rig_cameras is not None
    start = place_rig(
        alone.camera_from_world, alone.registered, photographs.frames, photographs.rig_cameras,
        rig, np.bincount(alone.observations[:, 1], minlength=len(photographs)),
    )  # fmt: skip
    first = rig.camera_from_reference[0]
    constraint = RigConstraint(
        photographs.frames, photographs.rig_cameras - 1,
        rig.camera_from_reference[1:] @ invert_pose(first), start.known, adjust,
    )  # fmt: skip
    solution = adjust_poses(
        mapping.images, mapping.pairs, list(start.camera_from_world), mapping.options,
        mapping.log.follow_steps("rig"), Adjustment(mapping.lens_free, rig=constraint),
    )  # fmt: skip
    # An image that observes no point may be of another place: no pose by its frame alone.
    observed = np.bincount(solution.observations[:, 1], minlength=len(photographs)) > 0
    solution = dataclasses.replace(
        solution, initial_pair=alone.initial_pair, restarts=alone.restarts,
        registered=solution.registered & observed,
    )  # fmt: skip
    mounts = solution.camera_from_body
    assert mounts is not None
    now = rig
    if adjust:
        found = np.concatenate([first[None], mounts @ first])
        now = dataclasses.replace(rig, camera_from_reference=found)
    figures = _describe_rig(photographs, (rig, now), start, alone, solution)
    return solution, RigFit(now, figures, _list_notes(rig, figures))


def _measure_residuals(alone: Solution, solution: Solution) -> tuple[float, float]:
    """Returns both median residuals in pixels, over the observations that both solutions have."""
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


def _estimate_scale_sigma(solution: Solution) -> float | None:
    """Estimates the relative standard error of lengths, the rig's own being exact; or None.

    It is that of an image's distance from the frame whose pose is held: the smallest over all
    images, as a far image's own error matters least.
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


def _describe_rig(
    photographs: Photographs,
    rigs: tuple[Rig, Rig],
    start: RigStart,
    alone: Solution,
    solution: Solution,
) -> dict[str, Any]:
    """Describes a rig for poses.json: as given, as it is now, and what the images say about it.

    Args:
        rigs: the rig given, and the rig now: the same object if it was not refined.
        start: poses of the rig from images placed one by one.
        alone, solution: images placed one by one, and on the rig.
    """
    rig, now = rigs
    frames, cameras = photographs.frames, photographs.rig_cameras
    assert frames is not None and cameras is not None
    names, registered = np.array(photographs.names), solution.registered
    table: list[list[str | None]] = [
        [None] * len(rig) for _ in range(int(frames.max(initial=-1)) + 1)
    ]
    for name, frame, camera in zip(photographs.names, frames, cameras, strict=True):
        table[frame][camera] = name
    before_px, after_px = _measure_residuals(alone, solution)
    # While the rig is refined a pose holds the scale, so covariances do not include it.
    scale_sigma = None if now is not rig else _estimate_scale_sigma(solution)
    changes = measure_changes(rig, now.camera_from_reference)
    return {
        "file": str(rig.source),
        "refined": now is not rig,
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


def _list_notes(rig: Rig, figures: dict[str, Any]) -> list[str]:
    """Lists what a user should know of the rig, one sentence each."""
    images = sum(camera["images"] for camera in figures["cameras"])
    how = "by name" if figures["paired_by"] == "name" else "in order, as names differ"
    incomplete = sum(None in row for row in figures["frames"])
    notes = [
        f"{images} images of {len(rig)} cameras in {figures['frames_total']} frames, paired {how}"
        + (f"; {incomplete} without the image of a camera" if incomplete else "")
    ]
    before_px, after_px = figures["residual_alone_px"], figures["residual_px"]
    if after_px > max(_SHAKY * before_px, _EXACT_PX):
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


def find_lens_pair(mapping: Mapping, folder: Path) -> None:
    """Finds the rig of two lenses, and the poses of all images on it.

    Does nothing where the lens was known, images have no frames, or a rolling shutter was found: a
    rig takes its cameras for still while an image is read.

    Args:
        mapping: poses image by image, through one lens for both.
        folder: where the rig and both lenses will be written.
    """
    photographs, alone = mapping.photographs, mapping.solved
    frames, flags = photographs.frames, mapping.one_lens_free
    if flags is None or frames is None or alone.shutter is not None:
        return
    start = _find_back_from_front(alone, photographs)
    if start is None:
        mapping.log.note(
            f"fewer than {_FEWEST} frames have poses of both lenses that agree: their images are "
            "placed one by one, not as those of a rig"
        )
        return
    lens = alone.cameras[0]
    second = lens.with_params(lens.params * (1 + _DIFFERENCE))
    files = tuple((folder / f"{name}.yaml", None) for name in LENS_NAMES)
    rig = Rig(folder / "rig.json", LENS_NAMES, (lens, second), np.stack([np.eye(4), start]), files)
    assert photographs.rig_cameras is not None
    cameras: list[Camera | None] = [rig.cameras[camera] for camera in photographs.rig_cameras]
    flags = flags.copy()
    flags[list(_CENTER)] = _FREE  # circles are found to a pixel only
    of_rig = dataclasses.replace(photographs, cameras=cameras)
    try:
        solution, fit = put_on_rig(
            dataclasses.replace(mapping, photographs=of_rig, lens_free=flags), rig, True
        )
    except SolveError as error:
        mapping.log.note(f"the images' poses make no rig of two lenses: {error}")
        return
    before, after = fit.figures["residual_alone_px"], fit.figures["residual_px"]
    if after > _RIGID * before or solution.num_registered < alone.num_registered:
        mapping.log.note(
            f"with one pose a frame {solution.num_registered} of {len(photographs)} images are "
            f"off by {after:.2f} px, one by one {alone.num_registered} by {before:.2f}: the two "
            "lenses were not read in one moment, and their images are placed one by one"
        )
        return
    lenses = tuple(solution.cameras[int(np.argmax(photographs.rig_cameras == k))] for k in (0, 1))
    fit = dataclasses.replace(fit, rig=dataclasses.replace(fit.rig, cameras=lenses))
    turn = float(np.degrees(measure_rotation_angles(fit.rig.camera_from_reference[1:, :3, :3])[0]))
    fit.figures.update(found=True, turn_degrees=turn)
    mapping.log.note(
        f"the two lenses are a rig: {fit.figures['frames_registered']} frames, the back one turned "
        f"by {turn:.2f} degrees against the front one (rig.json)"
    )
    mapping.solution, mapping.found.rig = solution, fit


def _find_back_from_front(alone: Solution, photographs: Photographs) -> np.ndarray | None:
    """Returns (4, 4) back_from_front, the middle of the frames whose poses agree, or None."""
    frames, lens_of = photographs.frames, photographs.rig_cameras
    assert frames is not None and lens_of is not None
    found = []
    for frame in range(int(frames.max(initial=-1)) + 1):
        rows = [np.flatnonzero((frames == frame) & (lens_of == k) & alone.registered)
                for k in (0, 1)]  # fmt: skip
        if len(rows[0]) and len(rows[1]):
            front, back = (alone.camera_from_world[row[0]] for row in rows)
            found.append(back @ invert_pose(front))
    if len(found) < _FEWEST:
        return None
    poses = np.array(found)
    apart = np.array([measure_rotation_angles(poses[:, :3, :3] @ pose[:3, :3].T) for pose in poses])
    middle = int(np.argmin(np.median(apart, axis=1)))
    good = apart[middle] <= _SAME
    if good.sum() < max(_FEWEST, len(poses) / 2):
        return None
    left, _, right = np.linalg.svd(poses[good, :3, :3].sum(axis=0))
    result = np.eye(4)
    result[:3, :3] = left @ right
    # The position of the back lens in the front one's frame does not turn with the cameras.
    place = np.median([invert_pose(pose)[:3, 3] for pose in poses[good]], axis=0)
    result[:3, 3] = -result[:3, :3] @ place
    return result


def write_lens_pair(fit: RigFit) -> None:
    """Writes both lenses beside the rig's file."""
    for camera, (path, _) in zip(fit.rig.cameras, fit.rig.lens_files, strict=True):
        save_camera(camera, path)
