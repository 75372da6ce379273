"""Searches the lens that predicts held-out observations best, together with the poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import SolveError
from gsut.lens import Camera, convert_camera
from gsut.sfm.lens.candidates import FREE, TIED, explain_implausible, list_lens_ladder
from gsut.sfm.lens.ranking import LensRanking, RankedLens
from gsut.sfm.lens.trials import run_trials
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import (
    PairMatches,
    choose_connected_pairs,
    explain_failure,
    keep_most_distinct,
    require_overlap,
    select_pairs,
    select_verified_pairs,
    verify_matches,
)
from gsut.sfm.solution import (
    Adjustment,
    OnStep,
    Solution,
    adjust_poses,
    solve_poses,
)

_HOLD_OUT_EVERY = 5  # tracks, of those long enough to spare an observation
# Estimated first of a Kannala-Brandt lens: the focal length and k1.
START = np.array([TIED, TIED, 0, 0, FREE, 0, 0, 0], np.uint8)
_ASPECT = (0, 1)  # parameters: the focal lengths
# Share by which a lens with more parameters must predict held-out observations better.
_BETTER = 0.005  # for more radial coefficients
_BETTER_ASPECT = 0.05  # for focal lengths that differ, which few lenses have
_FEW_IMAGES = 10  # up to which the median of the held-out errors is of few observations
# Standard deviations of the difference of two such medians, relative 1 / sqrt(observations), by
# which more coefficients must then predict better.
_SURE = 2.0
_FIRST_IMAGES = 14  # best connected with each other, on which the first lenses are compared
_MODEL_IMAGES = 20  # best connected with each other, on which models are compared
_MOST_FIRST = 3  # lenses of the ranking that are reconstructed with
_NEAR_BEST = 0.96  # share of the best lens' score that such a lens must have
_SAME_FOCAL = 0.12  # difference of the logarithms of focal lengths that are not both tried
# Median held-out error over the diagonal that confirms a first lens if all images are registered.
_CONFIRMED = 0.5e-3
_VERIFY_AGAIN = 0.03  # relative change of the focal length after which matches are verified again
_PERSPECTIVE_UP_TO = math.radians(50.0)  # from the axis: perspective lenses are tried too
ADVICE = "give a rough field of view by --fov, or a lens by --camera"
# Factor on the largest error of pairs where a global shutter stands in for a rolling one.
_ROLLING_PAIRS = 3.0


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
        solution = solve_poses(
            mapping.images.with_lens(lens), pairs, mapping.options,
            mapping.log.follow_steps("mapping"),
            Adjustment(flags, lens_settled=True),
        )  # fmt: skip
    except SolveError as error:
        raise explain_failure(error, mapping.features, pairs, ADVICE) from None
    return mapping.replace(solution=solution, pairs=pairs, lens_free=flags)


def choose_lens(mapping: Mapping) -> tuple[Camera, np.ndarray, list[PairMatches]]:
    """Estimates the one lens of all photographs from some of them.

    First lenses (the photographs' candidates of the database or EXIF, and a ladder of fields of
    view and kinds) are ranked by the matches of some pairs that agree through them. With the best
    of them the focal length and the first coefficient are estimated on a few images; then models,
    and which of their parameters, on more images, each from the poses of the first. Pixels are
    square unless held-out observations speak clearly against it, and the principal point is the
    image's centre; impossible lenses are rejected.

    Returns:
        The lens, flags of its estimated parameters (see `Adjustment`), and the pairs of all
        photographs verified through a lens near it.

    Raises:
        SolveError: see `search_lens`.
    """
    first, raw, log = mapping.photographs.lenses[0], mapping.raw, mapping.log
    trials = _Trials(mapping)
    factor = 1.0 if mapping.shutter is None else _ROLLING_PAIRS
    ranking = LensRanking(mapping.features, raw, mapping.options, factor)
    ladder = list_lens_ladder(first.width, first.height, mapping.options.fov)
    ranked = ranking.rank_lenses(
        mapping.photographs.candidates, ladder,
        lambda done, total: log.show_share("lens", 0.25 * done / total, "first lenses"),
    )  # fmt: skip
    pairs = trials.verify(ranked[0].camera)
    require_overlap(mapping.images, pairs, is_lens_known=False)
    try:
        best = _solve_first_images(trials, pairs, ranked)
        if abs(best.cameras[0].params[0] / ranked[0].camera.params[0] - 1) > _VERIFY_AGAIN:
            pairs = trials.verify(best.cameras[0])
        log.show_share("lens", 0.5, "models")
        chosen, flags = _choose_model(trials, pairs, best)
    except SolveError as error:
        raise explain_failure(error, mapping.features, pairs, ADVICE) from None
    return chosen.cameras[0], flags, pairs


def _solve_first_images(
    trials: _Trials, pairs: Sequence[PairMatches], ranked: Sequence[RankedLens]
) -> Solution:
    """Reconstructs a few images with the lenses ranked first; returns the best solution."""
    few = choose_connected_pairs(pairs, _FIRST_IMAGES)
    wanted = {(pair.first, pair.second) for pair in few}
    found: list[Solution] = []
    tried: list[float] = []
    for number, lens in enumerate(ranked):
        focal = float(lens.camera.params[0])
        known = any(abs(math.log(focal / other)) < _SAME_FOCAL for other in tried)
        if known or (found and lens.share < _NEAR_BEST * ranked[0].share):
            continue
        if len(tried) == _MOST_FIRST:
            break
        if number:
            few = trials.verify(lens.camera, wanted)
        solution = trials.solve(lens.camera, START, keep_most_distinct(few))
        tried.append(focal)
        if solution is None:
            continue
        found.append(solution)
        size = math.hypot(lens.camera.width, lens.camera.height)
        images = len({image for pair in few for image in (pair.first, pair.second)})
        if (
            solution.num_registered == images
            and (solution.held_out or math.inf) < _CONFIRMED * size
        ):
            break
    if not found:
        refused = trials.refused
        of_none = f"; the lens found is that of no camera ({refused[0]})" if refused else ""
        raise SolveError(f"no lens tried gives a reconstruction{of_none}")
    return min(found, key=_rank_solution)


def _choose_model(
    trials: _Trials, pairs: Sequence[PairMatches], best: Solution
) -> tuple[Solution, np.ndarray]:
    """Chooses the model that predicts held-out observations of more images best, with its flags."""
    images = _FIRST_IMAGES if trials.is_rolling else _MODEL_IMAGES
    more = keep_most_distinct(choose_connected_pairs(pairs, images))
    start = best if trials.is_rolling else trials.solve(best.cameras[0], START, more) or best
    chosen: tuple[Solution, np.ndarray] = (start, START)
    models = _list_models(start)
    if trials.is_rolling:  # each trial starts from nothing: only the last model, the most general
        models = models[-1:]
    lens, better = start.cameras[0], _BETTER  # than one coefficient
    if start.num_registered <= _FEW_IMAGES:
        better = max(better, _SURE / math.sqrt(max(1, len(start.held_out_observations))))
    found = trials.adjust(start, [(model(lens), flags) for flags, model in models], more)
    for (flags, _), solution in zip(models, found, strict=True):
        if solution is None or not _is_better(solution, start, better):
            continue
        if _is_better(solution, chosen[0], _BETTER):
            chosen = solution, flags
    trials.share = 0.75
    lens, flags = chosen[0].cameras[0], chosen[1].copy()
    flags[list(_ASPECT)] = FREE
    (stretched,) = trials.adjust(start, [(lens, flags)], more)
    if stretched is None or not _is_better(stretched, start, better):
        return chosen
    return (stretched, flags) if _is_better(stretched, chosen[0], _BETTER_ASPECT) else chosen


def _is_better(other: Solution, than: Solution, share: float) -> bool:
    (missing, error), (least, bound) = _rank_solution(other), _rank_solution(than)
    return missing < least or (missing == least and error < (1 - share) * bound)


def _rank_solution(solution: Solution) -> tuple[int, float]:
    """Returns a key that is smaller for more images, then for a smaller held-out error."""
    return -solution.num_registered, solution.held_out or math.inf


def _list_models(start: Solution) -> Sequence[tuple[np.ndarray, Callable[[Camera], Camera]]]:
    """Lists the flags of the models to choose from, and how each is made of a lens near it."""
    radial = np.array([TIED, TIED, 0, 0, 1, 1, 1, 1], np.uint8)
    fewer = np.where(np.arange(8) < 6, radial, 0).astype(np.uint8)
    fisheye = [(fewer, _keep_lens), (radial, _keep_lens)]
    if float(np.max(start.field_angles)) > _PERSPECTIVE_UP_TO:
        return fisheye
    two = np.array([TIED, TIED, 0, 0, 1, 1, 0, 0], np.uint8)
    three = np.append(two, FREE).astype(np.uint8)
    return [(two, _convert_to_opencv4), (three, _convert_to_opencv5), *fisheye]


def _keep_lens(lens: Camera) -> Camera:
    return lens


def _convert_to_opencv4(lens: Camera) -> Camera:
    """Converts a lens to opencv4 without tangential distortion and with square pixels."""
    params = convert_camera(lens, "opencv4").camera.params.copy()
    focal = float(params[:2].mean())
    return Camera(
        "opencv4", [focal, focal, lens.width / 2, lens.height / 2, *params[4:6], 0, 0],
        lens.width, lens.height,
    )  # fmt: skip


def _convert_to_opencv5(lens: Camera) -> Camera:
    return Camera("opencv5", [*_convert_to_opencv4(lens).params, 0.0], lens.width, lens.height)


_Trial = Callable[[OnStep], Solution | None]


class _Trials:
    """Solutions with one lens after the other.

    Attributes:
        refused: why lenses that trials found are those of no camera.
        share: of the search that is done.
    """

    def __init__(self, mapping: Mapping) -> None:
        self.refused: list[str] = []
        self.share = 0.25
        self._mapping = mapping

    @property
    def is_rolling(self) -> bool:
        """Whether images were read line by line."""
        return self._mapping.shutter is not None

    def verify(self, lens: Camera, wanted: set[tuple[int, int]] | None = None) -> list[PairMatches]:
        """Verifies the matches of all pairs, or of those wanted, through a lens."""
        own = self._mapping
        raw = own.raw if wanted is None else select_pairs(own.raw, wanted)
        return verify_matches(own.images.with_lens(lens), raw, own.options)

    def solve(
        self, lens: Camera, flags: np.ndarray, pairs: Sequence[PairMatches]
    ) -> Solution | None:
        """Reconstructs from nothing but matches; None if that fails."""
        return self._prepare_solve(lens, flags, pairs)(self._show)

    def adjust(
        self,
        start: Solution,
        models: Sequence[tuple[Camera, np.ndarray]],
        pairs: Sequence[PairMatches],
    ) -> list[Solution | None]:
        """Adjusts the poses of another solution with each lens and its flags; None if that fails.

        Images without a pose are left out. With a rolling shutter the images are reconstructed from
        nothing, as their velocities are not known.
        """
        trials = [
            self._prepare_solve(lens, flags, pairs)
            if self.is_rolling
            else self._prepare_adjustment(lens, flags, pairs, start)
            for lens, flags in models
        ]
        return run_trials(trials, self._show)

    def _prepare_solve(
        self, lens: Camera, flags: np.ndarray, pairs: Sequence[PairMatches]
    ) -> _Trial:
        images, options = self._mapping.images.with_lens(lens), self._mapping.options
        adjustment = Adjustment(flags, hold_out_every=_HOLD_OUT_EVERY, covariances=False)
        return self._prepare(
            lambda on_step: solve_poses(images, pairs, options, on_step, adjustment)
        )

    def _prepare_adjustment(
        self, lens: Camera, flags: np.ndarray, pairs: Sequence[PairMatches], start: Solution
    ) -> _Trial:
        chosen = np.flatnonzero(start.registered)
        images, options = self._mapping.images.with_lens(lens).select(chosen), self._mapping.options
        own = select_verified_pairs(pairs, chosen)
        poses = [start.camera_from_world[i] for i in chosen]
        adjustment = Adjustment(flags, hold_out_every=_HOLD_OUT_EVERY, covariances=False)
        return self._prepare(
            lambda on_step: adjust_poses(images, own, poses, options, on_step, adjustment)
        )

    def _show(self, done: int, total: int, points: int, step: str) -> None:
        text = f"{done} images, {points:,} points"
        self._mapping.log.show_share("lens", self.share, text)

    def _prepare(self, run: Callable[[OnStep], Solution]) -> _Trial:
        """Returns what runs a trial; None where it fails, or finds the lens of no camera."""

        def try_lens(on_step: OnStep) -> Solution | None:
            try:
                found = run(on_step)
            except SolveError:
                return None
            reason = explain_implausible(found.cameras[0], self._mapping.features)
            if reason is None:
                return found
            self.refused.append(reason)
            return None

        return try_lens
