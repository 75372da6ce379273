"""Compares what poses explain of each pair's matches with what they explain of shuffled ones."""

from __future__ import annotations

import collections
import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np

from gsut.check.epipolar import TOLERANCE
from gsut.check.evidence import Evidence, fit_relative_poses
from gsut.check.turns import to_rotation_vector
from gsut.sfm.points import measure_angular_errors

_SHUFFLES = 4  # of each pair: their mean is what chance explains
_SIGMAS = 4.0  # standard deviations above the shuffled count from which a count is not chance
_HALF = 0.5  # of what free poses explain: right poses explain all of it, wrong ones nothing
_CLOSED = 5.0  # degrees that three turns around a triple may miss: several errors of a turn
_REPEATED = 0.3  # of the pairs of right poses, that repeated things make contradict, at most
_RARE = 0.01  # chance of as many contradictions, below which the poses are wrong
_SEED = 0  # of the shuffles


@dataclasses.dataclass(frozen=True)
class PairVerdict:
    """What the matches of one pair say about the poses.

    Args:
        number: of the pair.
        turn: (3, 3) second_from_first of the free relative pose.
        free, given: matches that the free and the given relative pose explain.
        free_by_chance, given_by_chance: shuffled matches that they explain, means.
    """

    number: int
    turn: np.ndarray
    free: int
    given: int
    free_by_chance: float
    given_by_chance: float

    @property
    def supports(self) -> bool:
        """Returns whether the given pose explains beyond chance most of what any pose explains."""
        return (
            _is_beyond_chance(self.given, self.given_by_chance)
            and self.given - self.given_by_chance >= _HALF * (self.free - self.free_by_chance)
        )  # fmt: skip

    @property
    def contradicts(self) -> bool:
        """Returns whether another pose explains beyond chance what the given one does not."""
        return (
            _is_beyond_chance(self.free, self.free_by_chance)
            and self.given - self.given_by_chance < _HALF * (self.free - self.free_by_chance)
        )  # fmt: skip


def _is_beyond_chance(count: int, by_chance: float) -> bool:
    """Returns whether a count is more than chance, whose variance is at most its mean (Poisson)."""
    return count - by_chance > _SIGMAS * np.sqrt(max(by_chance, 1.0))


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What all pairs say about the poses.

    Args:
        supports: pairs whose given pose explains what any pose explains.
        contradicts: pairs of which another pose explains more.
        confirmed: those of them whose turns, other than the given ones, two other pairs confirm;
            and those of a view that no pair supports, if closed or if another view's pose fits.
    """

    supports: list[PairVerdict]
    contradicts: list[PairVerdict]
    confirmed: list[PairVerdict]

    @property
    def is_contradiction(self) -> bool:
        """Returns whether the poses are wrong: more pairs say so than repeated things explain."""
        return are_beyond_repeated(len(self.contradicts), len(self.supports))


def are_beyond_repeated(contradicting: int, supporting: int) -> bool:
    """Returns whether more pairs contradict the poses than repeated things explain.

    Their number is at most binomial: a pattern moves all matches of a pair together.
    """
    count = contradicting + supporting
    chance = sum(
        math.comb(count, k) * _REPEATED**k * (1 - _REPEATED) ** (count - k)
        for k in range(contradicting, count + 1)
    )
    return contradicting > 0 and chance < _RARE


def judge_pairs(evidence: Evidence) -> Judgement:
    """Judges each pair by what free and given relative poses explain beyond chance."""
    verdicts = [v for v in map(functools.partial(_judge_pair, evidence), range(len(evidence.pairs)))
                if v is not None]  # fmt: skip
    against = [each for each in verdicts if each.contradicts]
    supports = [each for each in verdicts if each.supports]
    views = [(p.first, p.second) for p in evidence.pairs]
    closed = _list_closed_pairs(verdicts, views)
    supported = {view for each in supports for view in views[each.number]}
    count = collections.Counter(view for each in against for view in views[each.number])
    alone = {view for view in count if count[view] > 1 and view not in supported}

    def is_confirmed(each: PairVerdict) -> bool:
        # Turns of right poses close, too, so a closed triple says something only of another turn.
        is_closed = each.number in closed
        if is_closed and measure_turn_error(evidence, each) > _CLOSED:
            return True
        # A wrong pose is wrong in all pairs of its view.
        if is_closed and not alone.isdisjoint(views[each.number]):
            return True
        return not supported.issuperset(views[each.number]) and is_another_view(evidence, each)

    confirmed = [each for each in against if is_confirmed(each)]
    if all(alone.isdisjoint(views[each.number]) for each in confirmed) and len(confirmed) == 1:
        confirmed = []  # one pair alone may be an exception
    return Judgement(supports, against, confirmed)


def measure_turn_error(evidence: Evidence, verdict: PairVerdict) -> float:
    """Returns the degrees between a pair's turn by its matches and by the given poses."""
    pair = evidence.pairs[verdict.number]
    one, two = (evidence.scene.views[i].camera_from_world for i in (pair.first, pair.second))
    turn = verdict.turn @ one[:3, :3] @ two[:3, :3].T
    return float(np.degrees(np.linalg.norm(to_rotation_vector(turn))))


