"""Poses with an unknown lens: of several, the one that predicts held-out observations best."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, Shutter, SolveError
from gsut.data import read_header
from gsut.lens import Camera, convert_camera
from gsut.sfm.features import Features
from gsut.sfm.inputs import Photographs
from gsut.sfm.matching import PairMatches, RawMatches, verify
from gsut.sfm.options import PosesOptions
from gsut.sfm.solution import Solution, refine, solve

# Horizontal fields of view (degrees) that are tried where nothing is known: a phone held upright,
# a phone, a wide action camera.
_FIELDS = (45.0, 65.0, 95.0)
_FISHEYE_FROM = 110.0  # degrees: wider guesses are fisheyes from the start
_DEFAULT_FIELD = 60.0  # of the first matching
_HOLD_OUT_EVERY = 5  # tracks, of those long enough to spare a observation
# Estimated first, of fx fy cx cy and four coefficients: focal lengths and the first coefficient.
_START = np.array([1, 1, 0, 0, 1, 0, 0, 0], bool)
# A lens with more parameters must predict held-out observations better by this share.
_BETTER = 0.005
# Images on which fields of view, and models, are compared: those best connected with each other.
_FIELD_IMAGES = 12
_MODEL_IMAGES = 25
# Matches of a pair that fields, and models, are compared by: the most distinct.
_FIELD_MATCHES = 100
_MODEL_MATCHES = 200


@dataclasses.dataclass(frozen=True)
class LensSearch:
    """The solution with the best lens, and what was tried.

    Args:
        solution: with the estimated lens.
        rows: model, parameters, registered, held-out error and rms of each candidate.
        pairs: verified through the lens that the fields of view gave.
    """

    solution: Solution
    rows: list[dict[str, Any]]
    pairs: list[PairMatches]


def guess_lenses(photographs: Photographs, fov_degrees: float | None) -> Photographs:
    """The photographs with a lens to begin with.

    Raises:
        InputError: images of different sizes (one unknown lens cannot serve both), or a field of
            view that is none.
    """
    sizes: dict[tuple[int, int], Path] = {}
    for path in photographs.paths:
        try:
            header = read_header(path)
        except InputError:
            continue  # unreadable: named already
        sizes.setdefault((header.width, header.height), path)
    if len(sizes) > 1:
        (first, a), (second, b) = list(sizes.items())[:2]
        raise InputError(
            f"the lens is unknown and the images have different sizes: {a.name} is "
            f"{first[0]} x {first[1]}, {b.name} {second[0]} x {second[1]}; give lens files or sort "
            "the images into one folder a camera"
        )
    ((width, height),) = sizes
    guess = guess_lens(width, height, fov_degrees or _DEFAULT_FIELD)
    camera = next(iter(photographs.candidates), guess)
    return dataclasses.replace(photographs, cameras=[camera] * len(photographs))


def guess_lens(width: int, height: int, fov_degrees: float) -> Camera:
    """An undistorted lens of this horizontal field of view: perspective, or equidistant if wide."""
    if not 5 <= fov_degrees <= 300:
        raise InputError(f"--fov takes 5 to 300 degrees, found {fov_degrees:g}")
    half = math.radians(fov_degrees / 2)
    if fov_degrees >= _FISHEYE_FROM:
        focal = width / 2 / half
        return Camera(
            "kannala_brandt", [focal, focal, width / 2, height / 2, 0, 0, 0, 0], width, height
        )
    focal = width / 2 / math.tan(half)
    return Camera("opencv4", [focal, focal, width / 2, height / 2, 0, 0, 0, 0], width, height)


def search_lens(
    photographs: Photographs,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    raw: RawMatches,
    options: PosesOptions,
    fov_degrees: float | None,
    show: Callable[[str, int, int, str], None],
    shutter: Shutter | None = None,
) -> LensSearch:
    """Estimates poses and lens together.

    First the focal length and the first coefficient, from each guess of the field of view, on a few
    images; the matches are verified again through the best; then the models on more images, each
    from the poses of the first; at last all images with the model chosen. All but the last use the
    most distinct matches only.

    Args:
        photographs: with the first guess as lenses.
        features: of the photographs.
        pairs: verified with the first guess.
        raw: the matches before that.
        options: see PosesOptions.
        fov_degrees: rough horizontal field of view, or None.
        show: told (stage, done, total, text): of "lens" the trials, then of "mapping" the images.
        shutter: rolling, or None.

    Raises:
        SolveError: nothing could be reconstructed with any lens.
    """
    first = photographs.cameras[0]
    assert first is not None
    size = first.width, first.height
    fields = (fov_degrees,) if fov_degrees is not None else _FIELDS
    guesses = [guess_lens(*size, field) for field in fields]
    starts = [*photographs.candidates, *([] if photographs.profile else guesses)]
    trials = _Trials(
        photographs.names, features, options, show, shutter,
        planned=len(starts) + len(_models(starts[0])),
    )  # fmt: skip
    candidates = []
    few = keep_most_distinct(choose_connected_pairs(pairs, _FIELD_IMAGES), _FIELD_MATCHES)
    for start in starts:
        found = trials.solve(start, _START, few)
        trials.done += 1
        if found is not None:
            candidates.append(found)
    if not candidates:
        raise SolveError(
            "no lens of the fields of view tried gives a reconstruction; give a rough one with "
            "--fov, or a lens file with --camera"
        )
    best = min(candidates, key=_rank)
    lens = best.cameras[0]
    again = verify(features, [lens] * len(photographs), raw, options, shutter=shutter)
    more = keep_most_distinct(choose_connected_pairs(again, _MODEL_IMAGES), _MODEL_MATCHES)
    results: list[tuple[Solution, np.ndarray]] = []
    for free, made_of in _models(lens):  # fewest parameters first
        found = trials.refine(results[0][0], made_of, free, more) if results else None
        if found is None:
            found = trials.solve(made_of(lens), free, more)
        trials.done += 1
        if found is not None:
            results.append((found, free))
    chosen, free = results[0] if results else (best, _START)
    for other, other_free in results[1:]:
        (missing, error), (least, bound) = _rank(other), _rank(chosen)
        if missing < least or (missing == least and error < (1 - _BETTER) * bound):
            chosen, free = other, other_free
    # The lens is chosen: now with every observation.
    lens = chosen.cameras[0]
    final = solve(
        photographs.names, [lens] * len(photographs), features, again, options,
        lambda done, total, points, step: show("mapping", done, total, f"{points:,} points"),
        lens_free=free, lens_settled=True, shutter=shutter,
    )  # fmt: skip
    return LensSearch(final, trials.rows, again)


def keep_most_distinct(pairs: Sequence[PairMatches], most: int) -> list[PairMatches]:
    """The pairs with their most distinct matches, which stand first."""
    return [
        pair
        if len(pair.matches) <= most
        else dataclasses.replace(
            pair,
            matches=pair.matches[:most],
            rotation_matches=round(pair.rotation_matches * most / len(pair.matches)),
        )
        for pair in pairs
    ]


def choose_connected_pairs(pairs: Sequence[PairMatches], most: int) -> list[PairMatches]:
    """The pairs among `most` images: the best pair's, then always the one with most matches."""
    matches: dict[int, dict[int, int]] = {}
    for pair in pairs:
        matches.setdefault(pair.first, {})[pair.second] = len(pair.matches)
        matches.setdefault(pair.second, {})[pair.first] = len(pair.matches)
    if len(matches) <= most:
        return list(pairs)
    start = max(pairs, key=lambda pair: len(pair.matches) * min(pair.parallax, 0.35))
    chosen = {start.first, start.second}
    while len(chosen) < most:
        links = {
            image: sum(count for other, count in found.items() if other in chosen)
            for image, found in matches.items()
            if image not in chosen
        }
        chosen.add(max(links, key=lambda image: links[image]))
    return [pair for pair in pairs if pair.first in chosen and pair.second in chosen]


