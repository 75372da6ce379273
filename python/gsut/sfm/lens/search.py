"""Searches the lens through which the matches of some images agree best, and all poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.judge import KEPT
from gsut.lens import Camera, convert_camera
from gsut.sampling import ENOUGH_PICTURES
from gsut.sfm.lens.candidates import list_lens_ladder
from gsut.sfm.lens.ranking import ROUGH, LensRanking, RankedLens
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import (
    PairMatches,
    choose_connected_pairs,
    explain_failure,
    keep_most_distinct,
    require_overlap,
    select_pairs,
    verify_matches,
)
from gsut.sfm.photographs import MOST_TRIED, SAME_FOCAL
from gsut.sfm.solution import Adjustment, LensFlag, Solution, solve_poses

# Estimated first of a Kannala-Brandt lens: the focal length and k1.
_FOCAL = [LensFlag.TIED, LensFlag.TIED, 0, 0]
START = np.array([*_FOCAL, LensFlag.FREE, 0, 0, 0], np.uint8)
# Estimated of all images: of a perspective lens k1 and k2, of a fisheye k1 to k4.
_PERSPECTIVE = np.array([*_FOCAL, *[LensFlag.FREE] * 2, 0, 0], np.uint8)
_FISHEYE = np.array([*_FOCAL, *[LensFlag.FREE] * 4], np.uint8)
# Images, best connected with each other, on which the first lenses are compared.
FIRST_IMAGES = ENOUGH_PICTURES
# Median error over the diagonal that confirms a first lens if all images are registered.
_CONFIRMED = 0.5e-3
_VERIFY_AGAIN = 0.03  # relative change of the focal length after which matches are verified again
_PERSPECTIVE_UP_TO = math.radians(50.0)  # from the axis
ADVICE = "give a rough field of view by --fov, or a lens by --camera"


def search_lens(mapping: Mapping) -> Mapping:
    """Estimates poses and the one lens of all photographs together.

    Args:
        mapping: photographs with any guess of their size as lenses, features and raw matches.

    Returns:
        The run with solution, verified pairs and `lens_free`.

    Raises:
        SolveError: nothing could be reconstructed with any lens.
    """
    lens, flags, pairs = choose_lens(mapping)
    try:
        solution = mapping.solve(mapping.images.with_lens(lens), pairs, flags, lens_settled=True)
    except SolveError as error:
        raise explain_failure(error, mapping.features, pairs, ADVICE) from None
    return mapping.replace(solution=solution, pairs=pairs, lens_free=flags)


def choose_lens(mapping: Mapping) -> tuple[Camera, np.ndarray, list[PairMatches]]:
    """Estimates the one lens of all photographs from some of them.

    First lenses (the photographs' candidates of the database or EXIF, and a ladder of fields of
    view and kinds) are ranked by the matches of some pairs that agree through them. With the best
    of them the focal length and the first coefficient are estimated on a few images. Pixels are
    square, and the principal point is the image's centre. Further coefficients are estimated with
    all images, near what `find_lens_prior` says.

    Returns:
        The lens, flags of its estimated parameters (see `Adjustment`), and the pairs of all
        photographs verified through a lens near it.

    Raises:
        SolveError: see `search_lens`.
    """
    first, raw, log = mapping.photographs.lenses[0], mapping.raw, mapping.log
    factor = 1.0 if mapping.shutter is None else ROUGH
    ranking = LensRanking(mapping.features, raw, mapping.options, factor)
    ladder = list_lens_ladder(first.width, first.height, mapping.options.fov)
    ranked = ranking.rank_lenses(
        mapping.photographs.candidates, ladder,
        lambda done, total: log.show_share("lens", 0.25 * done / total, "first lenses"),
    )  # fmt: skip
    pairs = _verify(mapping, ranked[0].camera)
    require_overlap(mapping.images, pairs, is_lens_known=False)
    try:
        best = _solve_first_images(mapping, pairs, ranked)
    except SolveError as error:
        raise explain_failure(error, mapping.features, pairs, ADVICE) from None
    if abs(best.cameras[0].params[0] / ranked[0].camera.params[0] - 1) > _VERIFY_AGAIN:
        pairs = _verify(mapping, best.cameras[0])
    return *_choose_model(best), pairs


def _solve_first_images(
    mapping: Mapping, pairs: Sequence[PairMatches], ranked: Sequence[RankedLens]
) -> Solution:
    """Reconstructs a few images with the lenses ranked first; returns the best solution."""
    few = choose_connected_pairs(pairs, FIRST_IMAGES)
    wanted = {(pair.first, pair.second) for pair in few}
    found: list[Solution] = []
    tried: list[float] = []
    for number, lens in enumerate(ranked):
        focal = float(lens.camera.params[0])
        known = any(abs(math.log(focal / other)) < SAME_FOCAL for other in tried)
        if known or (found and lens.share < KEPT * ranked[0].share):
            continue
        if len(tried) == MOST_TRIED:
            break
        if number:
            few = _verify(mapping, lens.camera, wanted)
        solution = _try_lens(mapping, lens.camera, keep_most_distinct(few))
        tried.append(focal)
        if solution is None:
            continue
        found.append(solution)
        size = math.hypot(lens.camera.width, lens.camera.height)
        images = len({image for pair in few for image in (pair.first, pair.second)})
        if solution.num_registered == images and solution.median < _CONFIRMED * size:
            break
    if not found:
        raise SolveError("no lens tried gives a reconstruction")
    return max(found, key=lambda each: (each.num_registered, len(each.observations)))


def _choose_model(best: Solution) -> tuple[Camera, np.ndarray]:
    """Chooses the model of the lens by how far from the axis images reach, and its flags."""
    lens = best.cameras[0]
    if float(np.max(best.field_angles)) > _PERSPECTIVE_UP_TO:
        return lens, _FISHEYE
    params = convert_camera(lens, "opencv4").camera.params
    focal = float(params[:2].mean())
    return Camera(
        "opencv4", [focal, focal, lens.width / 2, lens.height / 2, *params[4:6], 0, 0],
        lens.width, lens.height,
    ), _PERSPECTIVE  # fmt: skip


def _verify(
    mapping: Mapping, lens: Camera, wanted: set[tuple[int, int]] | None = None
) -> list[PairMatches]:
    """Verifies the matches of all pairs, or of those wanted, through a lens."""
    raw = mapping.raw if wanted is None else select_pairs(mapping.raw, wanted)
    return verify_matches(mapping.images.with_lens(lens), raw, mapping.options)


def _try_lens(mapping: Mapping, lens: Camera, pairs: Sequence[PairMatches]) -> Solution | None:
    """Reconstructs from nothing but matches with the lens free; None where that fails."""

    def show(done: int, total: int, points: int, step: str) -> None:
        text = f"{done} images, {points:,} points"
        mapping.log.show_share("lens", 0.25 + 0.5 * done / total, text)

    images, adjustment = mapping.images.with_lens(lens), Adjustment(START, covariances=False)
    try:
        return solve_poses(images, pairs, mapping.options, show, adjustment)
    except SolveError:
        return None
