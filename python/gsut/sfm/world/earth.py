"""Finds which way is up, and from GPS north and metres, where the evidence agrees.

The world becomes x east, y down, z north: scenes then stand upright where y points down, as it does
in cameras and in most viewers of Gaussians.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gsut.data.poses import find_centers, move_poses
from gsut.gaussians import rotate_upright
from gsut.least_squares import ROUNDS
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import Solution, similarity_from_points
from gsut.sfm.world.place_priors import Adjust, adjust_near_places
from gsut.sfm.world.positions import (
    FEWEST_PLACES,
    SCENE_FROM_EAST_NORTH_UP,
    convert_to_east_north_up,
)
from gsut.sfm.world.up import (
    MOST_TILT,
    SAME_UP,
    find_held,
    find_measured_up,
    find_up,
    find_up_by_path,
)

_UP = (0.0, -1.0, 0.0)  # in the world, once it is known
_UP_UNKNOWN = "not known"  # of the figure "up"
_SAMPLES = 300  # pairs of places that an alignment is fitted to
_MOST_OFF = 0.1  # median error over the path's size beyond which GPS gives no scale
_DRIFT = 0.3  # metres of GPS within minutes, in which places near in time err alike or are the same
_UP_SIGMA = 0.01  # radians: GPS that determines up this well is used for it


@dataclasses.dataclass(frozen=True)
class Earth:
    """A similarity to the world of the earth: x -> scale rotation x + translation.

    Args:
        scale, rotation, translation: of the similarity.
        figures: for poses.json: "up", and of GPS "origin" and its errors.
        notes: what a user should know, one sentence each.
        places: (N, 3) of the solution's images by GPS, in the new world; NaN: not known, or far
            off; None: GPS is not used.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    figures: dict[str, Any]
    notes: tuple[str, ...]
    places: np.ndarray | None = None


def find_earth(
    solution: Solution,
    orientations: dict[str, int],
    places: dict[str, tuple[float, float, float]],
    ups: dict[str, tuple[float, float, float]] | None = None,
) -> Earth | None:
    """Finds the world from the orientations and places of pictures.

    Args:
        orientations: EXIF's, by name, 1 for upright; images without one do not count.
        places: latitude and longitude in degrees, altitude in metres, by name.
        ups: up in the camera's axes by an accelerometer or a gimbal, by name.

    Returns:
        None where nothing is known about it.
    """
    held = find_held(solution, orientations)
    up = None if held is None else find_up(held)
    figures: dict[str, Any] = {"up": _UP_UNKNOWN if up is None else "by the cameras"}
    index = [
        i for i, name in enumerate(solution.names) if solution.registered[i] and name in places
    ]
    measured, notes = find_measured_up(solution, ups or {}, up)
    if measured is not None:
        up, figures["up"] = measured, "by an accelerometer or gimbal"
    if len(index) >= FEWEST_PLACES:
        given = np.array([places[solution.names[i]] for i in index])
        origin = np.median(given, axis=0)
        target = convert_to_east_north_up(given, origin) @ SCENE_FROM_EAST_NORTH_UP.T
        centers = find_centers(solution.camera_from_world[index])
        if up is None and held is not None:
            up = find_up_by_path(held, centers, target)
            figures["up"] = _UP_UNKNOWN if up is None else "by the cameras and the path of GPS"
        found = _align_with_gps(centers, target, up)
        figures |= {"gps": found.figures, "origin": None}
        notes.append(found.words)
        if found.transform is not None:
            figures |= {"origin": origin.tolist(), "up": "by GPS" if found.turned_up else
                        figures["up"]}  # fmt: skip
            stated = np.full((len(solution.names), 3), np.nan)
            stated[np.array(index)[found.fitting]] = target[found.fitting]
            return Earth(*found.transform, figures, tuple(notes), stated)
    if up is None and held is not None:
        up, figures["up"] = held.mean, "roughly, by the cameras' mean"
    if up is None:
        return Earth(1.0, np.eye(3), np.zeros(3), figures, tuple(notes)) if notes else None
    return Earth(1.0, rotate_upright(up), np.zeros(3), figures, tuple(notes))


def place_on_earth(mapping: Mapping, adjust_rig: Adjust) -> Mapping:
    """Moves poses, points and rig to the world of the earth, as far as the photographs show it.

    Args:
        mapping: with a solution.
        adjust_rig: adjusts the images of a rig near the places of GPS.

    Returns:
        The run with solution and rig in that world, and "earth" of the figures.
    """
    photographs, fit = mapping.photographs, mapping.found.rig
    earth = find_earth(
        mapping.solved, photographs.orientations, photographs.places, photographs.ups
    )
    if earth is None:
        return mapping
    mapping.log.note(*earth.notes)
    if fit is not None:
        fit = fit.rescale(earth.scale)
        if mapping.rig is not None and earth.places is not None:
            mapping.log.note(
                f"a unit of {mapping.rig.source.name} is {earth.scale:.4g} m by GPS; lengths, and "
                "the rig as it was used, are now in metres"
            )
    mapping = mapping.replace(solution=move_to_earth(mapping.solved, earth))
    mapping = mapping.add_findings({"earth": earth.figures}, rig=fit)
    if earth.places is None:
        return mapping
    return adjust_near_places(mapping, earth.places, adjust_rig)


def find_stated_up(figures: dict[str, Any]) -> tuple[float, float, float] | None:
    """Finds up in the world after `place_on_earth` by its figures; None: not known."""
    return _UP if figures.get("earth", {}).get("up", _UP_UNKNOWN) != _UP_UNKNOWN else None


def move_to_earth(solution: Solution, earth: Earth) -> Solution:
    """Moves a solution to the world of the earth."""
    scale, rotation = earth.scale, earth.rotation
    poses = move_poses(solution.camera_from_world, scale, rotation, earth.translation)
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


