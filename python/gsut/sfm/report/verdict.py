"""Judges how good poses are, and states what a user should know about them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gsut.data import list_some
from gsut.run import Verdict
from gsut.sfm.core import Features, Findings, Mapping, Solution, count_exceeded, find_picture_faults
from gsut.sfm.lens import FOCAL_LIMITS, TURNED, describe_doubt

# Limits below which a result is usable at most, and below which it is poor.
_REGISTERED = (0.95, 0.6)  # share of the images with a pose
_IMAGES = (20, 6)  # images with a pose
_OBSERVATIONS = (100, 30)  # of an image, in the tenth of the images that see fewest points
# Share of the matches that observe one point, with an estimated lens and with a given one: 0.54 for
# a good flight with a rolling shutter, 0.3 to 0.4 with a wrong lens.
_AGREEING = (0.5, 0.25)
_AGREEING_GIVEN = (0.5, 0.45)
# Median residual over the diagonal above which a result is usable at most, and above which it is
# poor.
_RESIDUAL = (1.0e-3, 2.5e-3)
_SEPARATE_PLACES = (
    "put the pictures of each place into a folder of their own, or add pictures of the way from "
    "one to the other, and put up something that sets them apart"
)
# Share of the verified matches that must observe one point, or the lens is doubted.
_FEW_AGREE = 0.6
# The same with a rolling shutter, below which the scene has bent (Albl et al., "Degeneracies in
# rolling shutter SfM", ECCV 2016): 0.34 to 0.75 in bent scenes, 0.86 and more in others.
_FEW_AGREE_ROLLING = 0.8


def judge_poses(
    solution: Solution, features: Sequence[Features], agreement: float | None, found: Findings
) -> Verdict:
    """Judges how good poses are, with the reasons and what to do next.

    Args:
        features: of all images.
        agreement: share of the matches that observe one point, or None.
        found: beside the poses.
    """
    total, registered = len(solution.names), solution.num_registered
    camera = solution.cameras[0]
    counts = np.bincount(solution.observations[:, 1], minlength=total)[solution.registered]
    weak = float(np.percentile(counts, 10)) if counts.any() else math.inf  # inf: placed by colours
    residual = solution.median / math.hypot(camera.width, camera.height)
    sigma = 2 * (found.focal_sigma or 0.0)
    is_lens_known, motion, zooms = found.focal_sigma is None, found.motion or "", len(found.zooms)
    alike = found.look_alikes
    lost = _count_missed(registered / max(1, total), _REGISTERED)
    # Severity (0 to 2), fault and advice; causes before what they lead to.
    faults = [
        (
            0 if not motion else 2 if motion.startswith(TURNED) else 1,
            motion.split(":")[0],
            motion.rpartition(": ")[2],
        ),
        *([] if alike is None else [(2, alike.explain(), _SEPARATE_PLACES)]),
        *find_picture_faults(features),
        (
            max(1, lost) if zooms > 1 else 0,
            f"the images were taken at {zooms} zooms",
            "put the images of each zoom into a folder of their own",
        ),
        (
            lost,
            f"{total - registered} of {total} images could not be connected with the others",
            "add pictures between those that are connected and the others; those of another camera "
            "or zoom need a run of their own",
        ),
        (
            _count_missed(registered, _IMAGES),
            f"only {registered} views",
            "take 60 pictures or more, walking around what you want to see",
        ),
        (
            _count_missed(weak, _OBSERVATIONS),
            f"weak overlap: the weakest images see {weak:.0f} points of the others",
            "take more pictures between them, each showing two thirds of the one before",
        ),
        (
            _count_missed(
                1.0 if agreement is None else agreement,
                _AGREEING_GIVEN if is_lens_known else _AGREEING,
            ),
            f"only {100 * (agreement or 0):.0f} % of the matches agree in all images together",
            "give --shutter rolling if the camera moved fast"
            if not is_lens_known
            else "let the lens be estimated: --unknown-lens",
        ),
        (
            count_exceeded(sigma, FOCAL_LIMITS),
            "the focal length is "
            + ("not determined" if sigma > 1 else f"known only to {100 * sigma:.1f} %"),
            "give the lens by --camera or --fov, or turn the camera more while you walk",
        ),
        (
            count_exceeded(residual, _RESIDUAL),
            f"points are off by {solution.median:.2f} px",
            "give --shutter rolling if the camera moved fast, or the lens by --camera",
        ),
    ]  # fmt: skip
    faults = [row for row in faults if row[0] > 0]
    faults.sort(key=lambda row: -row[0])
    level = ("good", "usable", "poor")[max((row[0] for row in faults), default=0)]
    what = (
        f"poses of {registered} of {total} images, {len(solution.points):,} points, off by "
        f"{solution.median:.2f} px in the median"
    )
    advice = faults[0][2] if faults else "gsut train"
    return Verdict(level, what, tuple(row[1] for row in faults), advice)


def _count_missed(value: float, limits: tuple[float, float]) -> int:
    """Returns how many of the limits a value misses."""
    return int(value < limits[0]) + int(value < limits[1])


def list_notes(mapping: Mapping, agreement: float | None, *, is_lens_known: bool) -> list[str]:
    """Lists what a user should know of the poses, one sentence each.

    Args:
        agreement: share of the matches that observe one point, or None.
    """
    solution, found = mapping.solved, mapping.found
    notes = list(found.rig.notes) if found.rig is not None else []
    if solution.num_registered < len(solution.names):
        notes.append(
            f"{solution.num_registered} of {len(solution.names)} images were registered; without a "
            f"pose: {list_some(solution.unregistered_names)}"
        )
    doubt = describe_doubt(found)
    if doubt is not None:
        notes.append(doubt)
    if agreement is None:
        return notes
    share = (
        f"only {100 * agreement:.0f} % of the matches that agree pair by pair agree in all images "
        "together; "
    )
    if solution.shutter is not None and agreement < _FEW_AGREE_ROLLING:
        lens = "the lens is not that of the images, or " if is_lens_known else ""
        notes.append(
            share + lens + "the scene has bent with the motion during the readout, which few "
            "images held alike do not reveal: add images, some turned by 90 degrees about the "
            "axis of the lens, or give --readout-time for a video"
        )
    elif solution.shutter is None and is_lens_known and agreement < _FEW_AGREE:
        notes.append(
            share + "the lens is probably not that of the images: check it, or let it be "
            "estimated with --unknown-lens"
        )
    return notes
