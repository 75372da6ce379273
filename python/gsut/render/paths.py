"""Camera paths: smoothly through given poses, or around a scene."""

from __future__ import annotations

import math

import numpy as np

from gsut.bounds import check_direction, check_number, name_wrong_kinds
from gsut.gaussians import find_nearest_rotation

# The optical axes have a common point to look at where the least eigenvalue of their mean
# perpendicular projector is above this (0 = parallel, 2/3 = all directions alike) ...
_LEAST_CONVERGENCE = 1e-3
# ... and where this fraction of the cameras has that point in front.
_LEAST_FACING = 0.75
# Radius of a turn on the spot over the cameras' spread: some parallax, still where they stood.
_TURN_RADIUS = 0.25
# Radians between a view and straight up or down, below which it keeps the roll of its photographs,
# since it sees no horizon, and above which it stands level; between them the roll fades.
_STEEP = math.radians(10.0)
_LEVEL = math.radians(25.0)


@name_wrong_kinds
def smooth_path(
    camera_from_world: np.ndarray,
    num_frames: int,
    closed: bool = False,
    up: np.ndarray | None = None,
) -> np.ndarray:
    """Makes poses that pass smoothly through key poses, at even speed.

    Cubic Hermite curves through the camera centres and, alike, through the rotation matrices, each
    then replaced by the nearest rotation (between two poses the great arc that slerp takes); knots
    are spaced by distance and turn, so that close keys are not lingered on.

    Args:
        camera_from_world: (N, 4, 4) rigid key poses in order, N >= 1.
        num_frames: number of poses wanted, >= 1; the first and last keys are among them.
        closed: come back to the first key (which is then not repeated).
        up: (3,) of the world, along which the horizon is level; None: the roll of the keys.

    Returns:
        (num_frames, 4, 4) float64 camera_from_world.
    """
    num_frames = check_number(num_frames, "num_frames", 1, whole=True)
    keys = np.linalg.inv(np.asarray(camera_from_world, np.float64))[:, :3]  # world_from_camera
    if closed and len(keys) > 1:
        keys = np.concatenate([keys, keys[:1]])
    if len(keys) == 1:
        keys = np.repeat(keys, 2, axis=0)
    knots = np.concatenate([[0.0], np.cumsum(_measure_spacing(keys))])
    time = np.linspace(0.0, knots[-1], num_frames + 1 if closed else num_frames)[:num_frames]

    tangents = np.empty_like(keys)
    tangents[1:-1] = (keys[2:] - keys[:-2]) / (knots[2:] - knots[:-2])[:, None, None]
    # Open ends: the parabola through the end, its neighbour and the neighbour's tangent.
    first = (keys[1] - keys[0]) / knots[1]
    last = (keys[-1] - keys[-2]) / (knots[-1] - knots[-2])
    tangents[0] = 2 * first - tangents[1] if len(keys) > 2 else first
    tangents[-1] = 2 * last - tangents[-2] if len(keys) > 2 else last
    if closed:
        around = (keys[1] - keys[-2]) / (knots[1] + knots[-1] - knots[-2])
        tangents[0] = tangents[-1] = around

    left = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(keys) - 2)
    width = knots[left + 1] - knots[left]
    t = (time - knots[left]) / width
    weights = np.stack(
        [
            (1 + 2 * t) * (1 - t) ** 2,
            t * (1 - t) ** 2 * width,
            t**2 * (3 - 2 * t),
            t**2 * (t - 1) * width,
        ]
    )[..., None, None]
    parts = np.stack([keys[left], tangents[left], keys[left + 1], tangents[left + 1]])
    path = _camera_from_world(np.sum(weights * parts, axis=0))
    return path if up is None else _rotate_to_level(path, up)


