"""Poses a photograph by features that match those of rendered views, whose distances are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import Shutter
from gsut.data.poses import find_centers
from gsut.gaussians import Gaussians
from gsut.refine.matched_lines import find_line_poses
from gsut.refine.pixel_rows import POSE
from gsut.render import render, to_uint8
from gsut.sfm import PosesOptions
from gsut.sfm.matches import MAX_DISTANCE, MAX_RATIO
from gsut.sfm.photographs import Features, detect_features

# Numbers of rendered views that are matched, best ranked first: more where fewer do not suffice.
_MATCHED_VIEWS = (4, 12)
# Alpha from which a rendered distance is that of a surface.
_OPAQUE = 0.8
# Distance of a match that agrees with a pose, in thousandths of the image's diagonal: rendered
# distances are less exact than triangulated ones (1.8 there).
_MAX_ERROR = 4.0
# The same under a rolling shutter before its motion is known, in those: lines are off by it.
_BY_MOTION = 8.0
# Matches that must agree with a pose to start from it: chance gives a few.
_FEWEST_MATCHES = 12
# Matches from which no further view is matched.
_PLENTY_OF_MATCHES = 100
# Matches from which no other start is tried, if the colours converge.
SURE_MATCHES = 40


@dataclasses.dataclass(frozen=True)
class Start:
    """A pose to start from; name and matches as of `Localized`.

    Attributes:
        motion: (6,) during the readout, where matches determine it, too.
    """

    name: str | int
    pose: np.ndarray
    matches: int = 0
    motion: np.ndarray | None = None


def find_pose_by_matches(
    gaussians: Gaussians,
    views: Sequence[tuple[_core.Camera, np.ndarray]],
    order: Sequence[int],
    camera: _core.Camera,
    pixels: np.ndarray,
    mask: np.ndarray,
    background: Sequence[float],
    shutter: Shutter | None,
    show: Callable[[str, int, int], None],
) -> Start | None:
    """Estimates a pose from features matched to renders, with its inliers; None if too few."""
    options = PosesOptions()
    photograph = detect_features(np.ascontiguousarray(pixels), mask & camera.rays()[1], options)
    if not len(photograph):
        return None
    best: Start | None = None
    features: list[Features] = []
    points: list[np.ndarray] = []
    for count in _MATCHED_VIEWS:
        for index in order[len(features) : count]:
            show("matching", len(features) + 1, min(count, len(order)))
            found, places = _detect_rendered_features(gaussians, *views[index], background, options)
            features.append(found)
            points.append(places)
        best = _find_pose_by_features(camera, photograph, features, points, shutter)
        if best is not None and best.matches >= _PLENTY_OF_MATCHES:
            break
    return best


def _find_pose_by_features(
    camera: _core.Camera,
    photograph: Features,
    features: list[Features],
    points: list[np.ndarray],
    shutter: Shutter | None,
) -> Start | None:
    """Estimates a pose from features of rendered views and their points (n, 3) each."""
    descriptors = [f.descriptors for f in (photograph, *features)]
    pairs = np.array([(0, number) for number in range(1, len(descriptors))])
    matched = _core.match_pairs(descriptors, pairs, MAX_RATIO, MAX_DISTANCE)
    rows = np.concatenate([matches[:, 0] for matches in matched]).astype(np.int64)
    places = np.concatenate(
        [points[number][matches[:, 1]] for number, matches in enumerate(matched)]
    )
    bearings = _core.ImageBearings(camera, photograph.pixels)
    good = np.isfinite(places).all(axis=1) & bearings.valid[rows]
    if np.count_nonzero(good) < _FEWEST_MATCHES:
        return None
    max_error = _MAX_ERROR * float(np.hypot(camera.width, camera.height)) / 1000
    rows, places = rows[good], places[good]
    pose, inliers = _core.absolute_pose(bearings, rows, places, max_error, 0)
    agree = len(np.unique(rows[inliers]))
    if shutter is None or shutter.is_global:
        return Start("matches", pose, agree) if agree >= _FEWEST_MATCHES else None
    moved, inliers = _core.absolute_pose(bearings, rows, places, _BY_MOTION * max_error, 0)
    middle, motion, agreeing = find_line_poses(
        camera, shutter, moved, photograph.pixels[rows[inliers]], places[inliers], max_error
    )
    matches = len(np.unique(rows[inliers][agreeing]))
    if matches >= max(agree, SURE_MATCHES):
        return Start("matches", middle, matches, motion)
    # No fewer agree with a pose at rest: the motion is less than a match's error.
    still = np.zeros(POSE) if agree >= SURE_MATCHES else None
    return Start("matches", pose, agree, still) if agree >= _FEWEST_MATCHES else None


def _detect_rendered_features(
    gaussians: Gaussians,
    camera: _core.Camera,
    pose: np.ndarray,
    background: Sequence[float],
    options: PosesOptions,
) -> tuple[Features, np.ndarray]:
    """Detects features of a rendered view; returns them and their points (n, 3), NaN if unknown."""
    rays, valid = camera.rays()
    center = find_centers(pose[None])[0]
    some = gaussians.select_seen(center, rays[valid] @ pose[:3, :3], 0.0)
    result: Any = render(some, camera, pose, background=background, watch=False)
    found = detect_features(to_uint8(result.image), np.array(valid, bool), options)
    if not len(found):
        return found, np.zeros((0, 3))
    column, row = np.clip(found.pixels.astype(int), 0, [camera.width - 1, camera.height - 1]).T
    alpha = result.alpha[row, column].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(alpha >= _OPAQUE, result.depth[row, column] / alpha, np.nan)
    rays, known = camera.unproject(found.pixels)
    origins, _ = camera.ray_origins(found.pixels)
    in_camera = np.where(known[:, None], origins + rays * distance[:, None], np.nan)
    return found, (in_camera - pose[:3, 3]) @ pose[:3, :3]
