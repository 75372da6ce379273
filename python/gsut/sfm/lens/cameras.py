"""Estimates the lenses of several cameras in one run, beside lenses that are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.lens import Camera
from gsut.sampling import MAJORITY, choose_evenly
from gsut.sfm.lens.candidates import list_lens_ladder
from gsut.sfm.lens.ranking import ROUGH
from gsut.sfm.lens.search import ADVICE, START, choose_lens, search_lens
from gsut.sfm.lens.sightings import Sightings, gather_sightings
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import explain_failure, require_overlap, select_pairs, verify_matches
from gsut.sfm.photographs import FEWEST_OF_MODEL, LensGroup
from gsut.sfm.solution import index_lenses

_MOST_ROUNDS = 6  # of structures from guessed lenses; most captures end before
_SAME = 0.02  # relative difference of the observations of two structures that are the same


def search_lenses(mapping: Mapping) -> Mapping:
    """Estimates poses, points and every unknown lens.

    One lens of all photographs is searched with their poses. Of several cameras each lens is chosen
    from the camera's own photographs; then all matches are verified through these lenses and those
    known, and poses, points and unknown lenses are estimated together. A camera with too few
    photographs, or too few matches among them, gets the lens through which its photographs fit
    points that the other cameras see, and all is estimated once more. If no camera has enough of
    its own, all start from what they state, or from a usual field of view.

    Returns:
        The run with solution, verified pairs and `lens_free`.

    Raises:
        SolveError: nothing could be reconstructed.
    """
    groups = mapping.photographs.unknown_groups
    if len(groups) == 1 and len(groups[0].images) == len(mapping.photographs):
        return search_lens(mapping)
    lenses = _Lenses(mapping, groups)
    open_groups, failure = [], None
    for group in groups:
        try:
            if len(group.images) < FEWEST_OF_MODEL:
                raise SolveError(f"{len(group.images)} images are too few")
            lens, flags, _ = choose_lens(mapping.select(group))
        except SolveError as error:
            open_groups.append(group)
            failure = error
            continue
        lenses.set(group, lens, flags)
    if failure is not None and not lenses.known.any():
        _start_from_guesses(lenses, groups)
        open_groups = [g for g in groups if not lenses.mapping.solved.registered[g.images].any()]
    else:
        lenses.solve()
    found = [group for group in open_groups if _fit_to_points(lenses, group)]
    if found:
        lenses.solve()
    return lenses.mapping


class _Lenses:
    """The lenses of a run's photographs, as far as they are known.

    Attributes:
        mapping: the run, with what was solved last.
        known: (N,) bool, whether an image's lens is known or estimated.
    """

    def __init__(self, mapping: Mapping, groups: Sequence[LensGroup]) -> None:
        self.mapping = mapping
        self.known = np.ones(len(mapping.photographs), bool)
        self._cameras = mapping.photographs.lenses
        self._free: list[np.ndarray | None] = [None] * len(self._cameras)
        for group in groups:
            self.known[group.images] = False

    def set(self, group: LensGroup, lens: Camera, flags: np.ndarray) -> None:
        """Sets the lens of a group, and which of its parameters are estimated."""
        own = flags.copy()  # an array a lens: equal lenses of two cameras stay two
        for image in group.images:
            self._cameras[image], self._free[image] = lens, own
        self.known[group.images] = True

    def solve(self, trial: int = 0) -> None:
        """Estimates poses, points and lenses from the images whose lens is known by now.

        Args:
            trial: its number, which changes the random numbers.

        Raises:
            SolveError: nothing could be reconstructed; the solution stays, the pairs say why.
        """
        mapping, options = self.mapping, self.mapping.options
        varied = mapping.replace(
            photographs=mapping.photographs.with_cameras(self._cameras),
            options=dataclasses.replace(options, seed=options.seed ^ trial),
        )
        among = {(int(a), int(b)) for a, b in mapping.raw.pairs if self.known[a] and self.known[b]}
        pairs = verify_matches(varied.images, select_pairs(mapping.raw, among), varied.options)
        require_overlap(varied.images, pairs, is_lens_known=False)
        self.mapping, free = mapping.replace(pairs=pairs), list(self._free)
        solution = varied.solve(varied.images, pairs, free)
        varied = varied.replace(pairs=pairs, lens_free=free, solution=solution)
        self.keep(varied.replace(options=options))

    def keep(self, mapping: Mapping) -> None:
        """Takes a run's solution, and what it found of its lenses."""
        self.mapping = mapping
        for image in np.flatnonzero(self.known & mapping.solved.registered):
            if self._free[image] is not None:
                self._cameras[image] = mapping.solved.cameras[image]


def _start_from_guesses(lenses: _Lenses, groups: Sequence[LensGroup]) -> None:
    """Solves from the lens that each camera states, or from the usual field of view.

    For cameras none of which has photographs enough to choose its lens by them alone. Which images
    a structure connects through lenses that are far off is chance. So each round starts from those
    of the best structure so far, or others that fit its points better, until two are the same.

    Raises:
        SolveError: nothing could be reconstructed.
    """
    for group in groups:
        lenses.set(group, lenses.mapping.photographs.lenses[group.images[0]], START)
    best, most = lenses.mapping, (0, 0)
    for trial in range(_MOST_ROUNDS):
        try:
            lenses.solve(trial)
        except SolveError as error:
            if trial:
                continue
            raise explain_failure(error, best.features, lenses.mapping.pairs, ADVICE) from None
        solution = lenses.mapping.solved
        found = solution.num_registered, len(solution.observations)
        is_same = found[0] == most[0] and abs(found[1] / most[1] - 1) < _SAME
        if found > most:
            best, most = lenses.mapping, found
        lenses.keep(best)
        if is_same:
            break
        for group in groups:
            _fit_to_points(lenses, group)
    lenses.keep(best)


def _fit_to_points(lenses: _Lenses, group: LensGroup) -> bool:
    """Sets the lens through which a camera's images fit points that others see; False if none."""
    mapping = lenses.mapping
    seen = gather_sightings(mapping.solved, mapping.features, mapping.raw)
    own = choose_evenly([seen[image] for image in group.images if image in seen])
    if not own:
        return False
    size = mapping.photographs.lenses[group.images[0]]
    width, height = size.width, size.height
    settled = index_lenses(mapping.solved.cameras, None).cameras
    candidates = [
        *group.candidates,
        *(c for c in settled if (c.width, c.height) == (width, height)),
        *list_lens_ladder(width, height, mapping.options.fov),
    ]
    fitting = [sum(_count_fitting(mapping, lens, each) for each in own) for lens in candidates]
    if max(fitting) < MAJORITY * sum(len(points) for _, points in own):
        return False
    best = candidates[int(np.argmax(fitting))]
    flags = np.zeros(len(best.params), np.uint8)
    flags[: len(START)] = START[: len(flags)]
    lenses.set(group, best, flags)
    return True


def _count_fitting(mapping: Mapping, lens: Camera, seen: Sightings) -> int:
    """Counts the points that an image sees where a pose through this lens puts them."""
    pixels, points = seen
    bearings = _core.ImageBearings(lens, pixels)
    rows = np.flatnonzero(bearings.valid)
    options = mapping.options
    max_error = ROUGH * options.max_error * math.hypot(lens.width, lens.height) / 1000
    return int(_core.absolute_pose(bearings, rows, points[rows], max_error, options.seed)[1].sum())
