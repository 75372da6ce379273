"""A path through a scene that stays where photographs were taken and looks where they looked."""

from __future__ import annotations

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.render.paths import find_mean_up, smooth_path

# Photographs on the way: enough to follow a walk, few enough for a calm eye.
_MOST_STOPS = 24
# A turn by this angle counts as far as a way of the cameras' spread.
_TURN_RADIANS = 1.5
# The way back to the first stop is part of the path where it is at most this many times as
# long as the others in the median: cameras around an object.
_CLOSING = 2.5


@name_wrong_kinds
def make_tour_path(
    camera_from_world: np.ndarray, num_frames: int, up: np.ndarray | None = None
) -> np.ndarray:
    """Makes a smooth tour of the photographs' own poses.

    Photographs far from each other are chosen as stops and visited on a short way (farthest points,
    then a tour improved by reversals); between stops `smooth_path` leads. Nothing is looked at from
    where, or in a direction that, no photograph near by had. The horizon is level throughout.

    Args:
        camera_from_world: (N, 4, 4) poses of the photographs, N >= 1.
        num_frames: number of poses wanted, >= 1.
        up: (3,) of the world; None: the cameras' mean up.

    Returns:
        (num_frames, 4, 4) float64 camera_from_world; closed where the tour comes around.
    """
    poses = np.asarray(camera_from_world, np.float64)
    up = find_mean_up(poses) if up is None else up
    places = _describe_places(poses)
    stops = _choose_far_places(places, min(_MOST_STOPS, len(poses)))
    if len(stops) <= 2:
        return smooth_path(poses[stops], num_frames, up=up)
    apart = np.linalg.norm(places[stops][:, None] - places[stops][None], axis=2)
    tour = _find_short_way(apart)
    closed = bool(apart[tour[-1], tour[0]] <= _CLOSING * np.median(apart[tour[1:], tour[:-1]]))
    first = int(np.argmin(stops[tour]))
    if closed:
        tour = np.roll(tour, -first)
    elif first > len(tour) // 2:
        tour = tour[::-1]
    return smooth_path(poses[stops[tour]], num_frames, closed=closed, up=up)


def _describe_places(poses: np.ndarray) -> np.ndarray:
    """Describes where each camera stands and looks (N, 6), in units in which both count alike."""
    centers = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    spread = np.sqrt(np.mean(np.sum((centers - centers.mean(axis=0)) ** 2, axis=1)))
    forward = poses[:, 2, :3]
    return np.concatenate([centers / (spread or 1.0), forward / _TURN_RADIANS], axis=1)


def _choose_far_places(places: np.ndarray, count: int) -> np.ndarray:
    """Chooses places far from each other, by index: the first, then each time the farthest."""
    chosen = [0]
    nearest = np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < count and nearest.max() > 0:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.array(chosen)


def _find_short_way(apart: np.ndarray) -> np.ndarray:
    """Finds a short way through all places: the nearest next, then reversals (2-opt).

    A place that is near to all others closes the way to a tour, whose ends it then is between.
    """
    count = len(apart) + 1
    joined = np.zeros((count, count))
    joined[1:, 1:] = apart
    tour, left = [0], set(range(1, count))
    while left:
        tour.append(min(left, key=lambda place: (joined[tour[-1], place], place)))
        left.remove(tour[-1])
    way = np.array(tour)
    better = True
    while better:
        better = False
        for begin in range(count - 1):
            for end in range(begin + 2, count - (begin == 0)):
                a, b, c, d = way[begin], way[begin + 1], way[end], way[(end + 1) % count]
                if joined[a, c] + joined[b, d] < joined[a, b] + joined[c, d] - 1e-12:
                    way[begin + 1 : end + 1] = way[begin + 1 : end + 1][::-1]
                    better = True
    return np.roll(way, -int(np.argmin(way)))[1:] - 1
