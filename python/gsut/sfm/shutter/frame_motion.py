"""How a camera moved at each frame of a video: from the flow of its pictures and the points."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from gsut.lens import Camera
from gsut.sfm.core import Solution, in_cameras

_FEWEST = 8  # corners whose depth is known
_NEAR = 0.08  # of the diagonal: a corner has the depth of the points so near it, at most
_NEAREST = 3
_ROUNDS = 10
_STEP = 1e-4  # radians and distances to the points, of the differences


def rates_of_frames(
    solution: Solution, flows: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities of the images, as in `Solution.velocities` but in a second.

    Args:
        solution: poses and points, which may be those of a global shutter.
        flows: by name of the image (M, 4): pixels, and how far they move in a second.

    Returns:
        (N, 6), and its covariances (N, 6, 6) by what the flow leaves; NaN where an image has no
        pose or too little flow.
    """
    rates = np.full((len(solution.names), 6), np.nan)
    covariances = np.full((len(solution.names), 6, 6), np.nan)
    depths = in_cameras(solution.points, solution.observations, solution.camera_from_world)
    distances = np.linalg.norm(depths, axis=1)
    for image in np.flatnonzero(solution.registered):
        flow = flows.get(solution.names[image])
        if flow is None:
            continue
        seen = solution.observations[:, 1] == image
        distance = _distances(solution.pixels[seen], distances[seen], flow[:, :2],
                              solution.cameras[image])  # fmt: skip
        rates[image], covariances[image] = _rate(
            solution.camera_from_world[image], solution.cameras[image], flow, distance
        )
    return rates, covariances


def _distances(
    pixels: np.ndarray, distances: np.ndarray, at: np.ndarray, camera: Camera
) -> np.ndarray:
    """(M,) from the camera to what is seen at pixels (M, 2), by the points around; NaN: unknown."""
    if len(pixels) < _NEAREST:
        return np.full(len(at), np.nan)
    away = np.linalg.norm(at[:, None] - pixels[None], axis=2)
    nearest = np.argsort(away, axis=1, kind="stable")[:, :_NEAREST]
    near = np.take_along_axis(away, nearest, axis=1)[:, -1]
    found = np.median(distances[nearest], axis=1)
    return np.where(near < _NEAR * np.hypot(camera.width, camera.height), found, np.nan)


def _rate(
    camera_from_world: np.ndarray, camera: Camera, flow: np.ndarray, distance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(6,) by least squares, corners that do not fit counting less, and (6, 6); NaN: too few."""
    unknown = np.full(6, np.nan), np.full((6, 6), np.nan)
    rays, valid = camera.unproject(flow[:, :2])
    good = valid & np.isfinite(distance)
    if good.sum() < _FEWEST:
        return unknown
    points, speed = rays[good] * distance[good, None], flow[good, 2:]
    columns = []
    middle = float(np.median(distance[good]))
    for axis in range(6):
        moves = []
        for sign in (1, -1):
            change = np.zeros(3)
            change[axis % 3] = sign * _STEP
            # The centre moves in the world, and the camera turns: p <- exp(w) (p - R v).
            moved = (
                points - middle * camera_from_world[:3, :3] @ change
                if axis < 3
                else points + np.cross(change, points)
            )
            moves.append(camera.project(moved)[0])
        scale = middle if axis < 3 else 1.0
        columns.append((moves[0] - moves[1]) / (2 * _STEP * scale))
    matrix = np.stack(columns, axis=2)  # (M, 2, 6) pixels
    kept = np.isfinite(matrix).all(axis=(1, 2))
    matrix, speed = matrix[kept], speed[kept]
    if len(matrix) < _FEWEST:
        return unknown
    # Shifts and turns of a size: the normal equations stay well scaled.
    size = np.array([1 / middle] * 3 + [1.0] * 3)
    weight = np.ones(len(matrix))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        left = (root[:, :, None] * matrix / size).reshape(-1, 6)
        found = np.linalg.lstsq(left, (root * speed).ravel(), rcond=None)[0] / size
        off = np.linalg.norm(speed - matrix @ found, axis=1)
        weight = 1 / (1 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    variance = float(np.median(off)) ** 2 / (2 * math.log(2)) * len(matrix) / (len(matrix) - 3)
    normal = left.T @ left
    return found, variance * np.linalg.pinv(normal) / np.outer(size, size)
