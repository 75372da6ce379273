"""Finds which way is up: by how cameras were held, by GPS along a path, and by sensors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut.orientation import count_turns, turn_camera
from gsut.sfm.solution import Solution
from gsut.sfm.world.positions import FEWEST_PLACES

_ROLL = math.radians(5.0)  # standard deviation: people and drones hold cameras level
_PITCH = math.radians(25.0)  # standard deviation: they look up and down
_LEVELLED = math.radians(3.0)  # the same, of panoramas: 360-degree cameras level them
_STRAIGHT = 0.1  # second over first extent of a path, below which its slope is that of GPS
SAME_UP = math.radians(15.0)  # between statements of up that agree
MOST_TILT = 0.15  # radians: two standard deviations of up beyond which it is not known


@dataclasses.dataclass(frozen=True)
class Held:
    """How the cameras were held: mean of their own up, (3, 3) mean square of their level axes.

    `pitch` is the standard deviation, in radians, of how far they looked up or down.
    """

    mean: np.ndarray
    spread: np.ndarray
    count: int
    pitch: float = _PITCH

    @property
    def information(self) -> np.ndarray:
        """A matrix (3, 3) whose quadratic form is least for up."""
        return self.count * self.spread / _ROLL**2 - np.outer(self.mean, self.mean) / self.pitch**2

    def is_level(self, up: np.ndarray, sigma: float) -> bool:
        """Returns whether cameras were held level against `up`, and it is known."""
        roll = math.sqrt(max(0.0, float(up @ self.spread @ up)))
        return roll <= math.sin(SAME_UP) and 2 * sigma <= MOST_TILT


def find_held(solution: Solution, orientations: dict[str, int]) -> Held | None:
    """Measures how the cameras were held; None: too few are known, or each differently."""
    ups, levels = [], []
    for i in np.flatnonzero(solution.registered):
        if solution.names[i] not in orientations:
            continue
        turns = count_turns(orientations[solution.names[i]])
        shown = turn_camera(solution.camera_from_world[i], turns)
        ups.append(-shown[1, :3])
        levels.append(shown[0, :3])
    is_level = any(camera.model == "equirectangular" for camera in solution.cameras[:1])
    if len(ups) < (1 if is_level else FEWEST_PLACES):
        return None
    mean = np.mean(ups, axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.5:
        return None
    spread = np.transpose(levels) @ np.array(levels) / len(levels)
    return Held(mean / length, spread, len(ups), _LEVELLED if is_level else _PITCH)


def find_measured_up(
    solution: Solution, ups: dict[str, tuple[float, float, float]], held: np.ndarray | None
) -> tuple[np.ndarray | None, list[str]]:
    """Finds up in the solution's world by sensors whose statements agree with the poses.

    Args:
        ups: in the camera's axes, by name.
        held: up by how the cameras were held, or None.

    Returns:
        Up, None if it is not known, and notes on what disagrees.
    """
    index = [i for i, n in enumerate(solution.names) if solution.registered[i] and n in ups]
    if len(index) < FEWEST_PLACES:
        return None, []
    given = np.array([ups[solution.names[i]] for i in index])
    world = np.einsum("nji,nj->ni", solution.camera_from_world[index, :3, :3], given)
    mean = np.median(world, axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    angles = np.arccos(np.clip(world @ mean, -1, 1))
    mean = world[angles <= max(2 * float(np.median(angles)), 1e-6)].mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    scatter = float(np.median(np.arccos(np.clip(world @ mean, -1, 1))))
    if scatter > SAME_UP:
        return None, [
            "the accelerometer or gimbal contradicts the poses and is not used: through them, what "
            f"it took for up scatters by {math.degrees(scatter):.0f} degrees (median); either the "
            "poses are wrong or it was not fixed to the camera"
        ]
    if held is not None and held @ mean < math.cos(SAME_UP):
        off = math.degrees(math.acos(float(np.clip(held @ mean, -1, 1))))
        return mean, [
            f"the cameras were held {off:.0f} degrees from level, by the accelerometer or gimbal, "
            f"which agrees with the poses to {math.degrees(scatter):.0f} degrees (median) and "
            "gives up"
        ]
    return mean, []


def find_up(held: Held) -> np.ndarray | None:
    """Finds up in the solution's world, from cameras that were held level; None: not known.

    It is perpendicular to the pictures' level axes, and near the mean of their own up.
    """
    values, axes = np.linalg.eigh(held.information)
    up = axes[:, 0] * np.sign(axes[:, 0] @ held.mean)
    sigma = 1 / math.sqrt(max(1e-12, float(values[1] - values[0])))
    return up if held.is_level(up, sigma) else None


def find_up_by_path(held: Held, centers: np.ndarray, target: np.ndarray) -> np.ndarray | None:
    """Finds up where all cameras looked alike along a straight path, whose slope GPS shows.

    Level axes of one direction leave open how far up leans along the view; the path shows it.

    Args:
        held: how the cameras were held.
        centers: (N, 3) of the cameras.
        target: (N, 3) of GPS: east, down, north.
    """
    middle = centers - centers.mean(axis=0)
    _, extents, axes = np.linalg.svd(middle, full_matrices=False)
    if extents[1] > _STRAIGHT * extents[0]:
        return None
    direction, along = axes[0], middle @ axes[0]
    fit = np.polyfit(along, target, 1)
    off = target[:, 1] - np.polyval(fit[:, 1], along)
    length = float(np.linalg.norm(fit[0]))
    # Heights of GPS drift, so more places do not make them better.
    slope_sigma = 2 * float(off.std()) / max(length * float(np.ptp(along)), 1e-9)
    if slope_sigma > MOST_TILT / 2:
        return None
    slope = -float(fit[0, 1]) / length
    aside = np.cross(direction, held.mean)
    aside /= max(float(np.linalg.norm(aside)), 1e-9)
    over = np.cross(aside, direction)
    angles = np.radians(np.arange(-60.0, 60.01, 0.1))
    flat = math.sqrt(max(0.0, 1 - slope**2))
    ups = slope * direction + flat * (
        np.cos(angles)[:, None] * over + np.sin(angles)[:, None] * aside
    )
    costs = np.einsum("ni,ij,nj->n", ups, held.information, ups)
    best = int(np.clip(np.argmin(costs), 1, len(costs) - 2))
    bend = (costs[best - 1] - 2 * costs[best] + costs[best + 1]) / (angles[1] - angles[0]) ** 2
    sigma = math.hypot(math.sqrt(2 / max(float(bend), 1e-12)), slope_sigma)
    return ups[best] if held.is_level(ups[best], sigma) else None
