"""Finds which way is up, and from GPS north and metres, where the evidence agrees.

The world becomes x east, y down, z north: scenes then stand upright where y points down, as it does
in cameras and in most viewers of Gaussians.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from gsut.data.poses import find_centers
from gsut.gaussians import rotate_upright
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import Solution, similarity_from_points

_EARTH_RADIUS = 6378137.0  # metres, semi-major axis of WGS 84
_ECCENTRICITY_2 = 6.69437999014e-3  # squared, of WGS 84
# Directions of up in the stored picture (x, y), by EXIF's orientation.
_UP_OF = {1: (0, -1), 2: (0, -1), 3: (0, 1), 4: (0, 1), 5: (-1, 0), 6: (-1, 0), 7: (1, 0),
          8: (1, 0)}  # fmt: skip
_ROLL = math.radians(5.0)  # standard deviation: people and drones hold cameras level
_PITCH = math.radians(25.0)  # standard deviation: they look up and down
_MOST_ROLL = math.radians(12.0)  # mean roll beyond which cameras were not held level
_MOST_TILT = 0.15  # radians: two standard deviations of up beyond which it is not known
_FEWEST = 6  # images with a place, or an orientation
_FEWEST_PLACES = 5  # different places
_SAMPLES = 300  # pairs of places that an alignment is fitted to
_SAME_PLACE = 0.3  # metres within which places are the same
_MOST_OFF = 0.1  # median error over the path's size beyond which GPS gives no scale
_CONTRADICTS = 0.3  # median error over the path's size beyond which poses or GPS are wrong
_CLEAR_WAY = 20.0  # metres that the path must be in size for such a contradiction
_FITTING = 0.6  # share of the places that must fit
_TURN_UP = math.radians(10.0)  # that GPS may turn up against the cameras'
_DRIFT = 0.3  # metres of GPS within minutes: places near each other in time err alike
_STRAIGHT = 0.1  # second over first extent of a path, below which its slope is that of GPS
_UP_SIGMA = 0.01  # radians: GPS that determines up this well is used for it


@dataclasses.dataclass(frozen=True)
class Earth:
    """A similarity to the world of the earth: x -> scale rotation x + translation.

    Args:
        scale, rotation, translation: of the similarity.
        figures: for poses.json: "up", and of GPS "origin" and its errors.
        notes: what a user should know, one sentence each.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    figures: dict[str, Any]
    notes: tuple[str, ...]


def find_earth(
    solution: Solution,
    orientations: dict[str, int],
    places: dict[str, tuple[float, float, float]],
) -> Earth | None:
    """Finds the world from the orientations and places of pictures.

    Args:
        orientations: EXIF's, by name, 1 for upright; images without one do not count.
        places: latitude and longitude in degrees, altitude in metres, by name.

    Returns:
        None where nothing is known about it.
    """
    held = _find_held(solution, orientations)
    up = None if held is None else _find_up(held)
    figures: dict[str, Any] = {"up": "not known" if up is None else "by the cameras"}
    index = [
        i for i, name in enumerate(solution.names) if solution.registered[i] and name in places
    ]
    notes: list[str] = []
    if len(index) >= _FEWEST:
        given = np.array([places[solution.names[i]] for i in index])
        origin = np.median(given, axis=0)
        target = _convert_to_metres(given, origin)
        centers = find_centers(solution.camera_from_world[index])
        if up is None and held is not None:
            up = _find_up_by_path(held, centers, target)
            figures["up"] = "not known" if up is None else "by the cameras and the path of GPS"
        found = _align_with_gps(centers, target, up)
        figures |= {"gps": found.figures, "origin": None}
        notes.append(found.words)
        if found.transform is not None:
            figures |= {"origin": origin.tolist(), "up": "by GPS" if found.turned_up else
                        figures["up"]}  # fmt: skip
            return Earth(*found.transform, figures, tuple(notes))
    if up is None:
        return Earth(1.0, np.eye(3), np.zeros(3), figures, tuple(notes)) if notes else None
    return Earth(1.0, rotate_upright(up), np.zeros(3), figures, tuple(notes))


def place_on_earth(mapping: Mapping) -> None:
    """Moves poses, points and rig to the world of the earth, as far as the photographs show it."""
    photographs, found = mapping.photographs, mapping.found
    earth = find_earth(mapping.solved, photographs.orientations, photographs.places)
    if earth is None:
        return
    found.figures["earth"] = earth.figures
    mapping.log.note(*earth.notes)
    if found.rig is not None:
        found.rig = found.rig.rescale(earth.scale)
    mapping.solution = move_to_earth(mapping.solved, earth)


def move_to_earth(solution: Solution, earth: Earth) -> Solution:
    """Moves a solution to the world of the earth."""
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


