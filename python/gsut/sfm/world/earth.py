"""Which way is up, and from GPS north and metres: where the evidence agrees, else the world stays.

The world becomes x east, y down, z north: scenes then stand upright where y points down, as it does
in cameras and in most viewers of Gaussians.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gsut.data.poses import find_centers
from gsut.gaussians import rotate_upright
from gsut.sfm.core import Solution, similarity

# Of WGS 84: metres, squared eccentricity.
_EARTH, _ECCENTRICITY = 6378137.0, 6.69437999014e-3
# Directions in the stored picture, by EXIF's orientation: up, and level.
_UP_OF = {1: (0, -1), 2: (0, -1), 3: (0, 1), 4: (0, 1), 5: (-1, 0), 6: (-1, 0), 7: (1, 0),
          8: (1, 0)}  # fmt: skip
# Radians, standard deviations: people and drones hold cameras level, but look up and down.
_ROLL, _PITCH = math.radians(5.0), math.radians(25.0)
_MOST_ROLL = math.radians(12.0)  # in the mean, beyond which cameras were not held level
_MOST_TILT = 0.15  # of two standard deviations of up, radians, beyond which it is not known
_FEWEST, _FEWEST_PLACES = 6, 5  # images with a place; different places
_SAMPLES = 300
_SAME_PLACE = 0.3  # metres
_MOST_OFF = 0.1  # of the path's size: GPS this far off gives no scale
_CONTRADICTS, _CLEAR_WAY = 0.3, 20.0  # off by that share of so many metres: one of them is wrong
_FITTING = 0.6  # share of the places that fit
_TURN_UP = math.radians(10.0)  # that GPS may turn up against the cameras'
_DRIFT = 0.3  # metres, within minutes: places near each other in time err alike
_STRAIGHT = 0.1  # second extent of a path over its first, below which GPS's slope is its slope
_UP_SIGMA = 0.01  # radians: GPS that knows up so well is asked for it


@dataclasses.dataclass(frozen=True)
class Earth:
    """A similarity to the world of the earth: x -> scale rotation x + translation.

    Args:
        scale, rotation, translation: of it.
        figures: for poses.json: "up", and of GPS "metres", "origin", what it is off by.
        notes: sentences.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    figures: dict[str, Any]
    notes: tuple[str, ...]


def find_earth(
    solution: Solution,
    orientations: Mapping[str, int],
    places: Mapping[str, tuple[float, float, float]],
) -> Earth | None:
    """What pictures' orientation and places say of the world.

    Args:
        solution: the poses.
        orientations: EXIF's, by name, 1 for upright; images without one do not count.
        places: latitude and longitude in degrees, altitude in metres, by name.

    Returns:
        None where nothing is known.
    """
    held = _held(solution, orientations)
    up = None if held is None else _up(held)
    figures: dict[str, Any] = {"up": "not known" if up is None else "by the cameras"}
    index = [
        i for i, name in enumerate(solution.names) if solution.registered[i] and name in places
    ]
    notes: list[str] = []
    if len(index) >= _FEWEST:
        given = np.array([places[solution.names[i]] for i in index])
        origin = np.median(given, axis=0)
        target = _metres(given, origin)
        centers = find_centers(solution.camera_from_world[index])
        if up is None and held is not None:
            up = _up_by_path(held, centers, target)
            figures["up"] = "not known" if up is None else "by the cameras and the path of GPS"
        found = _aligned(centers, target, up)
        figures |= {"gps": found.figures, "origin": None}
        notes.append(found.words)
        if found.transform is not None:
            figures |= {"origin": origin.tolist(), "up": "by GPS" if found.turned_up else
                        figures["up"]}  # fmt: skip
            return Earth(*found.transform, figures, tuple(notes))
    if up is None:
        return Earth(1.0, np.eye(3), np.zeros(3), figures, tuple(notes)) if notes else None
    return Earth(1.0, rotate_upright(up), np.zeros(3), figures, tuple(notes))


def moved_solution(solution: Solution, earth: Earth) -> Solution:
    """The solution in the world of the earth."""
    scale, rotation = earth.scale, earth.rotation
    poses = solution.camera_from_world.copy()
    turned = solution.camera_from_world[:, :3, :3] @ rotation.T
    poses[:, :3, :3] = turned
    poses[:, :3, 3] = scale * solution.camera_from_world[:, :3, 3] - turned @ earth.translation
    poses[~solution.registered] = np.eye(4)
    change = np.eye(6)  # of centres in the world; turns are in the camera's frame
    change[:3, :3] = scale * rotation
    velocities = solution.velocities
    if velocities is not None:
        velocities = np.hstack([scale * velocities[:, :3] @ rotation.T, velocities[:, 3:]])
    return dataclasses.replace(
        solution,
        camera_from_world=poses,
        covariances=change @ solution.covariances @ change.T,
        points=scale * solution.points @ rotation.T + earth.translation,
        velocities=velocities,
    )