def _models(lens: Camera) -> list[tuple[np.ndarray, Callable[[Camera], Camera]]]:
    """What is estimated of each model to choose from, and the model made of a lens near it."""
    everything = np.ones(8, bool)
    if lens.model == "kannala_brandt":
        return [(everything, lambda found: found)]
    size = lens.width, lens.height
    return [
        (np.array([1, 1, 0, 0, 1, 1, 0, 0], bool), lambda found: found),
        (everything, lambda found: found),
        (np.ones(9, bool), lambda found: Camera("opencv5", [*found.params, 0.0], *size)),
        (everything, lambda found: convert_camera(found, "kannala_brandt").camera),
    ]


class _Trials:
    """Solutions with one lens after the other; what came of each is kept in `rows`."""

    def __init__(
        self,
        names: Sequence[str],
        features: Sequence[Features],
        options: PosesOptions,
        show: Callable[[str, int, int, str], None],
        shutter: Shutter | None,
        planned: int,
    ) -> None:
        self.rows: list[dict[str, Any]] = []
        self.done = 0  # of those planned
        self._planned = planned
        self._names = names
        self._features = features
        self._options = options
        self._show = show
        self._shutter = shutter

    def solve(
        self, lens: Camera, free: np.ndarray, pairs: Sequence[PairMatches]
    ) -> Solution | None:
        """From nothing but matches; None if it fails."""
        return self._kept(
            lens, free,
            lambda: solve(
                self._names, [lens] * len(self._names), self._features, pairs, self._options,
                self._told(lens), lens_free=free, hold_out_every=_HOLD_OUT_EVERY,
                shutter=self._shutter,
            ),
        )  # fmt: skip

    def refine(
        self, start: Solution, model: Callable[[Camera], Camera], free: np.ndarray,
        pairs: Sequence[PairMatches],
    ) -> Solution | None:  # fmt: skip
        """From the poses and the lens of another solution; None if it fails.

        Velocities of a rolling shutter are not known to `refine`: None then, too.
        """
        if self._shutter is not None:
            return None
        lens = model(start.cameras[0])
        chosen = [int(image) for image in np.flatnonzero(start.registered)]
        place = {image: index for index, image in enumerate(chosen)}
        own = [
            dataclasses.replace(pair, first=place[pair.first], second=place[pair.second])
            for pair in pairs
            if pair.first in place and pair.second in place
        ]
        return self._kept(
            lens, free,
            lambda: refine(
                [self._names[i] for i in chosen], [lens] * len(chosen),
                [self._features[i] for i in chosen], own,
                [start.camera_from_world[i] for i in chosen], self._options,
                self._told(lens), lens_free=free, hold_out_every=_HOLD_OUT_EVERY,
            ),
        )  # fmt: skip

    def _told(self, lens: Camera) -> Callable[[int, int, int, str], None]:
        return lambda done, total, points, step: self._show(
            "lens", self.done, self._planned, f"{lens.model}: {done} images, {points:,} points"
        )

    def _kept(self, lens: Camera, free: np.ndarray, run: Callable[[], Solution]) -> Solution | None:
        row: dict[str, Any] = {"model": lens.model, "estimated": int(free.sum())}
        try:
            found = run()
        except SolveError as error:
            self.rows.append({**row, "registered": 0, "failure": str(error)})
            return None
        self.rows.append(
            {
                **row,
                "params": list(map(float, found.cameras[0].params)),
                "registered": found.num_registered,
                "points": len(found.points),
                "held_out_px": found.held_out,
                "rms_px": found.rms,
            }
        )
        return found


def _rank(solution: Solution) -> tuple[int, float]:
    """Smaller is better: most images first, then the held-out error."""
    return -solution.num_registered, solution.held_out or math.inf