def _convert_to_metres(places: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Converts places to (N, 3) east, down, north of an origin, in metres on the ellipsoid."""
    latitude = math.radians(origin[0])
    shape = 1 - _ECCENTRICITY_2 * math.sin(latitude) ** 2
    across, along = (
        _EARTH_RADIUS / math.sqrt(shape),
        _EARTH_RADIUS * (1 - _ECCENTRICITY_2) / shape**1.5,
    )
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
        """A matrix (3, 3) whose quadratic form is least for up."""
        return self.count * self.spread / _ROLL**2 - np.outer(self.mean, self.mean) / _PITCH**2

    def is_level(self, up: np.ndarray, sigma: float) -> bool:
        """Returns whether cameras were held level against `up`, and it is known."""
        roll = math.sqrt(max(0.0, float(up @ self.spread @ up)))
        return roll <= math.sin(_MOST_ROLL) and 2 * sigma <= _MOST_TILT


def _find_held(solution: Solution, orientations: dict[str, int]) -> _Held | None:
    """Measures how the cameras were held; None: too few are known, or each differently."""
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


def _find_up(held: _Held) -> np.ndarray | None:
    """Finds up in the solution's world, from cameras that were held level; None: not known.

    It is perpendicular to the pictures' level axes, and near the mean of their own up.
    """
    values, axes = np.linalg.eigh(held.information)
    up = axes[:, 0] * np.sign(axes[:, 0] @ held.mean)
    sigma = 1 / math.sqrt(max(1e-12, float(values[1] - values[0])))
    return up if held.is_level(up, sigma) else None


def _find_up_by_path(held: _Held, centers: np.ndarray, target: np.ndarray) -> np.ndarray | None:
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
    """An alignment with GPS, or None, and its figures and sentence."""

    transform: tuple[float, np.ndarray, np.ndarray] | None
    turned_up: bool
    figures: dict[str, Any]
    words: str


def _align_with_gps(centers: np.ndarray, target: np.ndarray, up: np.ndarray | None) -> _Aligned:
    """Aligns camera centres with GPS (east, down, north) as far as they agree."""
    ground = target[:, [0, 2]]
    way = float(np.sqrt(((ground - np.median(ground, axis=0)) ** 2).sum(axis=1).mean()))
    different = len(np.unique(np.round(target / _SAME_PLACE), axis=0))
    figures: dict[str, Any] = {"images": len(target), "applied": False, "spread_m": way}
    if different < _FEWEST_PLACES:
        words = (
            f"GPS gives {different} place(s) for {len(target)} images: that determines neither "
            "scale nor north"
        )
        return _Aligned(None, False, figures, words)
    turn = np.eye(3) if up is None else rotate_upright(up)
    level = centers @ turn.T
    fit = _fit_level_similarity(level[:, [0, 2]], ground)
    scale, yaw, shift, off, good = fit
    limit = float(np.median(off))
    figures |= {"off_m": limit, "fitting": float(good.mean())}
    share = limit / max(way, 1e-9)
    turned_up = False
    rotation = yaw @ turn
    height = float(np.median(target[good, 1] - scale * level[good, 1])) if good.any() else 0.0
    transform = (scale, rotation, np.array([shift[0], height, shift[1]]))
    full = _fit_full_similarity(centers, target, good)
    if full is not None and (up is None or _measure_up_angle(full[1], rotation) < _TURN_UP):
        transform, turned_up = full, True
    elif up is None:
        words = (
            "GPS is not used: the cameras were not held level, and their path is too straight or "
            "too small for GPS to show which way is up"
        )
        return _Aligned(None, False, figures, words)
    if share > _MOST_OFF or good.mean() < _FITTING:
        if share > _CONTRADICTS and way > _CLEAR_WAY:
            words = (
                f"GPS contradicts the poses: its path extends {way:.0f} m about its middle, and is "
                f"{limit:.1f} m off the cameras' path: the poses are wrong, or GPS is of another "
                "moment; scale and north are not taken from it"
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


def _fit_level_similarity(
    source: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Fits scale, turn about y (3, 3) and shift (2,) on the ground; returns errors and inliers too.

    The pair of places with the least median error, then least squares of the places that fit.
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


def _fit_full_similarity(
    source: np.ndarray, target: np.ndarray, good: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Fits a similarity in space; None where the path does not show which way is up."""
    if good.sum() < _FEWEST:
        return None
    found = similarity_from_points(source[good], target[good])
    scale, rotation, shift = found
    off = np.linalg.norm(scale * source[good] @ rotation.T + shift - target[good], axis=1)
    across = np.linalg.svd(target[good] - target[good].mean(axis=0), compute_uv=False)[1]
    # An error in height tilts the path over its second extent.
    known = float(np.sqrt((off**2).mean())) / max(float(across), 1e-9)
    return found if known < _UP_SIGMA else None


def _measure_up_angle(one: np.ndarray, other: np.ndarray) -> float:
    """Returns the angle in radians between the up directions of two rotations."""
    return math.acos(float(np.clip(one[1] @ other[1], -1, 1)))
