"""Measures how far two lenses of one camera disagree: two halves of the boards, or two models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.boards import FEWEST_BOARDS, Photograph
from calib.camera import (
    CameraSolution,
    compose,
    cross_matrix_from_vector,
    rodrigues_from_matrix,
    transform_points,
    unproject_pixels,
)
from calib.errors import SolveError
from calib.trust.trust import measure_field_angle
from calib.trust.uncertainty import spread_pixels
from gsut.least_squares import LEAST_GAIN, ROUNDS, minimize_least_squares

AGREEMENT_DEGREES = 0.3  # between the rays of two good lenses of one camera
_FEWEST_RAYS = 3  # that determine a rotation safely
_SCAN = np.radians(1.0)  # between the angles to try


@dataclass
class Halves:
    """The angle between the rays of two solves, after turning one onto the other.

    Args:
        degrees: (rows, columns) on the grid of `uncertainty.spread_pixels`; NaN without a ray.
        median_degrees, worst_degrees: inside the trusted field.
    """

    degrees: np.ndarray
    median_degrees: float
    worst_degrees: float


def solve_halves(
    camera: CameraSolution, solve: Callable[[Sequence[Photograph]], CameraSolution]
) -> tuple[CameraSolution, CameraSolution] | None:
    """Solves for the lenses of odd and of even photographs; None if a half does not suffice.

    The difference of two halves is about twice the full solve's standard deviation.
    """
    odd, even = camera.photographs[0::2], camera.photographs[1::2]
    if min(len(odd), len(even)) < FEWEST_BOARDS:
        return None
    try:
        return solve(odd), solve(even)
    except SolveError:
        return None


def compare_lenses(a: CameraSolution, b: CameraSolution, valid_angle: float) -> Halves:
    """Measures the angles between the rays of two lenses at the same pixels, turned together."""
    pixels = spread_pixels(a.width, a.height)
    rays_a, rays_b = _unproject_both(a, b)
    trusted = measure_field_angle(rays_a) <= valid_angle
    degrees = np.full(len(rays_a), np.nan)
    if trusted.sum() < _FEWEST_RAYS:
        return Halves(degrees.reshape(pixels.shape[:2]), float("nan"), float("nan"))
    turn = fit_rotation(rays_b[trusted], rays_a[trusted])
    degrees = _measure_degrees(rays_b @ turn.T, rays_a)
    return Halves(
        degrees.reshape(pixels.shape[:2]),
        float(np.median(degrees[trusted])),
        float(np.max(degrees[trusted])),
    )


def find_agreement_angle(
    a: CameraSolution, b: CameraSolution, limit: float, distance: float = np.inf
) -> float:
    """Finds the radians from the axis up to which two lenses agree within AGREEMENT_DEGREES.

    Two lenses of the same boards have frames of their own, turned and shifted against each other.
    The turn is always removed; the shift, which distant points do not show, only if a distance is
    given. Boards that were all near determine the centre of projection poorly: two lenses that
    agree at the boards may differ far away.

    Args:
        a, b: two lenses of one camera. limit: the largest angle, in radians.
        distance: of the points, in the board's unit.
    """
    rays_a, rays_b = _unproject_both(a, b)
    angle = measure_field_angle(rays_a)
    for outer in np.arange(limit, 0.0, -_SCAN):
        inside = angle <= outer
        if inside.sum() < _FEWEST_RAYS:
            break
        source, target = rays_b[inside], rays_a[inside]
        if np.isfinite(distance):
            moved = _align_points(source * distance, target)
        else:
            moved = source @ fit_rotation(source, target).T
        if _measure_degrees(moved, target).max() <= AGREEMENT_DEGREES:
            return float(outer)
    return 0.0


def _unproject_both(a: CameraSolution, b: CameraSolution) -> tuple[np.ndarray, np.ndarray]:
    """Returns unit rays (N, 3) of the grid's pixels; NaN in both where either lens has none."""
    pixels = spread_pixels(a.width, a.height).reshape(-1, 2)
    rays_a, rays_b = unproject_pixels(a, pixels), unproject_pixels(b, pixels)
    missing = ~np.all(np.isfinite(rays_a) & np.isfinite(rays_b), axis=1)
    rays_a[missing] = rays_b[missing] = np.nan
    return rays_a, rays_b


def _measure_degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    chord = np.linalg.norm(a - b, axis=1)
    return np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))


def fit_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Fits the rotation (3, 3) that brings directions (N, 3) onto others (Kabsch)."""
    u, _, vt = np.linalg.svd(target.T @ source)
    sign = np.sign(np.linalg.det(u @ vt))
    return u @ np.diag([1.0, 1.0, sign]) @ vt


def _align_points(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Returns unit directions (N, 3) to points (N, 3) after the rigid motion that brings them
    nearest to `directions`, in the least-squares sense."""
    turn = fit_rotation(points / np.linalg.norm(points, axis=1, keepdims=True), directions)

    def move_points(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        moved = transform_points(motion, points)
        length = np.linalg.norm(moved, axis=1)[:, None]
        return moved / length, moved, length

    def linearize(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unit, moved, length = move_points(motion)
        by_point = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, :, None]
        jacobian = np.concatenate(
            [-by_point @ cross_matrix_from_vector(moved), by_point], axis=2
        ).reshape(-1, 6)
        return jacobian.T @ (unit - directions).ravel(), jacobian.T @ jacobian

    motion, _ = minimize_least_squares(
        np.concatenate([rodrigues_from_matrix(turn), np.zeros(3)]),
        lambda motion: np.sum((move_points(motion)[0] - directions) ** 2),
        linearize,
        max_steps=ROUNDS,
        least_gain=LEAST_GAIN,
        apply=lambda motion, step: compose(step, motion),
    )
    return move_points(motion)[0]
