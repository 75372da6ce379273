"""Where a photograph was taken in a scene: matches with rendered views, then its colours.

The scene is rendered from training poses that look like the photograph; features that match carry
the rendered distance, so three of them give a pose (P3P in RANSAC), which the colours then refine.
Training poses themselves are starts, too. The start that explains the photograph best wins.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError, SolveError
from gsut.data.images import shrink_image, shrink_mask
from gsut.gaussians import Gaussians, apply_low_pass, find_filter_radii
from gsut.refine.pose import RefinedPose, refine_pose
from gsut.render import place_about, render, to_uint8
from gsut.sfm import PosesOptions
from gsut.sfm.photographs import Features, detect_features, require_central

# Size of the images that views are ranked by, pixels along the shorter side: layout is enough.
_THUMBNAIL = 48
# Standard deviation of the filter that models a thumbnail's pixel, in such pixels.
_PIXEL_BLUR = 0.3
# Number of rendered views that are matched, best ranked first.
_MATCHED_VIEWS = 12
# Alpha from which a rendered distance is that of a surface.
_OPAQUE = 0.8
# Distance of a match that agrees with a pose, in thousandths of the image's diagonal: rendered
# distances are less exact than triangulated ones (1.8 there).
_MAX_ERROR = 4.0
# Matches that must agree with a pose to start from it: chance gives a few.
_FEWEST_MATCHES = 12
# Matches from which no other start is tried, if the colours converge.
_SURE_MATCHES = 40
# Number of training poses tried as starts, best ranked first.
_POSES_TRIED = 3
# Correlation of a photograph's details with the render's from which it counts as found; renders of
# another place reach 0.2.
_LIKENESS = 0.4
# The same if _FEWEST_MATCHES features agree with the pose, which is evidence of its own.
_LIKENESS_WITH_MATCHES = 0.25
# Details are an image of this size (pixels along the shorter side) minus its local mean: coarse
# enough for a pose that is a pixel off.
_DETAIL_SIDE = 120
# Side of the square of that mean, in such pixels: exposure and shading vary over more than this.
_DETAIL_AROUND = 15
# A pose's covariance does not contain the errors of the scene itself. Actual errors are this many
# times the predicted ones if all of a photograph counts ...
_SCENE_ERRORS = 1.7
# ... and grow by this power of the share that counts, as fewer parts of the scene are averaged.
_BY_SHARE = -1 / 3
# Logarithms of the factors on the focal length that are tried.
_FOCAL_STEPS = (-0.12, -0.06, -0.025, 0.025, 0.06, 0.12)


@dataclasses.dataclass(frozen=True)
class Localized:
    """A photograph's pose.

    Attributes:
        pose: refined by its colours.
        start: "matches", or the index of the training view whose pose was the start.
        matches: features of rendered views that agree with the start; 0 for a training pose.
        starts: how many starts were tried.
        likeness: correlation of the photograph's details with the render's, -1 to 1.
        focal_scale: factor on the focal length with which the colours fit best; what the pose moves
            with it is in its covariance.
    """

    pose: RefinedPose
    start: str | int
    matches: int
    starts: int
    likeness: float = 1.0
    focal_scale: float = 1.0


def localize_image(
    gaussians: Gaussians,
    views: Sequence[tuple[_core.Camera, np.ndarray]],
    camera: _core.Camera,
    pixels: np.ndarray,
    mask: np.ndarray,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Localized:
    """Finds the pose of a photograph that may be far from every training view.

    Args:
        gaussians: the scene.
        views: cameras and poses (4, 4) from which the scene is known, those of training.
        camera: lens of the photograph, at its size.
        pixels: (H, W, 3) uint8, the photograph.
        mask: (H, W) bool, False where the photograph does not count.
        background: colour behind everything.
        on_progress: called with (stage, done, total).

    Returns:
        The pose, from the start that explains the photograph best. Its covariance includes errors
        of the scene and, for lenses with fx and fy, an error of the focal length.

    Raises:
        InputError: a lens of the photograph whose rays do not meet in one point.
        SolveError: no start led to a pose, or the best render shows other details than the
            photograph, which then shows another place or was taken through another lens.
    """
    require_central([camera])
    if gaussians.origin.any():
        return _localize_about_origin(
            gaussians, views, camera, pixels, mask, background=background, on_progress=on_progress
        )
    show = on_progress or (lambda what, done, total: None)
    order = _rank_views(gaussians, views, camera, pixels, mask, background, show)
    found = _pose_from_matches(gaussians, views, order, camera, pixels, mask, background, show)
    starts: list[tuple[str | int, np.ndarray, int]] = [] if found is None else [found]
    starts += [(index, views[index][1], 0) for index in order[:_POSES_TRIED]]
    best: Localized | None = None
    for number, (name, pose, matches) in enumerate(starts, start=1):
        show("refining", number, len(starts))
        try:
            refined = refine_pose(gaussians, camera, pose, pixels, mask, background=background)
        except SolveError:
            continue
        if best is None or refined.rms < best.pose.rms:
            best = Localized(refined, name, matches, number)
        if matches >= _SURE_MATCHES and refined.converged:
            break
    if best is None:
        raise SolveError(
            f"none of {len(starts)} starts led to a pose: the photograph shows too little of the "
            "scene"
        )
    likeness = _correlate_details(
        gaussians, camera, best.pose.camera_from_world, pixels, mask, background
    )
    best = dataclasses.replace(best, likeness=likeness)
    with_matches = best.matches >= _FEWEST_MATCHES
    if not likeness >= (_LIKENESS_WITH_MATCHES if with_matches else _LIKENESS):
        raise SolveError(
            "the photograph was not found in the scene: its details correlate with those seen from "
            f"the best of {len(starts)} poses at {likeness:.2f} ({_LIKENESS} is needed, or "
            f"{_LIKENESS_WITH_MATCHES} and {_FEWEST_MATCHES} matches), and {best.matches} features "
            "agree with that pose; it shows another place, or another lens took it"
        )
    return _with_systematic_errors(gaussians, camera, pixels, mask, background, best)


def _correlate_details(
    gaussians: Gaussians,
    camera: _core.Camera,
    pose: np.ndarray,
    pixels: np.ndarray,
    mask: np.ndarray,
    background: Sequence[float],
) -> float:
    """Correlates the details of a photograph with those of the scene rendered from a pose."""
    import cv2

    seen = to_uint8(render(gaussians, camera, pose, background=background).image)
    factor = min(1.0, _DETAIL_SIDE / min(camera.width, camera.height))
    size = [max(1, round(side * factor)) for side in (camera.width, camera.height)]
    valid = shrink_mask(mask & camera.rays()[1], *size).astype(np.float64)
    weight = np.maximum(cv2.blur(valid, (_DETAIL_AROUND, _DETAIL_AROUND)), 1e-9)
    details = []
    for image in (pixels, seen):
        grey = shrink_image(image, *size).astype(np.float64).mean(axis=2) * valid
        around = cv2.blur(grey, (_DETAIL_AROUND, _DETAIL_AROUND)) / weight
        details.append((grey - around)[valid > 0])
    if min(len(details[0]), *(float(np.ptp(each)) for each in details)) == 0:
        return 0.0
    return float(np.corrcoef(*details)[0, 1])


def _with_systematic_errors(
    gaussians: Gaussians,
    camera: Any,
    pixels: np.ndarray,
    mask: np.ndarray,
    background: Sequence[float],
    found: Localized,
) -> Localized:
    """Adds the scene's errors, and the effect of a wrong focal length, to the covariance."""
    pose = found.pose
    share = float(np.mean(mask & camera.rays()[1]))
    covariance = (_SCENE_ERRORS * share**_BY_SHARE) ** 2 * pose.covariance
    best = 0.0
    if camera.param_names.split()[:2] == ["fx", "fy"]:
        tried = {0.0: pose}
        for step in _FOCAL_STEPS:
            params = np.array(camera.params)
            params[:2] *= np.exp(step)
            with contextlib.suppress(InputError, SolveError):
                tried[step] = refine_pose(
                    gaussians, camera.with_params(params), pose.camera_from_world, pixels, mask,
                    background=background, levels=2,
                )  # fmt: skip
        best, moved = _fit_focal_length(tried, pose)
        covariance = covariance + np.outer(moved, moved)
    return dataclasses.replace(
        found,
        pose=dataclasses.replace(pose, covariance=covariance),
        focal_scale=float(np.exp(best)),
    )