def _rotate_to_level(camera_from_world: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Turns cameras about their views so that the horizon is level.

    Views straight up or down see no horizon and keep their roll.

    Args:
        camera_from_world: (N, 4, 4) poses.
        up: (3,) of the world, any length but 0.

    Returns:
        (N, 4, 4) float64 camera_from_world with the same centres and views.
    """
    poses = np.array(camera_from_world, np.float64)
    axis = check_direction(up, "up")
    own, view = -poses[:, 1, :3], poses[:, 2, :3]
    aside = np.cross(view, own)
    roll = np.arctan2(aside @ axis, own @ axis)
    steep = np.arcsin(np.clip(np.linalg.norm(np.cross(view, axis), axis=1), 0, 1))
    share = np.clip((steep - _STEEP) / (_LEVEL - _STEEP), 0, 1)
    angle = (roll * share**2 * (3 - 2 * share))[:, None]
    down = -(np.cos(angle) * own + np.sin(angle) * aside)
    levelled = np.stack([np.cross(down, view), down, view], axis=1)
    centers = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    poses[:, :3, :3] = levelled
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", levelled, centers)
    return poses


def find_mean_up(camera_from_world: np.ndarray) -> np.ndarray:
    """Finds (3,) the cameras' mean up, of length 1; the first's where they face all ways."""
    ups = -np.asarray(camera_from_world, np.float64)[:, 1, :3]
    up = ups.mean(axis=0)
    length = np.linalg.norm(up)
    return up / length if length > _LEAST_CONVERGENCE else ups[0]


@name_wrong_kinds
def make_orbit_path(
    camera_from_world: np.ndarray, num_frames: int, up: np.ndarray | None = None
) -> np.ndarray:
    """Makes one closed orbit of a scene, from the poses it was photographed with.

    Where most cameras look at a common point: a circle around it at their mean distance and
    height. Else (a walk, or cameras that look outward): a full turn of the view near their
    centre.

    Args:
        camera_from_world: (N, 4, 4) poses of the photographs, N >= 1.
        num_frames: number of poses wanted, >= 1.
        up: (3,) of the world; None: the cameras' mean up.

    Returns:
        (num_frames, 4, 4) float64 camera_from_world.
    """
    world_from_camera = np.linalg.inv(np.asarray(camera_from_world, np.float64))
    centers = world_from_camera[:, :3, 3]
    forward = world_from_camera[:, :3, 2]
    num_frames = check_number(num_frames, "num_frames", 1, whole=True)
    up = find_mean_up(camera_from_world) if up is None else check_direction(up, "up")
    middle = centers.mean(axis=0)

    angle = 2 * np.pi * np.arange(num_frames) / num_frames
    first = forward[0] - up * (up @ forward[0])
    if np.linalg.norm(first) < _LEAST_CONVERGENCE:  # the first camera looks straight up or down
        first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first = first / np.linalg.norm(first)
    outward = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(up, first)

    look_at = _find_look_at(centers, forward)
    if look_at is None:
        spread = np.sqrt(np.mean(np.sum((centers - middle) ** 2, axis=1)))
        return _look(middle + _TURN_RADIUS * spread * outward, outward, up)
    height = (centers - look_at) @ up
    radius = np.mean(np.linalg.norm(centers - look_at - height[:, None] * up, axis=1))
    positions = look_at + height.mean() * up - radius * outward  # starts on the first camera's side
    return _look(positions, look_at - positions, up)


def turn_path(
    camera_from_world: np.ndarray, center: np.ndarray, up: np.ndarray, num_frames: int
) -> np.ndarray:
    """Makes a full turn around a point, starting from a pose.

    Args:
        camera_from_world: (4, 4) the first pose.
        center, up: (3,) the point and the axis through it.
        num_frames: number of poses wanted, >= 1.

    Returns:
        (num_frames, 4, 4) float64 camera_from_world.
    """
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = 2 * np.pi * np.arange(num_frames)[:, None, None] / num_frames
    turned = np.tile(np.eye(4), (num_frames, 1, 1))
    turned[:, :3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    turned[:, :3, 3] = center - turned[:, :3, :3] @ center
    return np.asarray(camera_from_world, np.float64) @ turned


def _measure_spacing(keys: np.ndarray) -> np.ndarray:
    """Measures the distances (N-1,) > 0 of neighbouring poses (3, 4): way plus turn, scale-free."""
    way = np.linalg.norm(np.diff(keys[:, :, 3], axis=0), axis=1)
    relative = np.einsum("nji,njk->nik", keys[:-1, :, :3], keys[1:, :, :3])
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    tiny = np.finfo(np.float64).eps
    length = way / max(way.sum(), tiny) + turn / max(turn.sum(), tiny)
    return np.maximum(length, 1e-3 / len(length))  # keys at one place still take some time


def _find_look_at(centers: np.ndarray, forward: np.ndarray) -> np.ndarray | None:
    """Finds the point nearest to all optical axes in the least-squares sense, if there is one."""
    projectors = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    matrix = projectors.mean(axis=0)
    if np.linalg.eigvalsh(matrix)[0] < _LEAST_CONVERGENCE:
        return None
    point = np.linalg.solve(matrix, np.einsum("nij,nj->i", projectors, centers) / len(centers))
    in_front = np.sum((point - centers) * forward, axis=1) > 0
    return point if in_front.mean() >= _LEAST_FACING else None


def _look(positions: np.ndarray, directions: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Returns camera_from_world (N, 4, 4) of cameras that look along directions, `up` upward."""
    z = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    x = np.cross(z, up)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return _camera_from_world(np.stack([x, np.cross(z, x), z, positions], axis=-1))


def _camera_from_world(world_from_camera: np.ndarray) -> np.ndarray:
    """Inverts poses (N, 3, 4), whose left part is brought to the nearest rotation."""
    rotation = np.swapaxes(find_nearest_rotation(world_from_camera[:, :, :3]), 1, 2)
    result = np.tile(np.eye(4), (len(rotation), 1, 1))
    result[:, :3, :3] = rotation
    result[:, :3, 3] = -np.einsum("nij,nj->ni", rotation, world_from_camera[:, :, 3])
    return result
