"""Places that look alike, taken for one: images at one place by their poses that see other things.

Rooms with the same furniture, walked through alike, contradict nothing by the rotations of pairs
(see `contradictions`): the furniture fits. What stands around it does not: of the points that
several images of one room see, those of the other room see only the furniture's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.data.poses import find_centers
from gsut.sfm.core.matching import PairMatches
from gsut.sfm.core.solution import Solution

# Points are compared where both images see them from nearly the same side and distance, and a
# margin inside the picture: there features are found again, and little is hidden.
_ANGLE = np.radians(6.0)
_DISTANCE = 1.2
_MARGIN = 0.04
_MOVED = 0.25  # of the distance: farther apart, no two images are that near
# An image with those that share most points with it; a point must be seen by so many of one such
# group and be in view of so many of the other.
_GROUP, _SEEN_BY, _IN_VIEW_OF = 4, 3, 3
_MOST_POINTS, _MOST_OF_IMAGE = 20_000, 300
# Such points of a pair of images, and of the one that has fewer.
_EXPECTED, _EXPECTED_OF_EITHER = 20, 8
# Share of them that is seen, in the mean over an image's pairs, below which the image is doubted:
# 0.77 and more for true loops, below 0.6 for half of the images of folded walks. So many pairs of
# an image, images, and share of the images that can tell, count.
_SHARE, _PAIRS, _IMAGES, _OF_ALL = 0.6, 2, 3, 0.1
_ROUNDS = 2
_LEFT = 0.2  # share of the images with a pose that must keep one, or what was found stays, doubted


@dataclasses.dataclass(frozen=True)
class LookAlikes:
    """What speaks for places that were taken for one.

    Args:
        pairs: of image names at one place by their poses, worst first, one of a doubted image each.
        shares: of each, of what one of both sees there, the share that the other sees.
        images: names of all that are doubted.
    """

    pairs: list[tuple[str, str]]
    shares: list[float]
    images: list[str]

    def words(self) -> str:
        """The reason of a verdict."""
        (one, other), share = self.pairs[0], self.shares[0]
        return (
            f"places that look alike may be taken for one: by their poses {one} and {other} show "
            f"the same, and only {100 * share:.0f} % of it is seen in both; this concerns "
            f"{len(self.images)} images: {list_some(self.images)}"
        )

    def figures(self) -> dict[str, object]:
        """Of poses.json."""
        return {
            "images": self.images,
            "pairs": [
                {"images": list(pair), "seen_in_both": round(share, 3)}
                for pair, share in zip(self.pairs, self.shares, strict=True)
            ],
        }


@dataclasses.dataclass(frozen=True)
class ToldApart:
    """What `tell_apart` makes of a solution.

    Args:
        solution, pairs: it, and the pairs that it is made of.
        dropped: how many were left out for it.
        doubt: what still speaks for places taken for one, or None.
    """

    solution: Solution
    pairs: list[PairMatches]
    dropped: int = 0
    doubt: LookAlikes | None = None

    def words(self) -> list[str]:
        """What a user should know of it."""
        if not self.dropped:
            return []
        return [
            f"{self.dropped} of {self.dropped + len(self.pairs)} pairs of images were left out: "
            "they took places that look alike for one"
        ]

    def figures(self) -> dict[str, object]:
        """Of poses.json."""
        return {"look_alikes": None if self.doubt is None else self.doubt.figures()}


@dataclasses.dataclass(frozen=True)
class _Evidence:
    """What images see of each other.

    Args:
        shares: (N, N) of what either should see of the other's points; NaN: unknown.
        joined: (N, N) bool, surely: near in time, or, where that is not known, with a neighbour in
            common.
        doubted: (N,) bool.
    """

    shares: np.ndarray
    joined: np.ndarray
    doubted: np.ndarray


def find_look_alikes(
    solution: Solution, times: np.ndarray | None = None, near: int = 0
) -> LookAlikes | None:
    """Images whose poses say that they show the same, and whose points say that they do not.

    Args:
        solution: poses and points.
        times: (N,) int64, number of each image's frame in order of time; None: not known.
        near: frames whose numbers differ by so much at most are not compared: they surely follow
            each other; nor are others, between which the camera did not leave the place.

    Returns:
        What speaks for it; None where nothing does, or too little can tell.
    """
    return _named(solution, _evidence(solution, times, near))


def tell_apart(
    solution: Solution,
    pairs: list[PairMatches],
    solve: Callable[[list[PairMatches]], Solution],
    times: np.ndarray | None = None,
    near: int = 0,
) -> ToldApart:
    """Maps again without the joins that took places for one.

    Args:
        solution: as it was mapped. pairs: verified, of all images.
        solve: the mapper.
        times, near: see `find_look_alikes`. Only frames near each other in time stay joined, or,
            where times are not known, images that share a neighbour: a false join of others may
            look right, and one is enough to fold the whole.

    Returns:
        What is left; all as it was where no image is doubted, or where too little is left.
    """
    told, found = ToldApart(solution, pairs), _evidence(solution, times, near)
    for _ in range(_ROUNDS):
        if not found.doubted.any():
            break
        kept = [pair for pair in told.pairs if found.joined[pair.first, pair.second]]
        if len(kept) == len(told.pairs):
            break
        try:
            fresh = solve(kept)
        except SolveError:
            break
        if fresh.num_registered < _LEFT * solution.num_registered:
            break
        told, found = ToldApart(fresh, kept, len(pairs) - len(kept)), _evidence(fresh, times, near)
    return dataclasses.replace(told, doubt=_named(told.solution, found))


def _named(solution: Solution, found: _Evidence) -> LookAlikes | None:
    """The evidence in words."""
    doubted = np.flatnonzero(found.doubted)
    if not len(doubted):
        return None
    pairs: dict[tuple[str, str], float] = {}
    for image in sorted(doubted, key=lambda image: np.nanmin(found.shares[image])):
        other = int(np.nanargmin(found.shares[image]))
        first, second = sorted((int(image), other))
        pairs[solution.names[first], solution.names[second]] = float(found.shares[image, other])
    names = [solution.names[image] for image in doubted]
    return LookAlikes(list(pairs), list(pairs.values()), names)


def _evidence(solution: Solution, times: np.ndarray | None, near: int) -> _Evidence:
    observed, chosen = _observed(solution)
    groups = _groups(observed, solution.registered)
    expected, seen = _compared(solution, observed, chosen, groups)
    joined = (groups[:, None, :, None] == groups[None, :, None, :]).any(axis=(2, 3))
    together = joined
    if times is not None:
        joined = np.abs(times[:, None] - times) <= near
    together = together | joined | _one_stay(expected + expected.T >= _EXPECTED, joined)
    known = (expected + expected.T >= _EXPECTED) & ~together
    known &= np.minimum(expected, expected.T) >= _EXPECTED_OF_EITHER
    shares = np.where(known, (seen + seen.T) / np.maximum(expected + expected.T, 1), np.nan)
    of_image = known.sum(axis=1)
    mean = np.where(known, shares, 0).sum(axis=1) / np.maximum(of_image, 1)
    can_tell = of_image >= _PAIRS
    doubted = can_tell & (mean < _SHARE)
    if doubted.sum() < max(_IMAGES, _OF_ALL * can_tell.sum()):
        doubted[:] = False
    return _Evidence(shares, joined, doubted)


def _one_stay(same_place: np.ndarray, joined: np.ndarray) -> np.ndarray:
    """(N, N) bool, whether joins lead from an image to another without leaving the place."""
    stay = np.eye(len(joined), dtype=bool)
    for image, here in enumerate(same_place):
        reached, fresh = stay[image], stay[image]
        while fresh.any():
            fresh = joined[fresh].any(axis=0) & here & ~reached
            reached = reached | fresh
        stay[image] = reached
    return stay | stay.T


def _observed(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """(N, P) bool, which images observe some of the points, and which points (P,) these are."""
    views = np.bincount(solution.observations[:, 0], minlength=len(solution.points))
    chosen = np.flatnonzero(views >= _SEEN_BY)
    chosen = chosen[:: max(1, -(-len(chosen) // _MOST_POINTS))]
    place = np.full(len(views), -1)
    place[chosen] = np.arange(len(chosen))
    rows = place[solution.observations[:, 0]]
    observed = np.zeros((len(solution.names), len(chosen)), bool)
    observed[solution.observations[rows >= 0, 1], rows[rows >= 0]] = True
    return observed, chosen


def _groups(observed: np.ndarray, registered: np.ndarray) -> np.ndarray:
    """(N, _GROUP) each image, and those that share most points with it."""
    values = observed.astype(np.float32)
    common = values @ values.T
    groups = np.repeat(np.arange(len(common))[:, None], _GROUP, axis=1)
    for image in np.flatnonzero(registered):
        common[image, image] = np.inf
        groups[image] = np.argsort(-common[image], kind="stable")[:_GROUP]
    return groups


def _times(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """(N, P) how many images of each group `values` (N, P) bool is true of."""
    return values[groups].sum(axis=1, dtype=np.int8)


def _compared(
    solution: Solution, observed: np.ndarray, chosen: np.ndarray, groups: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, N) how many points of the first image the second should see, and how many it does."""
    count = len(observed)
    points, poses = solution.points[chosen], solution.camera_from_world
    centers = find_centers(poses)
    in_view = np.zeros(observed.shape, bool)
    images = np.flatnonzero(solution.registered & observed.any(axis=1))
    for image in images:
        camera = solution.cameras[image]
        pixels, valid = camera.project(points @ poses[image, :3, :3].T + poses[image, :3, 3])
        size = np.array([camera.width, camera.height])
        inside = np.abs(pixels / size - 0.5) < 0.5 - _MARGIN
        in_view[image] = valid & inside.all(axis=1)
    stable = observed & (_times(observed, groups) >= _SEEN_BY)
    expected, seen = np.zeros((count, count)), np.zeros((count, count))
    for image in images:
        own = np.flatnonzero(stable[image])
        own = own[:: max(1, len(own) // _MOST_OF_IMAGE)]
        if not len(own):
            continue
        same_view = np.zeros((count, len(own)), bool)
        ray = points[own] - centers[image]
        distance = np.linalg.norm(ray, axis=1)
        moved = np.linalg.norm(centers - centers[image], axis=1)
        close = np.flatnonzero(moved < _MOVED * distance.max())
        rays = points[own] - centers[close, None]
        far = np.linalg.norm(rays, axis=2)
        cosine = (rays * ray).sum(axis=2) / np.maximum(far * distance, 1e-300)
        ratio = far / distance
        same_side = (cosine > np.cos(_ANGLE)) & (ratio < _DISTANCE) & (ratio > 1 / _DISTANCE)
        same_view[close] = in_view[close][:, own] & same_side
        wanted = same_view & (_times(same_view, groups) >= _IN_VIEW_OF)
        found = _times(observed[:, own], groups) > 0
        expected[image] = wanted.sum(axis=1)
        seen[image] = (wanted & found).sum(axis=1)
    return expected, seen
