"""Measures poses and lenses against the truth of a capture."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gsut.lens import Camera

THRESHOLDS = (0.5, 1.0, 5.0, 10.0)  # degrees, of the areas under the recall curve
_LOST = 180.0  # degrees: error of a pair without both poses
_NO_BASELINE = 0.005  # of what is seen away: below it a pair has no direction to get wrong
_GRID = 25  # places of a lens' pictures, each way, where lenses are compared
_INNER = math.radians(30.0)

# Camera axes of a photograph that lies on its side, from those of the camera as it was held.
ON_ITS_SIDE = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])

# What a verdict should be: pixels within which lens and a share of the pairs are right, that
# share, and the share of the pictures with a pose. Pixels are those of a picture of this diagonal.
_DIAGONAL = 350.0
_GOOD = (2.0, 0.90, 0.95)
_USABLE = (6.0, 0.60, 0.60)
# Share of the detail that is right in the median view of a good and of a usable scene: what a
# verdict promises of held-out views.
_DETAIL = {"good": 0.8, "usable": 0.4}


def measure_pair_errors(
    found: Mapping[int, np.ndarray], truth: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Measures each pair's error in degrees: the larger of rotation and direction of translation.

    The second is the same with the direction's error as it turns what is seen: times the baseline
    over the distance, so that two pictures from nearly one place need no exact direction.

    Args:
        found: camera_from_world (4, 4) by number of the picture.
        truth: (N, 4, 4) camera_from_world.
        reach: metres that what is seen is away.
    """
    errors, shifts = [], []
    for a, b in itertools.combinations(range(len(truth)), 2):
        if a not in found or b not in found:
            errors.append(_LOST)
            shifts.append(_LOST)
            continue
        own = found[b] @ np.linalg.inv(found[a])
        true = truth[b] @ np.linalg.inv(truth[a])
        error = shift = _measure_angle(own[:3, :3] @ true[:3, :3].T)
        way, right = own[:3, 3], true[:3, 3]
        baseline = float(np.linalg.norm(right)) / reach
        if baseline > _NO_BASELINE:
            lengths = np.linalg.norm(way) * np.linalg.norm(right)
            cosine = float(way @ right / lengths) if lengths > 0 else -1.0
            turned = math.degrees(math.acos(np.clip(cosine, -1, 1)))
            error, shift = max(error, turned), max(shift, min(baseline, 1.0) * turned)
        errors.append(error)
        shifts.append(shift)
    return np.array(errors), np.array(shifts)


def _measure_angle(rotation: np.ndarray) -> float:
    sine = np.linalg.norm(rotation - rotation.T) / (2 * math.sqrt(2))
    return math.degrees(math.atan2(sine, (np.trace(rotation) - 1) / 2))


def measure_areas(errors: np.ndarray) -> dict[str, float]:
    """Measures the area under the recall curve up to each threshold, 0 to 1."""
    return {f"auc_{t:g}": float(np.maximum(0, 1 - errors / t).mean()) for t in THRESHOLDS}


def classify(shifts: np.ndarray, registered: float, camera: Camera, lens_px: float = 0.0) -> str:
    """Returns what a verdict on poses should say: "good", "usable" or "poor".

    Args:
        shifts: of the pairs, degrees; those without both poses do not count here.
        registered: share of the pictures. camera: the true lens.
        lens_px: by which an estimated lens is off: a camera that only turned has poses that fit a
            wrong one.
    """
    scale = _DIAGONAL / math.hypot(camera.width, camera.height)
    pixels = scale * _convert_to_pixels(shifts, camera)
    for level, (most, agreeing, share) in (("good", _GOOD), ("usable", _USABLE)):
        is_near = pixels <= most
        agrees = is_near.sum() >= max(1, agreeing * len(pixels)) and scale * lens_px <= most
        if agrees and registered >= share:
            return level
    return "poor"


def list_shifts(shifts: np.ndarray, camera: Camera) -> list[float]:
    """Lists the pixels that nine and six in ten pairs with poses stay below.

    Args:
        shifts: of the pairs, degrees.
        camera: the true lens.
    """
    pixels = _convert_to_pixels(shifts, camera)
    return np.quantile(pixels, (_GOOD[1], _USABLE[1])).tolist() if len(pixels) else []


def _convert_to_pixels(shifts: np.ndarray, camera: Camera) -> np.ndarray:
    """Converts the degrees of the pairs with poses to pixels on the axis."""
    return np.radians(shifts[shifts < _LOST]) * _measure_focal(camera)


def classify_scene(detail: float | None, registered: float) -> str:
    """Returns what the verdict on a scene should say: "good", "usable" or "poor".

    Args:
        detail: share that is right in the median view between pictures; None: there is none.
        registered: share of the pictures.
    """
    for level, (_, _, share) in (("good", _GOOD), ("usable", _USABLE)):
        if (detail or 0.0) >= _DETAIL[level] and registered >= share:
            return level
    return "poor"


def compare_lenses(found: Camera, truth: Camera, turned: bool = False) -> dict[str, Any]:
    """Compares what two lenses see in the same pixels, the best turn between them taken out.

    Args:
        found: estimated.
        truth: of the camera as it was held.
        turned: the photographs lie on their side.

    Returns:
        Root mean square in pixels over the picture and in the inner 30 degrees, and the relative
        error of the focal length on the axis.
    """
    x, y = np.meshgrid(np.linspace(0.5, truth.width - 0.5, _GRID),
                       np.linspace(0.5, truth.height - 0.5, _GRID))  # fmt: skip
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    own = np.stack([pixels[:, 1], truth.width - pixels[:, 0]], axis=1) if turned else pixels
    ours, valid = found.unproject(own)
    ours = ours @ ON_ITS_SIDE[:3, :3] if turned else ours
    theirs, also = truth.unproject(pixels)
    good = valid & also
    left, _, right = np.linalg.svd(theirs[good].T @ ours[good])
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    there, seen = truth.project(ours[good] @ turn.T)
    off = np.linalg.norm(there - pixels[good], axis=1)
    inner = theirs[good][:, 2] > math.cos(_INNER)
    off = np.where(seen, off, np.nan)
    return {
        "lens_px": math.sqrt(np.nanmean(off**2)),
        "lens_inner_px": math.sqrt(np.nanmean(off[inner] ** 2)) if inner.any() else None,
        "focal_error": _measure_focal(found) / _measure_focal(truth) - 1,
    }


def _measure_focal(camera: Camera) -> float:
    """Measures pixels a radian on the axis."""
    step = 1e-4
    ends = camera.project(np.array([[-step, 0.0, 1.0], [step, 0.0, 1.0]]))[0]
    return float(np.linalg.norm(ends[1] - ends[0])) / (2 * step)


def find_truth_poses(world_from_camera: Sequence[np.ndarray]) -> np.ndarray:
    """Returns (N, 4, 4) camera_from_world."""
    return np.linalg.inv(np.asarray(world_from_camera))