def _metres(places: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(N, 3) east, down, north of an origin (latitude, longitude, altitude), by the ellipsoid."""
    latitude = math.radians(origin[0])
    shape = 1 - _ECCENTRICITY * math.sin(latitude) ** 2
    across, along = _EARTH / math.sqrt(shape), _EARTH * (1 - _ECCENTRICITY) / shape**1.5
    off = places - origin
    turn = (off[:, 1] + 180) % 360 - 180
    return np.stack(
        [np.radians(turn) * across * math.cos(latitude), -off[:, 2], np.radians(off[:, 0]) * along],
        axis=1,
    )


@dataclasses.dataclass(frozen=True)
class _Held:
    """How the cameras were held: mean of their own up, (3, 3) mean square of their level axes."""

    mean: np.ndarray
    spread: np.ndarray
    count: int

    @property
    def information(self) -> np.ndarray:
        """(3, 3) of up, a unit vector; the least of its quadratic form is best."""
        return self.count * self.spread / _ROLL**2 - np.outer(self.mean, self.mean) / _PITCH**2

    def is_level(self, up: np.ndarray, sigma: float) -> bool:
        """Whether cameras were held level against it, and it is known."""
        roll = math.sqrt(max(0.0, float(up @ self.spread @ up)))
        return roll <= math.sin(_MOST_ROLL) and 2 * sigma <= _MOST_TILT


def _held(solution: Solution, orientations: Mapping[str, int]) -> _Held | None:
    """Of the pictures whose orientation is known; None: too few, or each in another way."""
    ups, levels = [], []
    for i in np.flatnonzero(solution.registered):
        if solution.names[i] not in orientations:
            continue
        x, y = _UP_OF.get(orientations[solution.names[i]], (0, -1))
        rotation = solution.camera_from_world[i, :3, :3]
        ups.append(x * rotation[0] + y * rotation[1])
        levels.append(rotation[1] if x else rotation[0])
    if len(ups) < _FEWEST:
        return None
    mean = np.mean(ups, axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.5:
        return None
    return _Held(mean / length, np.transpose(levels) @ np.array(levels) / len(levels), len(ups))


def _up(held: _Held) -> np.ndarray | None:
    """Up in the solution's world, from cameras that were held level; None: not known.

    The direction to which the pictures' level axes are square, and near the mean of their own up.
    """
    values, axes = np.linalg.eigh(held.information)
    up = axes[:, 0] * np.sign(axes[:, 0] @ held.mean)
    sigma = 1 / math.sqrt(max(1e-12, float(values[1] - values[0])))
    return up if held.is_level(up, sigma) else None


def _up_by_path(held: _Held, centers: np.ndarray, target: np.ndarray) -> np.ndarray | None:
    """Up where all cameras looked alike along a straight path, whose slope GPS tells.

    Level axes of one direction leave open how far up leans along the view; the path says it.

    Args:
        held: how the cameras were held.
        centers: (N, 3) of the cameras. target: (N, 3) of GPS: east, down, north.
    """
    middle = centers - centers.mean(axis=0)
    _, extents, axes = np.linalg.svd(middle, full_matrices=False)
    if extents[1] > _STRAIGHT * extents[0]:
        return None
    direction, along = axes[0], middle @ axes[0]
    fit = np.polyfit(along, target, 1)
    off = target[:, 1] - np.polyval(fit[:, 1], along)
    length = float(np.linalg.norm(fit[0]))
    # Heights of GPS drift: no better for more places.
    slope_sigma = 2 * float(off.std()) / max(length * float(np.ptp(along)), 1e-9)
    if slope_sigma > _MOST_TILT / 2:
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


@dataclasses.dataclass(frozen=True)
class _Aligned:
    transform: tuple[float, np.ndarray, np.ndarray] | None
    turned_up: bool
    figures: dict[str, Any]
    words: str


def _aligned(centers: np.ndarray, target: np.ndarray, up: np.ndarray | None) -> _Aligned:
    """Camera centres against GPS (east, down, north): what they agree in, and in words."""
    ground = target[:, [0, 2]]
    way = float(np.sqrt(((ground - np.median(ground, axis=0)) ** 2).sum(axis=1).mean()))
    different = len(np.unique(np.round(target / _SAME_PLACE), axis=0))
    figures: dict[str, Any] = {"images": len(target), "applied": False, "spread_m": way}
    if different < _FEWEST_PLACES:
        words = (
            f"GPS names {different} place(s) for {len(target)} images: that says nothing of scale "
            "or north"
        )
        return _Aligned(None, False, figures, words)
    turn = np.eye(3) if up is None else rotate_upright(up)
    level = centers @ turn.T
    fit = _level_similarity(level[:, [0, 2]], ground)
    scale, yaw, shift, off, good = fit
    limit = float(np.median(off))
    figures |= {"off_m": limit, "fitting": float(good.mean())}
    share = limit / max(way, 1e-9)
    turned_up = False
    rotation = yaw @ turn
    height = float(np.median(target[good, 1] - scale * level[good, 1])) if good.any() else 0.0
    transform = (scale, rotation, np.array([shift[0], height, shift[1]]))
    full = _full_similarity(centers, target, good)
    if full is not None and (up is None or _angle(full[1], rotation) < _TURN_UP):
        transform, turned_up = full, True
    elif up is None:
        words = (
            "GPS is not used: the cameras were not held level, and their path is too straight or "
            "too small for GPS to tell which way is up"
        )
        return _Aligned(None, False, figures, words)
    if share > _MOST_OFF or good.mean() < _FITTING:
        if share > _CONTRADICTS and way > _CLEAR_WAY:
            words = (
                f"GPS contradicts the poses: it says a way of {way:.0f} m about its middle, and "
                f"is off the cameras' path by {limit:.1f} m: the poses are wrong, or GPS is of "
                "another moment; scale and north are not taken from it"
            )
        else:
            words = (
                f"GPS is off the cameras' path by {limit:.1f} m where that is only {way:.1f} m "
                "in size: too much for scale and north, which stay open"
            )
        return _Aligned(None, False, figures, words)
    scale = transform[0]
    sigma = math.hypot(share / math.sqrt(min(len(target), 9)), _DRIFT / max(way, 1e-9))
    figures |= {"applied": True, "scale": scale, "scale_sigma_percent": 100 * sigma}
    words = (
        f"GPS gives metres and north (x east, y down, z north): {int(good.sum())} of {len(target)} "
        f"places fit to {limit:.2f} m (median) on a path of {way:.0f} m about its middle; lengths "
        f"are good to about {200 * sigma:.0f} %"
    )
    return _Aligned(transform, turned_up, figures, words)


def _level_similarity(
    source: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """On the ground: scale, turn about y (3, 3), shift (2,), how far each is off, and which fit.

    Of many pairs of places the one that leaves the least median; then least squares of what fits.
    """
    a, b = (rows[:, 0] + 1j * rows[:, 1] for rows in (source, target))
    rng = np.random.default_rng(0)
    least, best = math.inf, (1.0 + 0j, 0j)
    for _ in range(_SAMPLES):
        i, j = rng.choice(len(a), 2, replace=False)
        if abs(a[i] - a[j]) < 1e-12:
            continue
        factor = (b[i] - b[j]) / (a[i] - a[j])
        middle = b[i] - factor * a[i]
        error = float(np.median(np.abs(factor * a + middle - b)))
        if error < least:
            least, best = error, (factor, middle)
    factor, middle = best
    for _ in range(5):
        off = np.abs(factor * a + middle - b)
        good = off <= 3 * max(float(np.median(off)), 1e-9)
        x, y = a[good] - a[good].mean(), b[good] - b[good].mean()
        factor = (np.conj(x) @ y) / max(float((np.abs(x) ** 2).sum()), 1e-300)
        middle = b[good].mean() - factor * a[good].mean()
    off = np.abs(factor * a + middle - b)
    good = off <= 3 * max(float(np.median(off)), 1e-9)
    cosine, sine = factor.real / abs(factor), factor.imag / abs(factor)
    yaw = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    return abs(factor), yaw, np.array([middle.real, middle.imag]), off, good


def _full_similarity(
    source: np.ndarray, target: np.ndarray, good: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """In space; None where the path does not tell which way is up."""
    if good.sum() < _FEWEST:
        return None
    found = similarity(source[good], target[good])
    scale, rotation, shift = found
    off = np.linalg.norm(scale * source[good] @ rotation.T + shift - target[good], axis=1)
    across = np.linalg.svd(target[good] - target[good].mean(axis=0), compute_uv=False)[1]
    # The second extent, over which an error in height tilts the path.
    known = float(np.sqrt((off**2).mean())) / max(float(across), 1e-9)
    return found if known < _UP_SIGMA else None


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    """Between where two rotations say that up is."""
    return math.acos(float(np.clip(one[1] @ other[1], -1, 1)))
