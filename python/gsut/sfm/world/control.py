"""Places poses and points in the world of surveyed control points, which enter the adjustment."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.poses import find_centers
from gsut.judge import SURE
from gsut.least_squares import ROUNDS
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import DESCRIPTOR_LENGTH, FEWEST_IMAGES, Features
from gsut.sfm.solution import Solution, StatedPoints, similarity_from_points
from gsut.sfm.world.control_file import (
    FEWEST_CONTROL,
    USES,
    ControlPoint,
    Sighted,
    are_on_line,
    find_control,
)
from gsut.sfm.world.earth import Earth, move_to_earth
from gsut.sfm.world.place_priors import adjust_images, try_adjustment
from gsut.sfm.world.positions import SCENE_FROM_EAST_NORTH_UP

# Metres to which the world's origin is rounded: coordinates of a national grid keep their digits.
_ORIGIN_STEP = 1000.0
# Cosine between up and where the cameras' up and back point together, below which the control
# points turn the cameras upside down.
_UPSIDE_DOWN = -0.5
# Times as close as control points fit with x and y exchanged, before they are taken for exchanged.
_MUCH_CLOSER = 3.0


def place_by_control(mapping: Mapping) -> Mapping:
    """Moves a solution to the world of its control points and adjusts it near them.

    Args:
        mapping: with a solution; its options name the file, or nothing is done.

    Returns:
        The run with x east, y down, z north in metres, and "control" of the figures: "origin" of
        the world in the file's coordinates, "in_adjustment", "scale_sigma_percent" and each point's
        "use", "pictures", "residual" (triangulated less stated: x, y, z of the file) and
        "residual_px".

    Raises:
        InputError: x and y are exchanged.
    """
    path = mapping.options.control
    if path is None:
        return mapping
    points = find_control(path, mapping.photographs.names)
    registered = mapping.solved.registered
    points = [
        (point, {image: pixel for image, pixel in seen.items() if registered[image]})
        for point, seen in points
    ]
    points = [each for each in points if len(each[1]) >= FEWEST_IMAGES]
    used = [each for each in points if not each[0].is_check]
    places = np.array([point.place for point, _ in points]).reshape(-1, 3)
    is_used = np.array([not point.is_check for point, _ in points], bool)
    if len(used) < FEWEST_CONTROL or are_on_line(places[is_used]):
        mapping.log.note(
            f"{path}: photographs with a pose show only {len(used)} of its control points, or "
            "these lie on a line: they are not used"
        )
        return mapping
    origin = _ORIGIN_STEP * np.round(places[is_used].mean(axis=0) / _ORIGIN_STEP)
    stated = (places - origin) @ SCENE_FROM_EAST_NORTH_UP.T
    found = np.array([_triangulate(mapping.solved, seen)[0] for _, seen in points])
    similarity = similarity_from_points(found[is_used], stated[is_used])
    _require_axes(path, mapping.solved, similarity, found[is_used], stated[is_used])
    solution = move_to_earth(mapping.solved, Earth(*similarity, {}, ()))
    fit = mapping.found.rig
    if fit is None:
        held = _adjust_near(mapping, solution, used, stated[is_used])
    else:
        held, fit = None, fit.rescale(similarity[0])
    moved = mapping.replace(solution=solution) if held is None else held
    rows = [
        _describe_point(moved.solved, point, seen, place)
        for (point, seen), place in zip(points, stated, strict=True)
    ]
    spread = np.sqrt(((stated[is_used] - stated[is_used].mean(axis=0)) ** 2).sum())
    errors = np.array([row["residual"] for row, use in zip(rows, is_used, strict=True) if use])
    sigma = max(float(np.sqrt((errors**2).mean())), *(point.sigma for point, _ in used))
    figures = {
        "file": str(path), "origin": origin.tolist(), "in_adjustment": held is not None,
        "scale_sigma_percent": 100 * sigma / float(spread), "points": rows,
    }  # fmt: skip
    mapping.log.note(*_describe(path, rows, held is not None, fit is not None))
    earth = {"up": "by control points"}
    return moved.add_findings({"control": figures, "earth": earth}, rig=fit)


def _require_axes(
    path: str,
    solution: Solution,
    similarity: tuple[float, np.ndarray, np.ndarray],
    found: np.ndarray,
    stated: np.ndarray,
) -> None:
    """Refuses control points of a left-handed world, and of one that is upside down."""

    def measure_error(scale: float, rotation: np.ndarray, shift: np.ndarray, at: np.ndarray) -> Any:
        return np.sqrt(((scale * found @ rotation.T + shift - at) ** 2).mean())

    exchanged = stated[:, [2, 1, 0]]
    error = measure_error(*similarity, stated)
    other = measure_error(*similarity_from_points(found, exchanged), exchanged)
    # Cameras are held upright or look down: then neither y nor z of theirs points up.
    down = similarity[1] @ solution.camera_from_world[solution.registered, 1:3, :3].sum(axis=(0, 1))
    is_exchanged = len(found) > FEWEST_CONTROL and error > _MUCH_CLOSER * other
    if is_exchanged or down[1] < _UPSIDE_DOWN * np.linalg.norm(down):
        raise InputError(
            f"{path}: x and y are exchanged, or z points down: the file has x east, y north and z "
            f"up, with which the control points are {error:.3g} m off and the cameras "
            + ("a mirror image" if is_exchanged else "upside down")
        )


def _adjust_near(
    mapping: Mapping,
    solution: Solution,
    points: Sequence[Sighted],
    stated: np.ndarray,
) -> Mapping | None:
    """Adjusts everything with control points as features; None where images contradict them."""
    features, pairs = list(mapping.features), {(p.first, p.second): p for p in mapping.pairs}
    first_seen = []
    for number, (_, seen) in enumerate(points):
        feature = {}
        for image, pixel in seen.items():
            feature[image] = len(features[image])
            features[image] = features[image].join(_make_feature(number, pixel))
        first_seen.append(next(iter(feature.items())))
        for pair in itertools.combinations(sorted(seen), 2):
            match = np.array([[feature[pair[0]], feature[pair[1]]]], np.int32)
            old = pairs.get(pair)
            if old is None:
                first, second = solution.camera_from_world[list(pair)]
                pairs[pair] = PairMatches(*pair, match, second @ np.linalg.inv(first), 0, 0.0)
            else:
                matches = np.concatenate([old.matches, match])
                pairs[pair] = dataclasses.replace(old, matches=matches)
    sigma = np.array([[point.sigma] * 3 for point, _ in points])
    near = StatedPoints(np.array(first_seen), stated, sigma)
    larger = mapping.replace(features=features, pairs=list(pairs.values()))
    held = try_adjustment(
        mapping, solution, lambda flags: adjust_images(larger, solution, flags, points=near)
    )
    return None if held is None else mapping.replace(solution=held, features=features)


def _make_feature(number: int, pixel: np.ndarray) -> Features:
    """Makes the one feature of a control point in an image; the descriptor is the point's own."""
    descriptor = np.random.default_rng([number, 1]).integers(0, 64, (1, DESCRIPTOR_LENGTH))
    return Features(
        pixel[None], np.ones(1, np.float32), descriptor.astype(np.uint8),
        np.full((1, 3), 128, np.uint8),
    )  # fmt: skip