@dataclasses.dataclass(frozen=True)
class _Aligned:
    """An alignment with GPS, or None, its figures and sentence, and who fits, (N,) bool."""

    transform: tuple[float, np.ndarray, np.ndarray] | None
    turned_up: bool
    figures: dict[str, Any]
    words: str
    fitting: np.ndarray | None = None


def _align_with_gps(centers: np.ndarray, target: np.ndarray, up: np.ndarray | None) -> _Aligned:
    """Aligns camera centres with GPS (east, down, north) as far as they agree."""
    ground = target[:, [0, 2]]
    way = float(np.sqrt(((ground - np.median(ground, axis=0)) ** 2).sum(axis=1).mean()))
    different = len(np.unique(np.round(target / _DRIFT), axis=0))
    figures: dict[str, Any] = {"images": len(target), "applied": False, "spread_m": way}
    if different < FEWEST_PLACES:
        words = (
            f"GPS gives {different} place(s) for {len(target)} images: that determines neither "
            "scale nor north"
        )
        return _Aligned(None, False, figures, words)
    turn = np.eye(3) if up is None else rotate_upright(up)
    level = centers @ turn.T
    if up is None:
        off, good = _fit_robust_similarity(centers, target)
        yaw, scale, shift = np.eye(3), 1.0, np.zeros(2)
    else:
        scale, yaw, shift, off, good = _fit_level_similarity(level[:, [0, 2]], ground)
    limit = float(np.median(off))
    figures |= {"off_m": limit, "fitting": float(good.mean())}
    share = limit / max(way, 1e-9)
    turned_up = False
    rotation = yaw @ turn
    height = float(np.median(target[good, 1] - scale * level[good, 1])) if good.any() else 0.0
    transform = (scale, rotation, np.array([shift[0], height, shift[1]]))
    full = _fit_full_similarity(centers, target, good, _UP_SIGMA if up is not None else MOST_TILT)
    if full is not None and (up is None or _measure_up_angle(full[1], rotation) < SAME_UP):
        transform, turned_up = full, True
    elif up is None:
        words = (
            "GPS is not used: the cameras were not held level, and their path is too straight or "
            "too small for GPS to show which way is up"
        )
        return _Aligned(None, False, figures, words)
    if share > _MOST_OFF:
        words = (
            f"GPS contradicts the cameras' path, which extends {way:.1f} m about its middle, by "
            f"{limit:.1f} m: GPS is too coarse or of another moment, or the poses are wrong; scale "
            "and north stay open"
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
    return _Aligned(transform, turned_up, figures, words, good)


def _fit_level_similarity(
    source: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Fits scale, turn about y (3, 3) and shift (2,) on the ground; and errors, and who fits."""
    a, b = (rows[:, 0] + 1j * rows[:, 1] for rows in (source, target))

    def fit(rows: np.ndarray) -> tuple[complex, complex]:
        x, y = a[rows] - a[rows].mean(), b[rows] - b[rows].mean()
        factor = (np.conj(x) @ y) / max(float((np.abs(x) ** 2).sum()), 1e-300)
        return factor, b[rows].mean() - factor * a[rows].mean()

    def measure_distances(rows: np.ndarray) -> np.ndarray:
        factor, middle = fit(rows)
        return np.abs(factor * a + middle - b)

    off, good = _find_fitting(measure_distances, len(a), 2)
    factor, middle = fit(np.flatnonzero(good))
    cosine, sine = factor.real / abs(factor), factor.imag / abs(factor)
    yaw = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    return abs(factor), yaw, np.array([middle.real, middle.imag]), off, good


def _fit_robust_similarity(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits a similarity in space to most places; returns the distances left (N,) and who fits."""

    def measure_distances(rows: np.ndarray) -> np.ndarray:
        scale, rotation, shift = similarity_from_points(source[rows], target[rows])
        return np.linalg.norm(scale * source @ rotation.T + shift - target, axis=1)

    return _find_fitting(measure_distances, len(source), 3)


def _find_fitting(
    measure_distances: Callable[[np.ndarray], np.ndarray], count: int, fewest: int
) -> tuple[np.ndarray, np.ndarray]:
    """Finds who fits: the sample with the least median error, then those within three medians.

    Args:
        measure_distances: of all (N,) from a fit to some rows.
        count, fewest: number of all, and of those that a fit needs.
    """
    rng = np.random.default_rng(0)
    samples = [rng.choice(count, fewest, replace=False) for _ in range(_SAMPLES)]
    off = min(map(measure_distances, samples), key=lambda distances: float(np.median(distances)))
    for _ in range(ROUNDS):
        off = measure_distances(np.flatnonzero(off <= 3 * max(float(np.median(off)), 1e-9)))
    return off, off <= 3 * max(float(np.median(off)), 1e-9)


def _fit_full_similarity(
    source: np.ndarray, target: np.ndarray, good: np.ndarray, most_sigma: float
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Fits a similarity in space; None where the path shows up to a larger error in radians."""
    if good.sum() < FEWEST_PLACES:
        return None
    found = similarity_from_points(source[good], target[good])
    scale, rotation, shift = found
    off = np.linalg.norm(scale * source[good] @ rotation.T + shift - target[good], axis=1)
    across = np.linalg.svd(target[good] - target[good].mean(axis=0), compute_uv=False)[1]
    # An error in height tilts the path over its second extent.
    known = float(np.sqrt((off**2).mean())) / max(float(across), 1e-9)
    return found if known < most_sigma else None


def _measure_up_angle(one: np.ndarray, other: np.ndarray) -> float:
    """Returns the angle in radians between the up directions of two rotations."""
    return math.acos(float(np.clip(one[1] @ other[1], -1, 1)))
