"""Measures by how many pixels two structures of the same images, or two lenses, differ."""

from __future__ import annotations

import itertools
import math

import numpy as np

from gsut.data.poses import find_centers
from gsut.gaussians import find_nearest_rotation, measure_rotation_angles
from gsut.judge import measure_pixels_per_radian
from gsut.lens import Camera, spread_pixels
from gsut.sampling import choose_evenly
from gsut.sfm.matches import ALL_UP_TO
from gsut.sfm.solution import Solution, measure_diagonal, transform_to_cameras

# Baseline over the distance of what is seen, below which a pair has no direction to get wrong.
_NO_BASELINE = 0.005


def measure_pose_differences(one: Solution, other: Solution, solution: Solution) -> np.ndarray:
    """Measures by how many pixels the relative poses of pairs of images differ (P,).

    By the turn between the two images, and by the direction of the baseline as far as it turns what
    is seen. Pairs of which an image has no pose left differ without limit.
    """
    images = choose_evenly(np.flatnonzero(solution.registered).tolist(), ALL_UP_TO)
    first, second = np.array(list(itertools.combinations(images, 2))).T
    turns, ways = [], []
    for each in (one, other):
        rotation, centers = each.camera_from_world[:, :3, :3], find_centers(each.camera_from_world)
        turns.append(rotation[second] @ rotation[first].transpose(0, 2, 1))
        ways.append(np.einsum("nij,nj->ni", rotation[second], centers[first] - centers[second]))
    turned = measure_rotation_angles(turns[0] @ turns[1].transpose(0, 2, 1))
    sine = np.linalg.norm(np.cross(*ways), axis=1)
    direction = np.arctan2(sine, np.einsum("ni,ni->n", *ways))
    seen = transform_to_cameras(solution.points, solution.observations, solution.camera_from_world)
    baseline = np.linalg.norm(ways[0], axis=1) / np.median(np.linalg.norm(seen, axis=1))
    direction = np.where(baseline > _NO_BASELINE, np.minimum(baseline, 1.0) * direction, 0.0)
    kept = one.registered & other.registered
    angle = np.where(kept[first] & kept[second], np.maximum(turned, direction), np.inf)
    return angle * measure_pixels_per_radian(solution.cameras[int(images[0])])


def measure_lens_difference(one: Camera, other: Camera) -> float:
    """Measures by how many pixels two lenses differ over a picture, the best turn taken out.

    Returns:
        Root mean square, at most the diagonal, which it is where they have no ray in common.
    """
    pixels, diagonal = spread_pixels(one.width, one.height).reshape(-1, 2), measure_diagonal([one])
    (rays, valid), (others, also) = (each.unproject(pixels) for each in (one, other))
    both = valid & also
    if not both.any():
        return diagonal
    turn = find_nearest_rotation(rays[both].T @ others[both])
    places, seen = one.project(others[both] @ turn.T)
    error = np.sum((places - pixels[both])[seen] ** 2, axis=1)
    return min(math.sqrt(np.mean(error)), diagonal) if seen.any() else diagonal
