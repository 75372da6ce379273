"""Compares what poses explain of each pair's matches with what any relative pose explains."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut.check.evidence import Evidence
from gsut.data import Scene
from gsut.gaussians import measure_rotation_angles
from gsut.judge import SAME_DEGREES, SURE

_SHUFFLES = 4  # of each pair: their mean is what chance explains
_REPEATED = 0.3  # of the pairs of right poses, that repeated things make contradict, at most
_FEW = 5  # cameras for each one that may stand far away


@dataclasses.dataclass(frozen=True)
class PairVerdict:
    """What the matches of one pair say about the poses.

    Args:
        views: of the pair.
        turn: (3, 3) second_from_first of the relative pose that explains most.
        free, given: matches that this and the given relative pose explain.
        free_by_chance, given_by_chance: shuffled matches that they explain, means.
    """

    views: tuple[int, int]
    turn: np.ndarray
    free: int
    given: int
    free_by_chance: float
    given_by_chance: float

    @property
    def _explains(self) -> bool:
        by_any = self.free - self.free_by_chance
        # Right poses explain all of what any explain, wrong ones nothing.
        return self.given - self.given_by_chance >= by_any / 2

    @property
    def shows_turn(self) -> bool:
        """Returns whether a relative pose explains more than chance."""
        return _is_beyond_chance(self.free, self.free_by_chance)

    @property
    def supports(self) -> bool:
        """Returns whether the given pose explains beyond chance most of what any pose explains."""
        return _is_beyond_chance(self.given, self.given_by_chance) and self._explains

    @property
    def contradicts(self) -> bool:
        """Returns whether another pose explains beyond chance what the given one does not."""
        return self.shows_turn and not self._explains


def _is_beyond_chance(count: int, by_chance: float) -> bool:
    """Returns whether a count is more than chance, whose variance is at most its mean (Poisson)."""
    return count - by_chance > SURE * math.sqrt(max(by_chance, 1.0))


@dataclasses.dataclass(frozen=True)
class Agreement:
    """What all pairs say about the poses: those that support them, those that contradict them.

    Args:
        supports, contradicts: the pairs.
        apart: groups of views whose poses fit each other and, beyond doubt, not the others'; the
            smaller first.
    """

    supports: list[PairVerdict]
    contradicts: list[PairVerdict]
    apart: list[list[int]]

    @property
    def is_contradiction(self) -> bool:
        """Returns whether the poses are wrong: more pairs say so than repeated things explain.

        Their number is at most binomial: a pattern moves all matches of a pair together.
        """
        against, count = len(self.contradicts), len(self.contradicts) + len(self.supports)
        chance = sum(
            math.comb(count, k) * _REPEATED**k * (1 - _REPEATED) ** (count - k)
            for k in range(against, count + 1)
        )
        return against > 0 and chance < math.erfc(SURE / math.sqrt(2))


def find_agreement(evidence: Evidence) -> Agreement:
    """Judges each pair by what free and given relative poses explain beyond chance."""
    orders = [np.arange(len(evidence)), *map(evidence.shuffle, range(_SHUFFLES))]
    given = []
    for each in map(evidence.match_with, orders):
        fits = each.measure_errors(each.given)[: len(each)] < each.tolerance
        given.append(np.bincount(each.pair[fits], minlength=len(evidence.pairs)))
    found = [
        _judge_pair(evidence, k, orders, [row[k] for row in given])
        for k in range(len(evidence.pairs))
    ]
    verdicts = [each for each in found if each is not None]
    supports = [each for each in verdicts if each.supports]
    contradicts = [each for each in verdicts if each.contradicts]
    return Agreement(supports, contradicts, _find_apart(verdicts))


def _judge_pair(
    evidence: Evidence, number: int, orders: Sequence[np.ndarray], given: Sequence[int]
) -> PairVerdict | None:
    """Counts what free and given relative poses explain of a pair, and what chance would.

    A free pose has five numbers that adapt to the matches, so chance is what it explains of
    shuffled ones (a permutation test). None for lenses without one centre.
    """
    scene, pair = evidence.scene, evidence.pairs[number]
    cameras = [scene.camera(view) for view in (pair.first, pair.second)]
    if not all(camera.is_central for camera in cameras):
        return None
    images = [
        _core.ImageBearings(camera, np.ascontiguousarray(pixels))
        for camera, pixels in zip(cameras, pair.pixels, strict=True)
    ]
    seen = [np.array(image.valid, bool) for image in images]
    own = np.flatnonzero(evidence.pair == number)
    rows = [np.stack([own, order[own]], axis=1).astype(np.int32) - own[0] for order in orders]
    rows = [both[seen[0][both[:, 0]] & seen[1][both[:, 1]]] for both in rows]
    ends = np.tile([[0, 1]], (len(rows), 1))
    fits = _core.verify_pairs(images, ends, rows, evidence.tolerance, 0)
    free = [int(np.count_nonzero(kept)) for kept, *_ in fits]
    return PairVerdict(
        (pair.first, pair.second), np.asarray(fits[0][1])[:3, :3], free[0], int(given[0]),
        float(np.mean(free[1:])), float(np.mean(given[1:])),
    )  # fmt: skip


def _find_apart(verdicts: Sequence[PairVerdict]) -> list[list[int]]:
    """Finds views that fit each other, but not others, where the photographs surely differ.

    Two pairs across must contradict, none support, and their turns must close a triple with a pair
    inside: repeated things (columns, windows) show wrong turns, which seldom close. In rooms that
    look alike they do, so that more than that pair must support its poses.
    """
    if sum(each.supports for each in verdicts) < 2:
        return []
    group = {view: view for each in verdicts for view in each.views}
    for each in verdicts:
        if each.supports:
            kept, joined = (group[view] for view in each.views)
            group = {view: kept if own == joined else own for view, own in group.items()}
    turns = {}
    for each in verdicts:
        if each.shows_turn:
            (a, b), turn = each.views, each.turn
            turns[a, b], turns[b, a] = (each, turn), (each, turn.T)
    apart: dict[frozenset[int], None] = {}
    for a, b in turns:
        for c in [second for first, second in turns if first == b]:
            if (c, a) not in turns or group[b] != group[c] or group[a] == group[b]:
                continue
            (one, ab), (inside, bc), (two, ca) = turns[a, b], turns[b, c], turns[c, a]
            (turned,) = np.degrees(measure_rotation_angles((ca @ bc @ ab)[None]))
            closed = turned < SAME_DEGREES
            if closed and inside.supports and one.contradicts and two.contradicts:
                apart[frozenset((group[a], group[b]))] = None
    members = {root: [v for v in group if group[v] == root] for pair in apart for root in pair}
    return sorted((sorted(views) for views in members.values()), key=len)


def find_far_views(scene: Scene) -> tuple[list[int], float, float]:
    """Finds cameras that stand farther from all others than these are apart: a fifth at most.

    Returns:
        The views, their distance from the others, and the others' size; no views if none stand out.
    """
    centers = np.array([view.camera_center for view in scene.views])
    order = np.argsort(-np.linalg.norm(centers - np.median(centers, axis=0), axis=1), kind="stable")
    found: tuple[list[int], float, float] = ([], 0.0, 0.0)
    for count in range(1, 1 + len(centers) // _FEW):
        far, others = order[:count], centers[order[count:]]
        size = float(np.linalg.norm(np.ptp(others, axis=0)))
        distance = min(float(np.linalg.norm(others - centers[k], axis=1).min()) for k in far)
        if distance > size:
            found = sorted(map(int, far)), distance, size
    return found
