"""Describes how images fit their rig: figures for poses.json, and notes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut.data import list_some
from gsut.data.poses import find_centers
from gsut.data.rigs import Rig, measure_changes
from gsut.judge import SURE
from gsut.judge.checks import SHAKY
from gsut.sfm.photographs import Photographs
from gsut.sfm.rig.observability import MountUncertainty
from gsut.sfm.rig.start import RigStart
from gsut.sfm.solution import Solution

_AXES = ("x (right)", "y (down)", "z (forward)")
_NEARLY = 0.95  # cosine from which a direction is called by an axis
# Of poses.json, in place of the sentence for single images.
COVARIANCE_OF = (
    "centre in the world, turn in the camera frame (radians); the rig's pose at one frame is "
    "held, with one component of another's centre where the rig was refined; the cameras' poses on "
    "it count as known"
)


def describe_rig(
    photographs: Photographs,
    rigs: tuple[Rig, Rig],
    start: RigStart,
    alone: Solution,
    solution: Solution,
) -> dict[str, Any]:
    """Describes a rig for poses.json: as given, as it is now, and what the images say about it.

    Args:
        rigs: the rig given, and the rig now: the same poses if it was not refined.
        start: poses of the rig from images placed one by one.
        alone, solution: images placed one by one, and on the rig.
    """
    rig, now = rigs
    is_refined = now.camera_from_reference is not rig.camera_from_reference
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
    scale_sigma = None if is_refined else _estimate_scale_sigma(solution)
    changes = measure_changes(rig, now.camera_from_reference)
    return {
        "file": str(rig.source),
        "refined": is_refined,
        "lenses_estimated": [rig.names[number] for number in rig.unknown_lenses],
        "unit": "that of the rig's file, which all poses and points are in",
        "paired_by": photographs.paired_by,
        "frames_total": len(table),
        "frames_registered": len(np.unique(frames[registered])),
        "unmatched": names[~registered & np.isin(frames, frames[registered])].tolist(),
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


def add_uncertainty(figures: dict[str, Any], mounts: Sequence[MountUncertainty]) -> None:
    """Adds how well the images determine each camera's pose on a refined rig.

    Standard deviations are those of the worst directions.
    """
    for row, mount in zip(figures["cameras"][1:], mounts, strict=True):
        place, turn = (
            float(np.sqrt(np.linalg.eigvalsh(each)[-1])) for each in (mount.place, mount.turn)
        )
        row["sigma_place_percent"] = 100.0 * place
        row["sigma_turn_degrees"] = float(np.degrees(turn))
        row["not_determined"] = [
            {"kind": kind, "axis": axis, "sigma": sigma if math.isfinite(sigma) else None}
            for kind, axis, sigma in mount.list_open_directions()
        ]


def describe_open(camera: dict[str, Any]) -> str | None:
    """Describes what the images leave open of a camera's pose on the rig, as a sentence."""
    words = []
    for row in camera.get("not_determined", []):
        largest = int(np.argmax(np.abs(row["axis"])))
        if abs(row["axis"][largest]) > _NEARLY:
            axis = _AXES[largest]
        else:
            axis = "({:.2f}, {:.2f}, {:.2f})".format(*row["axis"])
        if row["sigma"] is None:
            known = "not at all"
        elif row["kind"] == "place":
            known = f"to {100 * row['sigma']:.0f} % of the rig's size"
        else:
            known = f"to {np.degrees(row['sigma']):.1f} degrees"
        way = "along" if row["kind"] == "place" else "about"
        words.append(f"its {row['kind']} {way} {axis} {known}")
    if not words:
        return None
    return (
        f"these images hardly determine where {camera['name']} is on the rig: {', '.join(words)} "
        "(one standard deviation); there the rig's file is the better source: turn the rig about "
        "other axes while it takes pictures, let the cameras see the same things, or leave "
        "--refine-rig out"
    )


def list_rig_notes(rig: Rig, figures: dict[str, Any]) -> list[str]:
    """Lists what a user should know of the rig, one sentence each."""
    images = sum(camera["images"] for camera in figures["cameras"])
    how = "by name" if figures["paired_by"] == "name" else "in order, as names differ"
    incomplete = sum(None in row for row in figures["frames"])
    notes = [
        f"{images} images of {len(rig)} cameras in {figures['frames_total']} frames, paired {how}"
        + (f"; {incomplete} without the image of a camera" if incomplete else "")
    ]
    if figures["unmatched"]:
        notes.append(
            f"{len(figures['unmatched'])} of them share no point with other images and have no "
            f"pose, although their frame has one: {list_some(figures['unmatched'])}"
        )
    notes += [note for note in map(describe_open, figures["cameras"]) if note is not None]
    before_px, after_px = figures["residual_alone_px"], figures["residual_px"]
    if after_px > SHAKY * before_px:
        notes.append(
            f"with one pose of the rig a frame the residuals are {after_px:.2f} px "
            f"(median), each image by itself has {before_px:.2f}: the images of one frame were "
            "not taken together, or the rig is not as "
            + ("rigid as assumed" if figures["refined"] else f"{rig.source} says; try --refine-rig")
        )
    turn, sigma = (figures[f"turn_against_file_{each}degrees"] for each in ("", "sigma_"))
    # Through an estimated lens a turn may be its principal point, which the rig then determines.
    is_known = not (figures["refined"] or figures["lenses_estimated"])
    if turn > SURE * sigma and is_known:
        notes.append(
            f"in the images, placed one by one, the rotation between two cameras differs by "
            f"{turn:.2f} degrees (standard error {sigma:.2f}) from that in {rig.source}; try "
            "--refine-rig"
        )
    return notes


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
