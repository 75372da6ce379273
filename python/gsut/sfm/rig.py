"""Poses of a rig's images: first one by one, then one pose a moment, in the rig's unit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import inverse
from gsut.sfm.align import centers_of
from gsut.sfm.features import Features
from gsut.sfm.inputs import Photographs
from gsut.sfm.matching import PairMatches
from gsut.sfm.options import PosesOptions
from gsut.sfm.rig_file import Rig, relative_changes
from gsut.sfm.rig_start import RigStart, place_rig
from gsut.sfm.solution import OnRig, Solution, refine, solve

# Growth of the median residual, with one pose a moment, that is worth a word: as in `gsut
# calibrate`, whose boards show that images were not taken together.
_SHAKY = 1.5
# A mean turn against the rig's that is worth a word: so large, and so many standard errors.
_TURNED_DEGREES = 0.1
_TURNED_SIGMAS = 5.0
_FEWEST_PX = 0.2  # residuals below this need no word: no photograph's features are that exact
# Of poses.json, in place of the words for single images.
COVARIANCE_OF = (
    "centre in the world, turn in the camera frame (radians); the rig's pose at one moment is "
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
    """Poses and points in the rig's unit, one pose of the rig a moment.

    First each image by itself, through its own lens; then the rig's pose at each moment from the
    images placed, the scale from its baselines, and all images' poses from the rig's; then bundle
    adjustment over all sights with one pose a moment. Moments without a placed image are placed by
    the points found.

    Args:
        photographs: see `find_rig_photographs`.
        features, pairs, options: as for `solution.solve`; images without any feature get no pose.
        on_progress: told (registered, images, points, step) while images are placed one by one.
        on_rig_progress: the same, with one pose a moment.
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
        on_rig_progress,
        on_rig=OnRig(
            photographs.moments, photographs.rig_cameras - 1, camera_from_body, start.known, adjust
        ),
    )  # fmt: skip
    # An image that could not be read has no features: its mates' pose must not make it a frame.
    readable = np.array([len(f) > 0 for f in features])
    solution = dataclasses.replace(
        solution, initial_pair=alone.initial_pair, restarts=alone.restarts,
        registered=solution.registered & readable,
    )  # fmt: skip
    mounts = solution.camera_from_body
    assert mounts is not None
    found = np.concatenate([first[None], mounts @ first]) if adjust else rig.camera_from_reference
    return solution, _fit(photographs, rig, found, start, alone, solution, adjust)


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


def _scale_sigma(solution: Solution) -> float | None:
    """Relative standard error of lengths, the rig's own taken for exact; None: not known.

    That of the distance of each image from the moment whose pose is held: the smallest, of those
    far away, has least of the image's own.
    """
    centers = centers_of(solution.camera_from_world)
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
        + (f"; {incomplete} without the image of a camera" if incomplete else "")
    ]
    if after_px > max(_SHAKY * before_px, _FEWEST_PX):
        notes.append(
            f"with one pose of the rig a moment the residuals are {after_px:.2f} px "
            f"(median), each image by itself has {before_px:.2f}: the images of one moment were "
            "not taken together, or the rig is not as "
            + (f"{rig.source} says; try --refine-rig" if not adjust else "rigid as assumed")
        )
    # Where the rig is refined a pose holds the scale meanwhile, and covariances lack it.
    scale_sigma = None if adjust else _scale_sigma(solution)
    turn, sigma = start.turn_degrees, start.turn_sigma_degrees
    if turn > max(_TURNED_DEGREES, _TURNED_SIGMAS * sigma) and not adjust:
        notes.append(
            f"in the images, placed one by one, two cameras are turned to each other by {turn:.2f} "
            f"degrees (standard error {sigma:.2f}) otherwise than {rig.source} says; try "
            "--refine-rig"
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
                zip(rig.names, found, rig.camera_from_reference, changes, strict=True)
            )
        ],
        "moments": table,
    }
    return RigFit(now, figures, notes)
