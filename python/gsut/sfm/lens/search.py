"""Poses with an unknown lens: of several, the one that predicts held-out observations best."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut._core import Shutter, SolveError
from gsut.lens import Camera, convert_camera
from gsut.sfm.core import (
    Features,
    PairMatches,
    Photographs,
    PosesLog,
    PosesOptions,
    RawMatches,
    Solution,
    choose_connected_pairs,
    keep_most_distinct,
    only_pairs,
    refine,
    require_overlap,
    solve,
    verify,
    why_nothing,
)
from gsut.sfm.lens.candidates import implausible, lens_ladder
from gsut.sfm.lens.ranking import LensRanking, RankedLens
from gsut.sfm.time_left import LensSteps, verifying_seconds

_HOLD_OUT_EVERY = 5  # tracks, of those long enough to spare an observation
# Flags of parameters: held, free by itself, and, of the focal lengths, tied: square pixels.
_HELD, _FREE, _TIED = 0, 1, 2
# Estimated first of a Kannala-Brandt lens: the focal length and k1.
_START = np.array([_TIED, _TIED, 0, 0, _FREE, 0, 0, 0], np.uint8)
# A lens with more parameters must predict held-out observations better by this share: radial
# coefficients, the principal point, and focal lengths that differ, which few lenses have.
_BETTER = 0.005
_BETTER_CENTER = 0.03
_BETTER_ASPECT = 0.05
# Images on which first lenses, and models, are compared: those best connected with each other.
_FIRST_IMAGES = 14
_MODEL_IMAGES = 20
# Matches of a pair that first lenses, and models, are compared by: the most distinct.
_FIRST_MATCHES = 150
_MODEL_MATCHES = 150
# Lenses of the ranking that are reconstructed with: those whose share of agreeing matches is nearly
# the best's, and whose focal length differs from those before by more than a step.
_MOST_FIRST = 3
_NEAR_BEST = 0.96
_SAME_FOCAL = 0.12
# A first lens that all images and this small an error (of the diagonal) confirm: enough tried.
_CONFIRMED = 0.5e-3
# Matches are verified again where the lens' focal length has changed by more.
_VERIFY_AGAIN = 0.03
_PERSPECTIVE_UP_TO = math.radians(50.0)  # from the axis: also tried as a perspective lens
# On the largest error of pairs, of a rolling shutter that a global one stands in for.
_ROLLING_PAIRS = 3.0
_PARTS = 1000  # that progress is told in


@dataclasses.dataclass(frozen=True)
class LensSearch:
    """The solution with the best lens, and what was tried.

    Args:
        solution: with the estimated lens.
        rows: model, parameters, registered, held-out error and rms of each candidate.
        pairs: verified through the lens that the first images gave.
        flags: (K,) of the lens' parameters: 0 held, 1 estimated, equal flags above 1 tied.
    """

    solution: Solution
    rows: list[dict[str, Any]]
    pairs: list[PairMatches]
    flags: np.ndarray


def search_lens(
    photographs: Photographs,
    features: Sequence[Features],
    raw: RawMatches,
    options: PosesOptions,
    fov_degrees: float | None,
    log: PosesLog,
    shutter: Shutter | None = None,
) -> LensSearch:
    """Estimates poses and lens together.

    First lenses (the photographs' candidates, of the database or EXIF, and a ladder of fields of
    view and kinds) are ranked by the
    matches of some pairs that agree through them. With the best of them the focal length and the
    first coefficient are estimated on a few images; then models, and which of their parameters, on
    more images, each from the poses of the first; at last everything with the lens chosen. Pixels
    are square and the principal point is the image's centre unless held-out observations speak
    clearly against it; lenses that no camera has are refused.

    Args:
        photographs: with any guess of this size as lenses.
        features: of the photographs. raw: their matches.
        options: see PosesOptions.
        fov_degrees: rough horizontal field of view, or None.
        log: shown the stage "lens", the trials, then "mapping".
        shutter: rolling, or None.

    Raises:
        SolveError: nothing could be reconstructed with any lens.
    """
    first = photographs.cameras[0]
    assert first is not None
    trials = _Trials(photographs.names, features, options, log.show, shutter, _to_verify(raw))
    ranking = LensRanking(features, raw, options, 1.0 if shutter is None else _ROLLING_PAIRS)
    ladder = lens_ladder(first.width, first.height, fov_degrees)
    ranked = ranking.best(
        photographs.candidates, ladder,
        lambda done, total: trials.tell("first lenses", done / total - trials.steps.part),
    )  # fmt: skip
    pairs = trials.verified(ranked[0].camera, raw)
    trials.tell("pairs")
    require_overlap(photographs.names, features, pairs, known=False)
    try:
        best = _first_solution(trials, raw, pairs, ranked)
        if abs(best.cameras[0].params[0] / ranked[0].camera.params[0] - 1) > _VERIFY_AGAIN:
            pairs = trials.verified(best.cameras[0], raw)
            trials.tell("pairs")
        trials.steps.expect("pairs", 0)
        chosen, flags = _best_model(trials, pairs, best)
        lens = chosen.cameras[0]
        final = solve(
            photographs.names, [lens] * len(photographs), features, pairs, options,
            log.on_images("mapping"),
            lens_free=flags, lens_settled=True, shutter=shutter,
        )  # fmt: skip
    except SolveError as error:
        raise why_nothing(
            error, features, pairs, "give a rough field of view by --fov, or a lens by --camera",
            turned=ranking.only_turned(ladder),
        ) from None  # fmt: skip
    return LensSearch(final, trials.rows, pairs, flags)


def _to_verify(raw: RawMatches) -> float:
    """Seconds that it takes, roughly."""
    return verifying_seconds(len(raw.pairs), sum(map(len, raw.matches)))


def _first_solution(
    trials: _Trials, raw: RawMatches, pairs: Sequence[PairMatches], ranked: Sequence[RankedLens]
) -> Solution:
    """Of the lenses ranked first, the solution of a few images that is best."""
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
            few = trials.verified(lens.camera, only_pairs(raw, wanted))
        solution = trials.solve(
            lens.camera, _START, keep_most_distinct(few, _FIRST_MATCHES), share=lens.share
        )
        tried.append(focal)
        trials.tell("first images")
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
    trials.steps.expect("first images", 0)
    if not found:
        refused = [row["refused"] for row in trials.rows if "refused" in row]
        of_none = f"; the lens found is that of no camera ({refused[0]})" if refused else ""
        raise SolveError(f"no lens tried gives a reconstruction{of_none}")
    return min(found, key=_rank)


def _best_model(
    trials: _Trials, pairs: Sequence[PairMatches], best: Solution
) -> tuple[Solution, np.ndarray]:
    """The lens that predicts held-out observations of more images best, and its flags."""
    images = _FIRST_IMAGES if trials.rolling else _MODEL_IMAGES
    more = keep_most_distinct(choose_connected_pairs(pairs, images), _MODEL_MATCHES)
    start = best if trials.rolling else trials.solve(best.cameras[0], _START, more) or best
    trials.tell("more images")
    chosen: tuple[Solution, np.ndarray] = (start, _START)
    models = _models(start)
    if trials.rolling:  # each trial begins from nothing: the fewest
        models = models[-1:]
    freeing = (((2, 3), _BETTER_CENTER), ((0, 1), _BETTER_ASPECT))
    trials.steps.expect("models", len(models) + len(freeing))
    for flags, model in models:
        found = trials.refine(start, model(start.cameras[0]), flags, more)
        trials.tell("models")
        if found is not None and _is_better(found, chosen[0], _BETTER):
            chosen = found, flags
    for freed, share in freeing:
        flags = chosen[1].copy()
        flags[list(freed)] = _FREE
        found = trials.refine(start, chosen[0].cameras[0], flags, more)
        if found is not None and _is_better(found, chosen[0], share):
            chosen = found, flags
        trials.tell("models")
    return chosen


def _is_better(other: Solution, than: Solution, share: float) -> bool:
    (missing, error), (least, bound) = _rank(other), _rank(than)
    return missing < least or (missing == least and error < (1 - share) * bound)


def _rank(solution: Solution) -> tuple[int, float]:
    """Smaller is better: most images first, then the held-out error."""
    return -solution.num_registered, solution.held_out or math.inf


def _models(start: Solution) -> Sequence[tuple[np.ndarray, Callable[[Camera], Camera]]]:
    """What is estimated of each model to choose from, and the model made of a lens near it."""
    radial = np.array([_TIED, _TIED, 0, 0, 1, 1, 1, 1], np.uint8)
    fisheye = [(np.where(np.arange(8) < 6, radial, 0).astype(np.uint8), _same), (radial, _same)]
    if float(np.max(start.field_angles)) > _PERSPECTIVE_UP_TO:
        return fisheye
    two = np.array([_TIED, _TIED, 0, 0, 1, 1, 0, 0], np.uint8)
    three = np.append(two, _FREE).astype(np.uint8)
    return [(two, _as_opencv4), (three, _as_opencv5), *fisheye]


def _same(lens: Camera) -> Camera:
    return lens


def _as_opencv4(lens: Camera) -> Camera:
    """Without tangential distortion, and square pixels."""
    params = convert_camera(lens, "opencv4").camera.params.copy()
    focal = float(params[:2].mean())
    return Camera(
        "opencv4", [focal, focal, lens.width / 2, lens.height / 2, *params[4:6], 0, 0],
        lens.width, lens.height,
    )  # fmt: skip


def _as_opencv5(lens: Camera) -> Camera:
    return Camera("opencv5", [*_as_opencv4(lens).params, 0.0], lens.width, lens.height)


class _Trials:
    """Solutions with one lens after the other; what came of each is kept in `rows`."""

    def __init__(
        self,
        names: Sequence[str],
        features: Sequence[Features],
        options: PosesOptions,
        show: Callable[[str, int, int, str], None],
        shutter: Shutter | None,
        verifying: float,
    ) -> None:
        self.rows: list[dict[str, Any]] = []
        self.steps = LensSteps(shutter is not None, verifying)
        self._names = names
        self._features = features
        self._options = options
        self._show = show
        self._shutter = shutter
        self._share = 0.0

    @property
    def rolling(self) -> bool:
        """Whether images were read line by line."""
        return self._shutter is not None

    def tell(self, step: str, part: float = 1.0) -> None:
        """A step of `LensSteps`, or a part of one, is done."""
        self._share = self.steps.done(step, part)
        self._show("lens", round(_PARTS * self._share), _PARTS, step)

    def verified(self, lens: Camera, raw: RawMatches) -> list[PairMatches]:
        """Matches verified through a lens."""
        lenses = [lens] * len(self._names)
        return verify(self._features, lenses, raw, self._options, shutter=self._shutter)

    def solve(
        self, lens: Camera, flags: np.ndarray, pairs: Sequence[PairMatches], **row: Any
    ) -> Solution | None:
        """From nothing but matches; None if it fails."""
        return self._kept(
            lens, flags,
            lambda: solve(
                self._names, [lens] * len(self._names), self._features, pairs, self._options,
                self._told, lens_free=flags, hold_out_every=_HOLD_OUT_EVERY, covariances=False,
                shutter=self._shutter,
            ),
            row,
        )  # fmt: skip

    def refine(
        self, start: Solution, lens: Camera, flags: np.ndarray, pairs: Sequence[PairMatches]
    ) -> Solution | None:
        """From the poses of another solution, of all images; None if it fails.

        Images without a pose are left out of what is returned.

        Velocities of a rolling shutter are not known to `refine`: from nothing then.
        """
        if self.rolling:
            return self.solve(lens, flags, pairs)
        chosen = [int(image) for image in np.flatnonzero(start.registered)]
        place = {image: index for index, image in enumerate(chosen)}
        own = [
            dataclasses.replace(pair, first=place[pair.first], second=place[pair.second])
            for pair in pairs
            if pair.first in place and pair.second in place
        ]
        return self._kept(
            lens, flags,
            lambda: refine(
                [self._names[i] for i in chosen], [lens] * len(chosen),
                [self._features[i] for i in chosen], own,
                [start.camera_from_world[i] for i in chosen], self._options,
                self._told, lens_free=flags, hold_out_every=_HOLD_OUT_EVERY, covariances=False,
            ),
        )  # fmt: skip

    def _told(self, done: int, total: int, points: int, step: str) -> None:
        words = f"{done} images, {points:,} points"
        self._show("lens", round(_PARTS * self._share), _PARTS, words)

    def _kept(
        self,
        lens: Camera,
        flags: np.ndarray,
        run: Callable[[], Solution],
        more: dict[str, Any] | None = None,
    ) -> Solution | None:
        row: dict[str, Any] = {
            "model": lens.model,
            "estimated": len(set(flags[flags > 1])) + int((flags == 1).sum()),
            "start": list(map(float, lens.params)),
            **(more or {}),
        }
        self.rows.append(row)
        try:
            found = run()
        except SolveError as error:
            row |= {"registered": 0, "failure": str(error)}
            return None
        row |= {
            "params": list(map(float, found.cameras[0].params)),
            "registered": found.num_registered,
            "points": len(found.points),
            "held_out_px": found.held_out,
            "rms_px": found.rms,
        }
        refused = implausible(found.cameras[0], self._features)
        if refused is None:
            return found
        row["refused"] = refused
        return None