def _fit_focal_length(
    tried: dict[float, RefinedPose], pose: RefinedPose
) -> tuple[float, np.ndarray]:
    """Finds the focal length with which colours differ least, and how far the pose moves with it.

    Fits a parabola through the best attempt and its neighbours.

    Returns:
        The logarithm of the factor on the focal length, and (6,) the change of the pose.
    """
    steps = sorted(tried)
    squares = np.array([tried[step].rms ** 2 for step in steps])
    least = int(np.argmin(squares))
    best = steps[least]
    if 0 < least < len(steps) - 1:
        near = slice(least - 1, least + 2)
        bend, slope, _ = np.polyfit(steps[near], squares[near], 2)
        best = float(np.clip(-slope / (2 * bend), steps[least - 1], steps[least + 1]))
    if len(steps) < 2:
        return 0.0, np.zeros(6)
    poses = np.array([_subtract_poses(tried[step], pose) for step in steps])
    return best, np.array([np.interp(best, steps, column) for column in poses.T])


def _subtract_poses(one: RefinedPose, other: RefinedPose) -> np.ndarray:
    """Returns (6,) the change of centre (world axes) and small rotation vector (camera axes)."""
    turn = one.camera_from_world[:3, :3] @ other.camera_from_world[:3, :3].T
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([one.center - other.center, vector / 2])


