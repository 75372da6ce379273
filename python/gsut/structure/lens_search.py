"""Poses with an unknown lens: several lenses are tried; what predicts held-out sights best wins."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, Shutter, SolveError
from gsut.cameras import Camera
from gsut.data.images import read_header
from gsut.structure.features import Features
from gsut.structure.inputs import Photographs
from gsut.structure.matching import PairMatches, match_and_verify
from gsut.structure.options import PosesOptions
from gsut.structure.solution import Solution, solve

# Horizontal fields of view (degrees) that are tried where nothing is known: a phone held upright,
# a phone, a wide action camera.
_FIELDS = (45.0, 65.0, 95.0)
_FISHEYE_FROM = 110.0  # degrees: wider guesses are fisheyes from the start
_DEFAULT_FIELD = 60.0  # of the first matching
_HOLD_OUT_EVERY = 5  # tracks, of those long enough to spare a sight
# Estimated first, of fx fy cx cy and four coefficients: focal lengths and the first coefficient.
_START = np.array([1, 1, 0, 0, 1, 0, 0, 0], bool)
# A lens with more parameters must predict held-out sights better by this share.
_BETTER = 0.005
# Images on which fields of view, and models, are compared: those best connected with each other.
_FIELD_IMAGES = 12
_MODEL_IMAGES = 25


@dataclasses.dataclass(frozen=True)
class LensSearch:
    """The solution with the best lens, and what was tried.

    Args:
        solution: with the estimated lens.
        rows: model, parameters, registered, held-out error and rms of each candidate.
    """

    solution: Solution
    rows: list[dict[str, Any]]


def first_guess(photographs: Photographs, fov_degrees: float | None) -> Photographs:
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
    camera = guessed_lens(width, height, fov_degrees or _DEFAULT_FIELD)
    return dataclasses.replace(photographs, cameras=[camera] * len(photographs))


def guessed_lens(width: int, height: int, fov_degrees: float) -> Camera:
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
    options: PosesOptions,
    fov_degrees: float | None,
    show: Callable[[str, int, int, str], None],
    shutter: Shutter | None = None,
) -> LensSearch:
    """Estimates poses and lens together.

    First the focal length and the first coefficient, from each guess of the field of view, on a few
    images; the matches are verified again through the best; then the models on more images; at last
    all images with the model chosen.

    Args:
        photographs: with the first guess as lenses.
        features, pairs: of the photographs; pairs verified with the first guess.
        options: see PosesOptions.
        fov_degrees: rough horizontal field of view, or None.
        show: told (stage, done, total, text).
        shutter: rolling, or None.

    Raises:
        SolveError: nothing could be reconstructed with any lens.
    """
    first = photographs.cameras[0]
    assert first is not None
    size = first.width, first.height
    rows: list[dict[str, Any]] = []
    fields = (fov_degrees,) if fov_degrees is not None else _FIELDS
    candidates = []
    few = connected_pairs(pairs, _FIELD_IMAGES)
    for field in fields:
        lens = guessed_lens(*size, field)
        found = _try(photographs, lens, _START, features, few, options, show, rows, shutter)
        if found is not None:
            candidates.append(found)
    if not candidates:
        raise SolveError(
            "no lens of the fields of view tried gives a reconstruction; give a rough one with "
            "--fov, or a lens file with --camera"
        )
    best = min(candidates, key=_rank)
    lens = best.cameras[0]
    indices = np.array([(pair.first, pair.second) for pair in pairs], np.int64).reshape(-1, 2)
    again = match_and_verify(
        features, [lens] * len(photographs), indices, options,
        lambda done, total: show("matching", done, total, "again, with the lens found"), shutter,
    )  # fmt: skip
    more = connected_pairs(again, _MODEL_IMAGES)
    results = [(best, _START)]
    for model, free in _models(lens):  # fewest parameters first
        found = _try(photographs, model, free, features, more, options, show, rows, shutter)
        if found is not None:
            results.append((found, free))
    chosen, free = results[min(1, len(results) - 1)]
    for other, other_free in results[2:]:
        (missing, error), (least, bound) = _rank(other), _rank(chosen)
        if missing < least or (missing == least and error < (1 - _BETTER) * bound):
            chosen, free = other, other_free
    # The lens is chosen: now with every sight.
    model = chosen.cameras[0]
    final = solve(
        photographs.names, [model] * len(photographs), features, again, options,
        lambda done, total, points, step: show("mapping", done, total, f"{points:,} points"),
        lens_free=free, shutter=shutter,
    )  # fmt: skip
    return LensSearch(final, rows)


def connected_pairs(pairs: Sequence[PairMatches], most: int) -> list[PairMatches]:
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


def _models(lens: Camera) -> list[tuple[Camera, np.ndarray]]:
    """Lenses to choose from, near the one found, with the parameters to estimate."""
    size = lens.width, lens.height
    if lens.model == "kannala_brandt":
        return [(lens, np.ones(len(lens.params), bool))]
    everything = np.ones(8, bool)
    plain = np.array([1, 1, 0, 0, 1, 1, 0, 0], bool)
    wide = [*lens.params[:4], 0.0, 0.0, 0.0, 0.0]
    return [
        (lens, plain),
        (lens, everything),
        (Camera("opencv5", [*lens.params, 0.0], *size), np.ones(9, bool)),
        (Camera("kannala_brandt", wide, *size), everything),
    ]


def _try(
    photographs: Photographs,
    lens: Camera,
    free: np.ndarray,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    show: Callable[[str, int, int, str], None],
    rows: list[dict[str, Any]],
    shutter: Shutter | None,
) -> Solution | None:
    """A solution with this lens to begin with, or None; adds a row."""
    row: dict[str, Any] = {"model": lens.model, "estimated": int(free.sum())}
    try:
        found = solve(
            photographs.names, [lens] * len(photographs), features, pairs, options,
            lambda done, total, points, step: show(
                "mapping", done, total, f"{lens.model}, {points:,} points"),
            lens_free=free, hold_out_every=_HOLD_OUT_EVERY, shutter=shutter,
        )  # fmt: skip
    except SolveError as error:
        rows.append({**row, "registered": 0, "failure": str(error)})
        return None
    rows.append(
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
