"""Finds where poses change their world frame or scale along the path, and single wrong poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from gsut.check.chance import Judgement, PairVerdict, measure_turn_error
from gsut.check.epipolar import TOLERANCE
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.matches import is_loop, order_in_time
from gsut.sfm.points import measure_angular_errors
from gsut.significance import convert_to_normal

_RARE = 0.01  # chance of as many contradictions at one place, below which the poses break there
_FEWEST_SHARED = 6  # features that three images share, from which their scales are compared
_LEAST_PARALLAX = 1.0  # times the tolerance: rays less apart give no distance
_FEWEST_TRIPLES = 4  # places along the path: fewer show no drift
_SIGMAS = 4.0  # standard deviations from which a change of scale is not chance
_LEAST_DRIFT = 0.05  # logarithm of the change of scale along the path that deserves a note
_LEAST_SIGMA = 0.3  # of the median sigma: a change by few features may have a small one by chance
_NORMAL = 1.4826  # standard deviation of a normal law over the median of its absolute values
_MEDIAN_NOISE = 1.2533  # standard deviation of a median over that of a mean

Spans = list[tuple[int, int]]  # first and last place of pairs on a path


def name_break(evidence: Evidence, judgement: Judgement) -> Finding | None:
    """Names the one place of the path, or the one view, at which all contradictions lie.

    Args:
        evidence: of the photographs.
        judgement: of its pairs, some of which contradict their poses.

    Returns:
        An error for a path in two world frames, a warning for one pose beside the path, or None
        where the contradictions lie elsewhere.
    """
    place = {v: i for group in order_in_time(evidence.scene) for i, v in enumerate(group)}
    against = [_order_pair(evidence, each, place) for each in judgement.confirmed]
    good = [_order_pair(evidence, each, place) for each in judgement.supports]
    common = set.intersection(*({a, b} for a, b in against)) if against else set()
    names = [view.name for view in evidence.scene.views]
    alone = [v for v in common if not any(v in pair for pair in good)]
    if len(against) > 1 and len(alone) == 1:
        return evidence.make_finding(
            "warning",
            f"the pose of {names[alone[0]]} contradicts all {len(against)} neighbouring images "
            f"that it was compared with, which agree with each other",
            "leave the image out, or give it its own pose",
        )
    wrong = [_order_pair(evidence, each, place) for each in judgement.contradicts]
    spans = [(place[a], place[b]) for a, b in wrong]
    loops = list_loops(evidence)
    at = _find_break(
        spans,
        [(place[a], place[b]) for a, b in good],
        [(place[a], place[b]) for a, b in against],
        [
            pair
            for pair, each in zip(spans, judgement.contradicts, strict=True)
            if each.number not in loops
        ],
    )
    if at is None:
        return None
    across = [pair for pair, (a, b) in zip(wrong, spans, strict=True) if a <= at < b]
    a = max((a for a, _ in across), key=lambda view: place[view])
    b = min((b for _, b in across), key=lambda view: place[view])
    return evidence.make_finding(
        "error",
        f"the poses break between {names[a]} and {names[b]}: on either side they fit the "
        f"photographs, and no pair of images across fits ({len(across)} pairs)",
        "both parts are in different world frames or scales: find poses of all images at once "
        "(`gsut poses`); if it has found these, add pictures that see both parts, or keep one",
    )


def _find_break(wrong: Spans, good: Spans, confirmed: Spans, near: Spans) -> int | None:
    """Finds the place of the path across which all pairs contradict, too many for chance.

    Args:
        wrong, good, confirmed: first and last place of the pairs that contradict their poses, that
            support them, and that surely contradict them.
        near: those that contradict and are no loops: these alone contradict where poses drift.

    Returns:
        The place before the break. All confirmed pairs lie across it, or more pairs do than the
        rate at which others contradict explains at any of the places.
    """
    places = sorted({place for pair in (*wrong, *good) for place in pair})
    found = []
    for at in places[:-1]:
        across = [(a, b) for a, b in wrong if a <= at < b]
        sides = any(b <= at for _, b in good), any(a > at for a, _ in good)
        if len(across) < 2 or not all(sides) or any(a <= at < b for a, b in good):
            continue
        if not any(a <= at < b for a, b in near):
            continue
        others = len(wrong) + len(good) - len(across)
        rate = (len(wrong) - len(across) + 1) / (others + 2)  # Laplace's rule of succession
        is_sure = bool(confirmed) and all(a <= at < b for a, b in confirmed)
        if is_sure or rate ** len(across) * len(places) < _RARE:
            found.append((len(across), at))
    return max(found)[1] if found else None


def list_loops(evidence: Evidence) -> set[int]:
    """Lists the numbers of the pairs of images that are far apart on the path."""
    places = {
        v: (i, len(group)) for group in order_in_time(evidence.scene) for i, v in enumerate(group)
    }
    return {
        number
        for number, pair in enumerate(evidence.pairs)
        if is_loop(places[pair.first][0], *places[pair.second])
    }


def check_loops(evidence: Evidence, judgement: Judgement) -> list[Finding]:
    """Checks whether images far apart on the path, near each other in space, fit their poses."""
    numbers = list_loops(evidence)
    supports, against = (
        [each for each in verdicts if each.number in numbers]
        for verdicts in (judgement.supports, judgement.contradicts)
    )
    loops = Judgement(supports, against, confirmed=[])
    if not loops.is_contradiction:
        return []
    off = [measure_turn_error(evidence, each) for each in against]
    pair = evidence.pairs[against[int(np.argmax(off))].number]
    names = [evidence.scene.views[view].name for view in (pair.first, pair.second)]
    return [
        evidence.make_finding(
            "warning",
            f"the path of the poses does not close: {len(against)} of "
            f"{len(against) + len(supports)} pairs of images that are far apart on "
            f"it and see the same contradict their poses, such as {names[0]} and {names[1]} (turns "
            f"differ by {np.median(off):.1f} degrees, median)",
            "the poses drift, as odometry does: adjust all of them at once (`gsut poses`)",
        )
    ]


def _order_pair(evidence: Evidence, verdict: PairVerdict, place: dict[int, int]) -> tuple[int, int]:
    pair = evidence.pairs[verdict.number]
    a, b = sorted((pair.first, pair.second), key=lambda view: place[view])
    return a, b


@dataclasses.dataclass(frozen=True)
class _Triple:
    """The change of scale between the steps to and from a view.

    Args:
        views: before, at and after.
        gap: frames between the middles of both steps.
        change: logarithm of the change of scale.
        sigma: its standard deviation by the features' spread.
        freedom: features, but for one: degrees of freedom of sigma.
    """

    views: tuple[int, int, int]
    gap: int
    change: float
    sigma: float
    freedom: int


def check_scale(evidence: Evidence) -> list[Finding]:
    """Compares distances triangulated by one pair of images with those by the next pair.

    Poses whose scale drifts fit every pair of images: only distances of the same features from the
    view that two pairs share show it. Both steps have as many frames, so that errors of the lens
    change both distances alike.
    """
    triples = list(_measure_triples(evidence))
    if len(triples) < _FEWEST_TRIPLES:
        return []
    rates = np.array([each.change / each.gap for each in triples])
    own = np.array([each.sigma / each.gap for each in triples])
    own = np.hypot(own, _LEAST_SIGMA * np.median(own))
    rate = float(np.average(rates, weights=own**-2))
    off = np.abs(rates - rate) / own
    spread = max(1.0, float(np.sqrt(np.sum(off**2) / (len(rates) - 1))))
    sigma = spread / float(np.sqrt(np.sum(own**-2)))
    groups = order_in_time(evidence.scene)
    longest = max(groups, key=len)
    frames = len(longest)
    names = [view.name for view in evidence.scene.views]
    worst = int(np.argmax(off))
    others = np.delete(off, worst)
    usual = max(1.0, float(np.sqrt(np.mean(others**2))))
    found = []
    if (
        convert_to_normal(off[worst] / usual, min(len(rates) - 2, triples[worst].freedom)) > _SIGMAS
        and abs(triples[worst].change) > 2 * _LEAST_DRIFT
    ):
        a, _, b = triples[worst].views
        found.append(evidence.make_finding(
            "warning",
            f"the scale of the poses changes by a factor of {np.exp(triples[worst].change):.2f} "
            f"between {names[a]} and {names[b]}, by distances that both see",
            "find poses of all images at once (`gsut poses`); if it has found these, add pictures "
            "between the two; or scale one part's positions",
        ))  # fmt: skip
    drift = rate * (frames - 1)
    if (
        convert_to_normal(np.abs(rate) / sigma, len(rates) - 1) > _SIGMAS
        and abs(drift) > _LEAST_DRIFT
    ):
        found.append(evidence.make_finding(
            "warning",
            f"the scale of the poses drifts by a factor of about {np.exp(drift):.2f} from "
            f"{names[longest[0]]} to {names[longest[-1]]} (+- {sigma * (frames - 1):.0%}), by "
            "distances that neighbouring pairs share",
            "adjust all poses at once (`gsut poses`, with loops closed)",
        ))  # fmt: skip
    return found


def _measure_triples(evidence: Evidence) -> Iterator[_Triple]:
    """Measures the change of scale at each view between two pairs of as many frames."""
    place = {
        v: (number, i)
        for number, group in enumerate(order_in_time(evidence.scene))
        for i, v in enumerate(group)
    }
    distances = _triangulate_pairs(evidence)
    pairs = {(pair.first, pair.second): i for i, pair in enumerate(evidence.pairs)}
    for (a, b), one in pairs.items():
        gap = place[b][1] - place[a][1]
        for (other, c), two in pairs.items():
            if other != b or gap < 1 or place[c] != (place[b][0], place[b][1] + gap):
                continue
            change = _compare_distances(distances[one][1], distances[two][0])
            if change is not None:
                yield _Triple((a, b, c), gap, *change)


def _triangulate_pairs(evidence: Evidence) -> list[tuple[dict, dict]]:
    """Returns, for each pair, the distances of its features from both images, by their pixels."""
    m, poses = evidence.matches, evidence.table.select_poses()
    tolerance = TOLERANCE * m.diagonal / 1000 / evidence.focal
    errors = measure_angular_errors(evidence.rays, poses)
    distance, sine = triangulate_distances(evidence.rays, poses)
    good = (errors < tolerance) & (sine > _LEAST_PARALLAX * tolerance)
    good &= np.isfinite(distance).all(axis=0)
    found = []
    for number in range(len(evidence.pairs)):
        rows = np.flatnonzero(good & (m.pair == number))
        sides = [
            dict(zip(map(tuple, m.pixels[side, rows].tolist()), distance[side, rows], strict=True))
            for side in (0, 1)
        ]
        found.append((sides[0], sides[1]))
    return found


def triangulate_distances(rays: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangulates the features of matches (law of sines).

    Args:
        rays: (2, M, 3) in camera axes.
        poses: (2, M, 4, 4) world_from_camera.

    Returns:
        Distances (2, M) from both cameras, and (M,) the sine of the angle between both rays.
    """
    one, two = np.einsum("smij,smj->smi", poses[..., :3, :3], rays)
    base = poses[1, :, :3, 3] - poses[0, :, :3, 3]
    sine = np.linalg.norm(np.cross(one, two), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        across = [np.linalg.norm(np.cross(base, ray), axis=1) / sine for ray in (two, one)]
    return np.array(across), sine


def _compare_distances(before: dict, after: dict) -> tuple[float, float, int] | None:
    """Returns the median logarithm of the ratio of distances of shared features.

    And its standard deviation, with the degrees of freedom of that.
    """
    shared = before.keys() & after.keys()
    if len(shared) < _FEWEST_SHARED:
        return None
    ratios = np.log([after[pixel] / before[pixel] for pixel in sorted(shared)])
    middle = float(np.median(ratios))
    spread = _NORMAL * float(np.median(np.abs(ratios - middle)))
    return middle, _MEDIAN_NOISE * spread / np.sqrt(len(ratios)), len(ratios) - 1
