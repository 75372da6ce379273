"""Finds places that look alike and were taken for one, and separates them.

Where a camera walks through two rooms with the same furniture, the rotations of pairs do not
contradict each other: the furniture fits. What stands around it does not fit: of the points that
several images of one room see, the images of the other room see only those of the furniture.

Of few photographs hardly three see a point from one side. But two that see a thing from nearly the
same side have many matches with each other; where they have hardly any, it only looks alike.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.data.poses import find_centers
from gsut.sampling import ENOUGH_SAMPLES
from gsut.sfm.matches import ENOUGH_MATCHES, FEW_IMAGES, FEWEST_MATCHES, PairMatches
from gsut.sfm.photographs import HELD_BY
from gsut.sfm.solution.result import Solution, measure_agreement

# Points are compared where both images see them from nearly the same side and distance, where
# features are found again and little is hidden.
_MOST_ANGLE = np.radians(6.0)  # between the rays of two images to a point
_MOST_DISTANCE_RATIO = 1.2  # of two images to a point
_MARGIN = 0.04  # of the image's sides, where features are often missed
# Of the farthest point's distance, beyond which no two images are that near: law of cosines.
_MOST_MOVED = np.sqrt(1 + _MOST_DISTANCE_RATIO**2 - 2 * _MOST_DISTANCE_RATIO * np.cos(_MOST_ANGLE))
_GROUP_SIZE = 4  # an image with those that share most points with it
# Share of the expected points that are seen, in the mean over an image's pairs, below which the
# image is doubted: true loops have 0.77 and more, half of the images of folded walks less than 0.6.
_LEAST_SHARE = 0.6
_LEAST_OF_ALL = 0.1  # share of the comparable images that must be doubted, for a doubt at all
# The limits above for each two of few images, by their own matches: most are found from farther
# apart.
_MOST_ANGLE_OF_TWO = np.radians(12.0)
_MOST_DISTANCE_RATIO_OF_TWO = 1.5
_LEAST_MATCHED = 0.15  # share of what the two see alike that images of one place match
_LEAST_LEFT = 0.2  # share of the images with a pose that must keep one, or nothing is dropped


@dataclasses.dataclass(frozen=True)
class LookAlikes:
    """Evidence that places which look alike were taken for one.

    Args:
        pairs: names of two images at one place by their poses, worst first, one a doubted image.
        shares: of each pair, the share of what one image sees that the other sees too.
        images: names of all doubted images.
        smaller: names of the images of the smaller of two places, if the images are few and
            parting them loses less than not.
    """

    pairs: list[tuple[str, str]]
    shares: list[float]
    images: list[str]
    smaller: list[str]

    def explain(self) -> str:
        """Returns the sentence of a verdict."""
        (one, other), share = self.pairs[0], self.shares[0]
        return (
            f"places that look alike may be taken for one: by their poses {one} and {other} show "
            f"the same, and only {100 * share:.0f} % of it is seen in both; this concerns "
            f"{len(self.images)} images: {list_some(self.images)}"
        )

    def to_figures(self) -> dict[str, object]:
        """Returns the values for poses.json."""
        return {
            "images": self.images,
            "pairs": [
                {"images": list(pair), "seen_in_both": round(share, 3)}
                for pair, share in zip(self.pairs, self.shares, strict=True)
            ],
        }


@dataclasses.dataclass(frozen=True)
class _Evidence:
    """What images see of each other's points.

    Args:
        shares: (N, N) of the points that either should see of the other's; NaN: unknown.
        joined: (N, N) bool: near in time, or, where that is not known, with a common neighbour.
        doubted: (N,) bool.
        missing: (N, N) points that two images should match at one place and do not, of those two
            that show different places.
    """

    shares: np.ndarray
    joined: np.ndarray
    doubted: np.ndarray
    missing: np.ndarray


def separate_look_alikes(
    solution: Solution,
    pairs: list[PairMatches],
    solve: Callable[[list[PairMatches]], Solution] | None,
    times: np.ndarray | None = None,
    near: int = 0,
) -> tuple[Solution, list[PairMatches], LookAlikes | None]:
    """Maps again without the pairs that took places for one.

    Args:
        solution: the result of mapping.
        pairs: verified matches that it was made from.
        solve: maps the given pairs; None: nothing is mapped again.
        times: (N,) int64, each image's frame number in order of time; None: not known. Only frames
            near each other stay joined, or, where times are not known, images that share a
            neighbour: another false join may look right, and one is enough to fold the whole.
        near: frames whose numbers differ by no more are not compared, as they follow each other;
            nor are frames between which the camera did not leave the place. Numbers of few images
            say nothing; each two of them are compared by their own matches too.

    Returns:
        The solution, its pairs, and what still speaks for places taken for one; solution and pairs
        are those given where no image is doubted or too little would be left.
    """
    is_few = len(solution.names) <= FEW_IMAGES
    times = None if is_few else times
    found = _gather_evidence(solution, times, near)
    least = _LEAST_LEFT * solution.num_registered
    while solve is not None and found.doubted.any():
        kept = [pair for pair in pairs if found.joined[pair.first, pair.second]]
        if len(kept) == len(pairs):
            break
        try:
            fresh = solve(kept)
        except SolveError:
            break
        if fresh.num_registered < least:
            break
        solution, pairs, found = fresh, kept, _gather_evidence(fresh, times, near)
    if is_few and not found.doubted.any():
        found = _compare_matches(solution, pairs)
    return solution, pairs, _name_doubted(solution, pairs, found)


def _choose_smaller(
    solution: Solution, pairs: list[PairMatches], missing: np.ndarray
) -> np.ndarray:
    """Chooses the images (N,) bool of the smaller of two places that were taken for one.

    Of all ways to part the images in two that which loses least: matches that observe one point,
    of images that are parted, and points that are missing, of those that are not.
    """
    images = np.flatnonzero(solution.registered)
    lost = np.zeros_like(missing)
    known = [p for p in pairs if solution.registered[p.first] and solution.registered[p.second]]
    for pair, together in zip(known, measure_agreement(solution, pairs).together, strict=True):
        lost[[pair.first, pair.second], [pair.second, pair.first]] += together
    sides = np.arange(2 ** (len(images) - 1))[:, None] >> np.arange(len(images)) & 1
    parted = sides[:, :, None] != sides[:, None]
    own = np.ix_(images, images)
    cost = np.where(parted, lost[own], missing[own]).sum(axis=(1, 2))
    best = sides[np.argmin(cost)].astype(bool)
    views = np.bincount(solution.observations[:, 1], minlength=len(missing))[images]
    if (best.sum(), views[best].sum()) > (sum(~best), views[~best].sum()):
        best = ~best
    return np.isin(np.arange(len(missing)), images[best])


def _name_doubted(
    solution: Solution, matched: list[PairMatches], found: _Evidence
) -> LookAlikes | None:
    """Names the doubted images, the pair of each that speaks most against it, and one place."""
    doubted = np.flatnonzero(found.doubted)
    if not len(doubted):
        return None
    pairs: dict[tuple[str, str], float] = {}
    for image in sorted(doubted, key=lambda image: np.nanmin(found.shares[image])):
        other = int(np.nanargmin(found.shares[image]))
        first, second = sorted((int(image), other))
        pairs[solution.names[first], solution.names[second]] = float(found.shares[image, other])
    names = [solution.names[image] for image in doubted]
    smaller: list[str] = []
    if found.missing.any():
        chosen = _choose_smaller(solution, matched, found.missing)
        smaller = [solution.names[image] for image in np.flatnonzero(chosen)]
    return LookAlikes(list(pairs), list(pairs.values()), names, smaller)


def _gather_evidence(solution: Solution, times: np.ndarray | None, near: int) -> _Evidence:
    observed, chosen = _sample_observations(solution)
    groups = _group_images(observed, solution.registered)
    expected, seen = _compare_views(solution, observed, chosen, groups)
    joined = (groups[:, None, :, None] == groups[None, :, None, :]).any(axis=(2, 3))
    together = joined
    if times is not None:
        joined = np.abs(times[:, None] - times) <= near
    together = together | joined | _find_stays(expected + expected.T >= FEWEST_MATCHES, joined)
    known = (np.minimum(expected, expected.T) >= FEWEST_MATCHES // 2) & ~together
    shares = np.where(known, (seen + seen.T) / np.maximum(expected + expected.T, 1), np.nan)
    of_image = known.sum(axis=1)
    mean = np.where(known, shares, 0).sum(axis=1) / np.maximum(of_image, 1)
    comparable = of_image > 1  # one alone may be an exception
    doubted = comparable & (mean < _LEAST_SHARE)
    if doubted.sum() < max(HELD_BY, _LEAST_OF_ALL * comparable.sum()):
        doubted[:] = False
    return _Evidence(shares, joined, doubted, np.zeros_like(shares))


def _compare_matches(solution: Solution, pairs: list[PairMatches]) -> _Evidence:
    """Compares the matches of each two images with the points that either shares with others.

    What counts is a verified match of the two, not that both observe the point: near the place
    where it should be, one of many features that look alike may be taken for it. Images that do not
    match each other are doubted where no others lead from one to the other, unless all such pairs
    have one image, which may be blurred or dark.
    """
    count, observations = len(solution.names), solution.observations
    views = np.bincount(observations[:, 0], minlength=len(solution.points))
    centers = find_centers(solution.camera_from_world)
    matched: dict[tuple[int, int], np.ndarray] = {}
    for pair in pairs:
        matched[pair.first, pair.second], matched[pair.second, pair.first] = pair.matches.T
    of_image = [observations[observations[:, 1] == image] for image in range(count)]
    expected, seen = np.zeros((count, count)), np.zeros((count, count))
    for image, other in itertools.permutations(np.flatnonzero(solution.registered).tolist(), 2):
        point, _, feature = of_image[image].T
        points = solution.points[point]
        held = views[point] - np.isin(point, of_image[other][:, 0]) > 1
        wanted = held & _is_in_view(solution, other, points) & _is_seen_alike(
            points - centers[image], points - centers[other],
            _MOST_ANGLE_OF_TWO, _MOST_DISTANCE_RATIO_OF_TWO,
        )  # fmt: skip
        expected[image, other] = wanted.sum()
        seen[image, other] = np.isin(feature[wanted], matched.get((image, other), ())).sum()
    points = expected + expected.T
    shares = np.where(points >= 2 * FEWEST_MATCHES, (seen + seen.T) / np.maximum(points, 1), np.nan)
    matching = shares >= _LEAST_MATCHED
    joined = _find_stays(np.ones_like(matching), matching)
    apart = (shares < _LEAST_MATCHED) & ~joined
    doubted = apart.any(axis=1)
    if apart.sum() <= 2 * max(apart.sum(axis=1).max(), HELD_BY - 1):
        doubted[:] = False
    return _Evidence(shares, joined, doubted, np.where(apart, points - seen - seen.T, 0))


def _find_stays(same_place: np.ndarray, joined: np.ndarray) -> np.ndarray:
    """Returns (N, N) bool: joins lead from one image to the other without leaving the place."""
    stay = np.eye(len(joined), dtype=bool)
    for image, here in enumerate(same_place):
        reached, fresh = stay[image], stay[image]
        while fresh.any():
            fresh = joined[fresh].any(axis=0) & here & ~reached
            reached = reached | fresh
        stay[image] = reached
    return stay | stay.T


def _sample_observations(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Returns (N, P) bool, which images observe some of the points, and these points (P,)."""
    views = np.bincount(solution.observations[:, 0], minlength=len(solution.points))
    chosen = np.flatnonzero(views >= HELD_BY)
    chosen = chosen[:: max(1, -(-len(chosen) // ENOUGH_SAMPLES))]
    place = np.full(len(views), -1)
    place[chosen] = np.arange(len(chosen))
    rows = place[solution.observations[:, 0]]
    observed = np.zeros((len(solution.names), len(chosen)), bool)
    observed[solution.observations[rows >= 0, 1], rows[rows >= 0]] = True
    return observed, chosen


def _group_images(observed: np.ndarray, registered: np.ndarray) -> np.ndarray:
    """Returns (N, G) each image, and those that share most points with it."""
    values = observed.astype(np.float32)
    common = values @ values.T
    size = min(_GROUP_SIZE, len(common))
    groups = np.repeat(np.arange(len(common))[:, None], size, axis=1)
    for image in np.flatnonzero(registered):
        common[image, image] = np.inf
        groups[image] = np.argsort(-common[image], kind="stable")[:size]
    return groups


def _count_in_groups(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Counts (N, P) the images of each group for which `values` (N, P) bool is true."""
    return values[groups].sum(axis=1, dtype=np.int8)


def _compare_views(
    solution: Solution, observed: np.ndarray, chosen: np.ndarray, groups: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Counts (N, N) the points of the first image that the second should see, and does see."""
    count = len(observed)
    points, centers = solution.points[chosen], find_centers(solution.camera_from_world)
    in_view = np.zeros(observed.shape, bool)
    images = np.flatnonzero(solution.registered & observed.any(axis=1))
    for image in images:
        in_view[image] = _is_in_view(solution, int(image), points)
    stable = observed & (_count_in_groups(observed, groups) >= HELD_BY)
    expected, seen = np.zeros((count, count)), np.zeros((count, count))
    for image in images:
        own = np.flatnonzero(stable[image])
        own = own[:: max(1, len(own) // ENOUGH_MATCHES)]
        if not len(own):
            continue
        same_view = np.zeros((count, len(own)), bool)
        ray = points[own] - centers[image]
        moved = np.linalg.norm(centers - centers[image], axis=1)
        close = np.flatnonzero(moved < _MOST_MOVED * np.linalg.norm(ray, axis=1).max())
        rays = points[own] - centers[close, None]
        alike = _is_seen_alike(ray, rays, _MOST_ANGLE, _MOST_DISTANCE_RATIO)
        same_view[close] = in_view[close][:, own] & alike
        wanted = same_view & (_count_in_groups(same_view, groups) >= HELD_BY)
        found = _count_in_groups(observed[:, own], groups) > 0
        expected[image] = wanted.sum(axis=1)
        seen[image] = (wanted & found).sum(axis=1)
    return expected, seen


def _is_in_view(solution: Solution, image: int, points: np.ndarray) -> np.ndarray:
    """Returns (N,) bool: points (N, 3) lie in the image, and not at its margin."""
    camera, pose = solution.cameras[image], solution.camera_from_world[image]
    pixels, valid = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
    inside = np.abs(pixels / [camera.width, camera.height] - 0.5) < 0.5 - _MARGIN
    return valid & inside.all(axis=1)


def _is_seen_alike(
    ray: np.ndarray, rays: np.ndarray, most_angle: float, most_ratio: float
) -> np.ndarray:
    """Returns bool: rays (..., 3) to points from two centers differ little in way and length."""
    distance, far = np.linalg.norm(ray, axis=-1), np.linalg.norm(rays, axis=-1)
    cosine = (rays * ray).sum(axis=-1) / np.maximum(far * distance, 1e-300)
    ratio = far / distance
    return (cosine > np.cos(most_angle)) & (ratio < most_ratio) & (ratio > 1 / most_ratio)