def _judge_pair(evidence: Evidence, number: int) -> PairVerdict | None:
    """Counts what free and given relative poses explain of a pair, and what chance would.

    Chance is the number explained after the second image's pixels are shuffled among the matches: a
    free pose has five numbers that adapt to them (a permutation test). None for lenses without one
    centre.
    """
    m = evidence.matches
    rows = np.flatnonzero(m.pair == number)
    rng = np.random.default_rng([_SEED, number])
    orders = [rng.permutation(len(rows)) for _ in range(_SHUFFLES)]
    fits = fit_relative_poses(evidence, number, orders)
    if not fits:
        return None
    tolerance = TOLERANCE * m.diagonal / 1000 / evidence.focal
    poses, rays = evidence.table.select_poses()[:, rows], evidence.rays[:, rows]
    given = [
        np.count_nonzero(measure_angular_errors(np.stack([rays[0], second]), poses) < tolerance)
        for second in (rays[1], *(rays[1, order] for order in orders))
    ]
    (turn, free), *by_chance = fits
    return PairVerdict(
        number, turn, free, int(given[0]),
        float(np.mean([each for _, each in by_chance])), float(np.mean(given[1:])),
    )  # fmt: skip


def is_another_view(evidence: Evidence, verdict: PairVerdict) -> bool:
    """Returns whether a pair's matches fit if one image has the pose of another view.

    As where names and poses were paired wrongly. Chance is the most that any view explains of
    shuffled matches.
    """
    rows = np.flatnonzero(evidence.matches.pair == verdict.number)
    order = np.random.default_rng([_SEED, verdict.number]).permutation(len(rows))
    tolerance = TOLERANCE * evidence.matches.diagonal / 1000 / evidence.focal
    poses, rays = evidence.table.select_poses()[:, rows], evidence.rays[:, rows]
    moments = evidence.table.rows[:, rows, 1]
    most = [0, 0]
    for side, view in itertools.product((0, 1), range(len(evidence.scene))):
        tried = poses.copy()
        tried[side] = evidence.table.poses[view, moments[side]]
        for kind, second in enumerate((rays[1], rays[1, order])):
            errors = measure_angular_errors(np.stack([rays[0], second]), tried)
            most[kind] = max(most[kind], int(np.count_nonzero(errors < tolerance)))
    enough = most[0] - most[1] >= _HALF * (verdict.free - verdict.free_by_chance)
    return enough and _is_beyond_chance(most[0], most[1])


def _list_closed_pairs(
    verdicts: Sequence[PairVerdict], views: Sequence[tuple[int, int]]
) -> set[int]:
    """Lists the pairs whose turn two other pairs confirm: the three turns lead back to the start.

    Repeated things (columns, windows) match as well as what is there once, and show a wrong turn
    in one pair; three wrong turns do not close a triple.

    Args:
        verdicts: of the pairs.
        views: both views of each pair.

    Returns:
        Numbers of the pairs.
    """
    turns = {}
    for each in verdicts:
        if _is_beyond_chance(each.free, each.free_by_chance):
            a, b = views[each.number]
            turns[a, b], turns[b, a] = (each.number, each.turn), (each.number, each.turn.T)
    closed: set[int] = set()
    for a, b in turns:
        for c in {second for first, second in turns if first == b}:
            if a < b < c and (c, a) in turns:
                sides = [turns[side] for side in ((a, b), (b, c), (c, a))]
                around = sides[2][1] @ sides[1][1] @ sides[0][1]
                if np.degrees(np.linalg.norm(to_rotation_vector(around))) < _CLOSED:
                    closed |= {number for number, _ in sides}
    return closed