def _triangulate(solution: Solution, seen: dict[int, np.ndarray]) -> tuple[np.ndarray, float]:
    """Finds the point (3,) that photographs show at pixels, and the pixels' error (rms)."""
    images, pixels = list(seen), np.array(list(seen.values()))
    rows = np.array([[0, image, 0] for image in images])
    times = dataclasses.replace(solution, observations=rows, pixels=pixels).measure_line_times()
    poses = solution.camera_from_world[images]
    if solution.velocities is not None:
        moved = zip(poses, solution.velocities[images], times, strict=True)
        poses = np.array([_core.moved_pose(*each) for each in moved])
    cameras = [solution.cameras[image] for image in images]
    centers = find_centers(poses)
    rays = np.array(
        [
            camera.unproject(pixel[None])[0][0] @ pose[:3, :3]
            for camera, pixel, pose in zip(cameras, pixels, poses, strict=True)
        ]
    )
    # The point to which rays make the least angles: nearest to them, each by its distance.
    across, weights = np.eye(3) - rays[:, :, None] * rays[:, None], np.ones(len(images))
    for _ in range(ROUNDS):
        weighted = weights[:, None, None] * across
        at = np.linalg.pinv(weighted.sum(axis=0)) @ np.einsum("nij,nj->i", weighted, centers)
        weights = 1 / np.maximum(np.sum((at - centers) ** 2, axis=1), np.finfo(float).tiny)
    off = np.concatenate(
        [
            camera.subtract_pixels(
                camera.project((pose[:3, :3] @ at + pose[:3, 3])[None])[0], pixel[None]
            )
            for camera, pixel, pose in zip(cameras, pixels, poses, strict=True)
        ]
    )
    error = float(np.sqrt((off**2).sum(axis=1).mean()))
    return at, error if np.isfinite(error) else float("inf")


def _describe_point(
    solution: Solution, point: ControlPoint, seen: dict[int, np.ndarray], stated: np.ndarray
) -> dict[str, Any]:
    """Describes how far a point is from where the file says, by the poses."""
    found, error = _triangulate(solution, seen)
    residual = (found - stated) @ SCENE_FROM_EAST_NORTH_UP
    return {
        "name": point.name, "use": USES[point.is_check], "pictures": len(seen),
        "sigma": point.sigma, "residual": residual.tolist(),
        "residual_px": error if np.isfinite(error) else None,
    }  # fmt: skip


def _describe(
    path: str, rows: Sequence[dict[str, Any]], is_adjusted: bool, is_rig: bool
) -> list[str]:
    """Describes control and check points in a sentence each, and names those that are far off."""
    sentences = []
    for use in USES:
        own = [row for row in rows if row["use"] == use]
        if not own:
            continue
        off = np.linalg.norm([row["residual"] for row in own], axis=1)
        worst = own[int(off.argmax())]["name"]
        sentences.append(
            f"{len(own)} {use} point(s) are {np.sqrt((off**2).mean()):.3g} m (rms) from where "
            f"{path} says, {worst} the farthest by {off.max():.3g} m"
        )
        limits = SURE * np.sqrt(3) * np.array([row["sigma"] for row in own])
        far = [row["name"] for row, is_far in zip(own, off > limits, strict=True) if is_far]
        if use == "control" and far:
            sentences.append(
                f"{', '.join(far)}: more than {SURE:g} standard "
                "deviations off; check coordinates and pixels"
            )
    if not is_adjusted:
        why = "on a rig they only move it" if is_rig else "the photographs contradict them"
        sentences.append(f"control points stay out of the adjustment: {why}")
    return sentences