def _localize_about_origin(
    gaussians: Gaussians,
    views: Sequence[tuple[_core.Camera, np.ndarray]],
    *photograph: Any,
    **settings: Any,
) -> Localized:
    """Runs `localize_image` in coordinates about the Gaussians' origin."""
    origin = gaussians.origin
    near: Any = [(camera, place_about(pose, origin)) for camera, pose in views]
    found = localize_image(gaussians.translate(-origin), near, *photograph, **settings)
    pose: Any = place_about(found.pose.camera_from_world, -origin)
    return dataclasses.replace(found, pose=dataclasses.replace(found.pose, camera_from_world=pose))


def _rank_views(
    gaussians: Gaussians,
    views: Sequence[tuple[_core.Camera, np.ndarray]],
    camera: _core.Camera,
    pixels: np.ndarray,
    mask: np.ndarray,
    background: Sequence[float],
    show: Callable[[str, int, int], None],
) -> list[int]:
    """Ranks views by how well a small render from their pose correlates with the photograph."""
    factor = min(1.0, _THUMBNAIL / min(camera.width, camera.height))
    size = [max(1, round(side * factor)) for side in (camera.width, camera.height)]
    small = camera.resize(*size)
    valid = shrink_mask(mask, *size) & small.rays()[1]
    seen = _normalize_colors(shrink_image(pixels, *size)[valid])
    likeness = []
    for _, pose in views:
        radii = find_filter_radii(gaussians.means, [small], pose[None], _PIXEL_BLUR)
        image = render(apply_low_pass(gaussians, radii), small, pose, background=background).image
        likeness.append(float(np.sum(seen * _normalize_colors(image[valid]))))
        show("looking", len(likeness), len(views))
    return [int(index) for index in np.argsort(-np.array(likeness), kind="stable")]


def _normalize_colors(colors: np.ndarray) -> np.ndarray:
    """Subtracts the mean of colours (n, 3) and scales them to length 1: contrast cancels."""
    centred = colors.astype(np.float64) - colors.mean(axis=0, dtype=np.float64)
    return centred / max(float(np.linalg.norm(centred)), 1e-12)


def _pose_from_matches(
    gaussians: Gaussians,
    views: Sequence[tuple[_core.Camera, np.ndarray]],
    order: Sequence[int],
    camera: _core.Camera,
    pixels: np.ndarray,
    mask: np.ndarray,
    background: Sequence[float],
    show: Callable[[str, int, int], None],
) -> tuple[str, np.ndarray, int] | None:
    """Estimates a pose from features matched to renders, with its inliers; None if too few."""
    options = PosesOptions()
    photograph = detect_features(np.ascontiguousarray(pixels), mask & camera.rays()[1], options)
    if not len(photograph):
        return None
    chosen = list(order[:_MATCHED_VIEWS])
    features, points = [], []
    for number, index in enumerate(chosen, start=1):
        show("matching", number, len(chosen))
        found, places = _detect_rendered_features(gaussians, *views[index], background, options)
        features.append(found)
        points.append(places)
    descriptors = [f.descriptors for f in (photograph, *features)]
    pairs = np.array([(0, number) for number in range(1, len(descriptors))])
    matched = _core.match_pairs(descriptors, pairs, options.max_ratio, options.max_distance)
    rows = np.concatenate([matches[:, 0] for matches in matched]).astype(np.int64)
    places = np.concatenate(
        [points[number][matches[:, 1]] for number, matches in enumerate(matched)]
    )
    bearings = _core.ImageBearings(camera, photograph.pixels)
    good = np.isfinite(places).all(axis=1) & bearings.valid[rows]
    if np.count_nonzero(good) < _FEWEST_MATCHES:
        return None
    max_error = _MAX_ERROR * float(np.hypot(camera.width, camera.height)) / 1000
    pose, inliers = _core.absolute_pose(bearings, rows[good], places[good], max_error, 0)
    agree = len(np.unique(rows[good][inliers]))
    return ("matches", pose, agree) if agree >= _FEWEST_MATCHES else None


def _detect_rendered_features(
    gaussians: Gaussians,
    camera: _core.Camera,
    pose: np.ndarray,
    background: Sequence[float],
    options: PosesOptions,
) -> tuple[Features, np.ndarray]:
    """Detects features of a rendered view; returns them and their points (n, 3), NaN if unknown."""
    result: Any = render(gaussians, camera, pose, background=background)
    _, valid = camera.rays()
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
