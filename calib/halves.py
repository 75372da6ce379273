"""How far two lenses of one camera disagree: of odd and even photographs, or of two models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.board import Photograph
from calib.corners import FEWEST_BOARDS
from calib.errors import SolveError
from calib.lens import rays
from calib.rigid import compose, rodrigues_vector, skew, transform_points
from calib.solution import CameraSolution
from calib.trust import field_angle
from calib.uncertainty import spread_pixels
from gsut.least_squares import minimize_least_squares

AGREEMENT_DEGREES = 0.3  # between the rays of two good lenses of one camera
_FEWEST_RAYS = 3  # that fix a rotation
_STEPS, _DONE = 8, 1e-9  # for a shift of millimetres; relative decrease of the squares
_SCAN = np.radians(1.0)  # between the angles that are tried


@dataclass
class Halves:
    """Angle between the rays of two solves, after turning one onto the other.

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
    """The lenses of odd and of even photographs; None where a half is too small or has no lens.

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
    """Angles between the rays of two lenses at the same pixels, turned onto each other."""
    pixels = spread_pixels(a.width, a.height)
    rays_a, rays_b = _rays_of_both(a, b)
    trusted = field_angle(rays_a) <= valid_angle
    degrees = np.full(len(rays_a), np.nan)
    if trusted.sum() < _FEWEST_RAYS:
        return Halves(degrees.reshape(pixels.shape[:2]), float("nan"), float("nan"))
    turn = best_rotation(rays_b[trusted], rays_a[trusted])
    degrees = _degrees_between(rays_b @ turn.T, rays_a)
    return Halves(
        degrees.reshape(pixels.shape[:2]),
        float(np.median(degrees[trusted])),
        float(np.max(degrees[trusted])),
    )


def agreement_angle(
    a: CameraSolution, b: CameraSolution, limit: float, distance: float = np.inf
) -> float:
    """Radians from the axis up to which two lenses agree within AGREEMENT_DEGREES everywhere.

    Two lenses of the same boards have frames of their own, turned and shifted against each other.
    The turn is taken out always; the shift, which points far away do not see, where a distance is
    given: boards that were all near fix the place of the centre of projection poorly, and two
    lenses that agree at the boards may differ far away.

    Args:
        a, b: two lenses of one camera. limit: not further than this. distance: of the points.
    """
    rays_a, rays_b = _rays_of_both(a, b)
    angle = field_angle(rays_a)
    for outer in np.arange(limit, 0.0, -_SCAN):
        inside = angle <= outer
        if inside.sum() < _FEWEST_RAYS:
            break
        source, target = rays_b[inside], rays_a[inside]
        if np.isfinite(distance):
            moved = _turned_and_shifted(source * distance, target)
        else:
            moved = source @ best_rotation(source, target).T
        if _degrees_between(moved, target).max() <= AGREEMENT_DEGREES:
            return float(outer)
    return 0.0


def _rays_of_both(a: CameraSolution, b: CameraSolution) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays (N, 3) of the grid's pixels; NaN in both where either lens has none."""
    pixels = spread_pixels(a.width, a.height).reshape(-1, 2)
    rays_a, rays_b = rays(a, pixels), rays(b, pixels)
    missing = ~np.all(np.isfinite(rays_a) & np.isfinite(rays_b), axis=1)
    rays_a[missing] = rays_b[missing] = np.nan
    return rays_a, rays_b


def _degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    chord = np.linalg.norm(a - b, axis=1)
    return np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))


def best_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3, 3) the rotation that brings directions (N, 3) onto others with least squares (Kabsch)."""
    u, _, vt = np.linalg.svd(target.T @ source)
    sign = np.sign(np.linalg.det(u @ vt))
    return u @ np.diag([1.0, 1.0, sign]) @ vt


def _turned_and_shifted(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N, 3) unit directions to points (N, 3) after the rigid motion that brings them nearest to
    `directions`, with least squares."""
    turn = best_rotation(points / np.linalg.norm(points, axis=1, keepdims=True), directions)

    def unit_of(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        moved = transform_points(motion, points)
        length = np.linalg.norm(moved, axis=1)[:, None]
        return moved / length, moved, length

    def normal_equations(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unit, moved, length = unit_of(motion)
        by_point = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, :, None]
        jacobian = np.concatenate([-by_point @ skew(moved), by_point], axis=2).reshape(-1, 6)
        return jacobian.T @ (unit - directions).ravel(), jacobian.T @ jacobian

    motion, _ = minimize_least_squares(
        np.concatenate([rodrigues_vector(turn), np.zeros(3)]),
        lambda motion: np.sum((unit_of(motion)[0] - directions) ** 2),
        normal_equations,
        max_steps=_STEPS,
        least_gain=_DONE,
        apply=lambda motion, step: compose(step, motion),
    )
    return unit_of(motion)[0]
