"""Where a photograph was taken in a scene: matches with rendered views, then its colours.

The scene is rendered from training poses that look like the photograph; features that match carry
the rendered distance, so three of them give a pose (P3P in RANSAC), which the colours then refine.
Training poses themselves are starts, too. The start that explains the photograph best wins.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import Shutter, SolveError
from gsut.bounds import name_wrong_kinds
from gsut.data.images import shrink_image, shrink_mask
from gsut.data.poses import find_centers
from gsut.gaussians import Gaussians
from gsut.lens import measure_pixel_angle
from gsut.refine.agreement import measure_agreement
from gsut.refine.matched_views import SURE_MATCHES, Start, find_pose_by_matches
from gsut.refine.pose import PIXEL_BLUR, RefinedPose
from gsut.refine.query import Query
from gsut.refine.secants import place_lines
from gsut.render import PixelFilter, place_about, render, to_uint8
from gsut.sfm.photographs import require_central

# Size of the images that views are ranked by, pixels along the shorter side: layout is enough.
_THUMBNAIL = 48
# Gaussians that thumbnails are drawn with, about, at most: layout needs no more.
_THUMBNAIL_GAUSSIANS = 50_000
# Number of training poses tried as starts, best ranked first.
_POSES_TRIED = 3
# Share of a photograph's parts that must lie where the scene shows them: most, since in a small
# picture many fit by chance.
_LEAST_AGREEMENT = 0.5


@dataclasses.dataclass(frozen=True)
class Localized:
    """A photograph's pose.

    Attributes:
        pose: refined by its colours.
        start: "matches", or the index of the training view whose pose was the start.
        matches: features of rendered views that agree with the start; 0 for a training pose.
        starts: how many starts were tried.
        agreement: share of the photograph's parts that lie where the scene shows them, 0 to 1.
        focal_scale: factor on the focal length with which the colours fit best; what the pose moves
            with it is in its covariance.
        shutter_source: "given"; "picture": lines that move with the camera are beyond doubt, or the
            picture shows no such motion; "undetermined": it may, and the covariance says how far
            the pose moves with it.
    """

    pose: RefinedPose
    start: str | int
    matches: int
    starts: int
    agreement: float = 1.0
    focal_scale: float = 1.0
    shutter_source: str = "given"


@name_wrong_kinds
def localize_image(
    gaussians: Gaussians,
    views: Sequence[tuple[_core.Camera, np.ndarray]],
    camera: _core.Camera,
    pixels: np.ndarray,
    mask: np.ndarray,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    shutter: Shutter | None = None,
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
        shutter: how the photograph's lines were read; None: found from the photograph.
        on_progress: called with (stage, done, total).

    Returns:
        The pose, from the start that explains the photograph best. Its covariance includes errors
        of the scene and, for lenses with fx and fy, an error of the focal length.

    Raises:
        InputError: a lens of the photograph whose rays do not meet in one point.
        SolveError: no start led to a pose, or most parts of the photograph lie elsewhere in the
            best render: it shows another place or was taken through another lens.
    """
    require_central([camera])
    if gaussians.origin.any():
        return _localize_about_origin(
            gaussians, views, camera, pixels, mask, background=background, shutter=shutter,
            on_progress=on_progress,
        )  # fmt: skip
    show = on_progress or (lambda what, done, total: None)
    order = _rank_views(gaussians, views, camera, pixels, mask, background, show)
    found = find_pose_by_matches(
        gaussians, views, order, camera, pixels, mask, background, shutter, show
    )
    starts = [] if found is None else [found]
    starts += [Start(index, views[index][1]) for index in order[:_POSES_TRIED]]
    query = Query.prepare(gaussians, camera, pixels, mask, background)
    best, number = _choose_start(query, starts, show)
    show("refining", len(starts), len(starts) + 1)
    fine, shutter, source = query.refine_lines(best.pose, shutter, best.motion)
    seen = render(
        gaussians, camera, place_lines(fine.camera_from_world, fine.motion, shutter),
        background=background,
    )  # fmt: skip
    agreement = measure_agreement(pixels, to_uint8(seen.image), query.valid)
    if not agreement >= _LEAST_AGREEMENT:
        raise SolveError(
            f"the photograph was not found in the scene: from the best of {len(starts)} poses, "
            f"{agreement:.0%} of its parts lie where the scene shows them ({_LEAST_AGREEMENT:.0%} "
            f"are needed), and {best.matches} features agree with that pose; it shows another "
            "place, or another lens took it"
        )
    refined, focal_scale = query.add_systematic_errors(fine, shutter, source)
    show("refining", len(starts) + 1, len(starts) + 1)
    return Localized(refined, best.name, best.matches, number, agreement, focal_scale, source)


def _choose_start(
    query: Query, starts: list[Start], show: Callable[[str, int, int], None]
) -> tuple[Start, int]:
    """Refines starts with the smaller photograph; returns the best pose, and how many were tried.

    A start with motion stays as it is: a global pose would only be worse.
    """
    best, least = None, np.inf
    for number, start in enumerate(starts, start=1):
        show("refining", number, len(starts) + 1)
        if start.motion is not None:
            return start, number
        try:
            coarse = query.refine_smaller(start.pose)
        except SolveError:
            continue
        if best is None or coarse.rms < least:
            least = coarse.rms
            best = dataclasses.replace(start, pose=coarse.camera_from_world), number
        if start.matches >= SURE_MATCHES and coarse.converged:
            break
    if best is None:
        raise SolveError(
            f"none of {len(starts)} starts led to a pose: the photograph shows too little of the "
            "scene"
        )
    return best


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
    angle = measure_pixel_angle(small)
    thin = _thin_out(gaussians)
    likeness = []
    for _, pose in views:
        away = np.linalg.norm(thin.means - find_centers(pose[None])[0], axis=1)
        wide = PixelFilter.widen_by(thin, (PIXEL_BLUR * angle * away) ** 2, pose)
        image = render(wide, small, pose, background=background).image
        likeness.append(float(np.sum(seen * _normalize_colors(image[valid]))))
        show("looking", len(likeness), len(views))
    return [int(index) for index in np.argsort(-np.array(likeness), kind="stable")]


def _thin_out(gaussians: Gaussians) -> Gaussians:
    """Keeps one Gaussian of several, with the area of all of them.

    Cook, Halstead, Planck, Ryu, "Stochastic simplification of aggregate detail", 2007.
    """
    several = max(1, len(gaussians) // _THUMBNAIL_GAUSSIANS)
    kept = gaussians[::several]
    wider = kept.log_scales + kept.log_scales.dtype.type(np.log(several) / 2)
    return dataclasses.replace(kept, log_scales=wider)


def _normalize_colors(colors: np.ndarray) -> np.ndarray:
    """Subtracts the mean of colours (n, 3) and scales them to length 1: contrast cancels."""
    centred = colors.astype(np.float64) - colors.mean(axis=0, dtype=np.float64)
    return centred / max(float(np.linalg.norm(centred)), 1e-12)
