"""How good poses are, why, and what to do next: the verdict of `gsut poses`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gsut.run import Verdict
from gsut.sfm.core import Features, LookAlikes, Solution, count_exceeded, picture_faults
from gsut.sfm.lens import FOCAL_LIMITS, TURNED, LensDoubt

# Below the first a result is usable at most, below the second poor.
_REGISTERED = (0.95, 0.6)
_IMAGES = (20, 6)
_OBSERVATIONS = (100, 30)  # of an image, in the tenth part that sees fewest points
# Share of the matches that end in points, where the lens was estimated, and where it was given:
# 0.54 for a good flight with a rolling shutter, 0.3 to 0.4 with a wrong lens.
_AGREEING, _AGREEING_GIVEN = (0.5, 0.25), (0.5, 0.45)
_RESIDUAL = (1.0e-3, 2.5e-3)
_APART = (
    "put the pictures of each place into a folder of their own, or add pictures of the way from "
    "one to the other, and put up something that tells them apart"
)


def poses_verdict(
    solution: Solution,
    features: Sequence[Features],
    agreeing: float | None,
    doubt: LensDoubt | None,
    zooms: int = 0,
    alike: LookAlikes | None = None,
) -> Verdict:
    """The verdict.

    Args:
        solution: poses and points. features: of all images.
        agreeing: share of the matches that end in points, or None.
        doubt: of the lens, where it was estimated.
        zooms: that the images were taken at, where more than one.
        alike: images that speak for places taken for one, or None.
    """
    total, registered = len(solution.names), solution.num_registered
    camera = solution.cameras[0]
    counts = np.bincount(solution.observations[:, 1], minlength=total)[solution.registered]
    weak = float(np.percentile(counts, 10)) if counts.any() else math.inf  # no points: by colours
    residual = solution.median / math.hypot(camera.width, camera.height)
    sigma = 0.0 if doubt is None else 2 * doubt.focal_sigma
    lost = _below(registered / max(1, total), _REGISTERED)
    # (how bad: 0 to 2, what, what to do), causes before what they lead to
    found = [
        (
            0 if doubt is None or not doubt.motion else 2 if doubt.motion.startswith(TURNED) else 1,
            (doubt.motion or "").split(":")[0] if doubt else "",
            (doubt.motion or "").rpartition(": ")[2] if doubt else "",
        ),
        *([] if alike is None else [(2, alike.words(), _APART)]),
        *picture_faults(features, total),
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
            _below(registered, _IMAGES),
            f"only {registered} views",
            "take 60 pictures or more, walking around what you want to see",
        ),
        (
            _below(weak, _OBSERVATIONS),
            f"weak overlap: the weakest images see {weak:.0f} points of the others",
            "take more pictures between them, each showing two thirds of the one before",
        ),
        (
            _below(
                1.0 if agreeing is None else agreeing,
                _AGREEING_GIVEN if doubt is None else _AGREEING,
            ),
            f"only {100 * (agreeing or 0):.0f} % of the matches agree in all images together",
            "give --shutter rolling if the camera moved fast"
            if doubt is not None
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
    found = [row for row in found if row[0] > 0]
    found.sort(key=lambda row: -row[0])
    level = ("good", "usable", "poor")[max((row[0] for row in found), default=0)]
    what = (
        f"poses of {registered} of {total} images, {len(solution.points):,} points, off by "
        f"{solution.median:.2f} px in the median"
    )
    advice = found[0][2] if found else "gsut train"
    return Verdict(level, what, tuple(row[1] for row in found), advice)


def _below(value: float, limits: tuple[float, float]) -> int:
    return int(value < limits[0]) + int(value < limits[1])
