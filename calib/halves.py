"""How far two lenses of one camera disagree: odd and even photographs, or two kinds of lens."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.board import Board, Photograph
from calib.corners import FEWEST_BOARDS
from calib.errors import SolveError
from calib.lens import rays
from calib.solution import CameraSolution
from calib.trust import Trust, field_angle
from calib.uncertainty import grid_pixels

AGREEMENT_DEGREES = 0.3  # between the rays of two good lenses of one camera


@dataclass
class Halves:
    """Angle between the rays of two solves, after turning one onto the other.

    Args:
        degrees: (rows, columns) on the grid of `uncertainty.grid_pixels`; NaN without a ray.
        median_degrees, worst_degrees: inside the trusted field.
    """

    degrees: np.ndarray
    median_degrees: float
    worst_degrees: float


def compare_halves(
    camera: CameraSolution,
    trust: Trust,
    board: Board,
    solve: Callable[[Sequence[Photograph]], CameraSolution],
) -> Halves | None:
    """Solves odd and even photographs alone; None where a half is too small or has no lens.

    The angle to which both are trusted is the full solve's. The difference of two halves is about
    twice the full solve's standard deviation.
    """
    odd, even = camera.photographs[0::2], camera.photographs[1::2]
    if min(len(odd), len(even)) < FEWEST_BOARDS:
        return None
    try:
        return compare_lenses(solve(odd), solve(even), trust.valid_angle)
    except SolveError:
        return None


def compare_lenses(a: CameraSolution, b: CameraSolution, valid_angle: float) -> Halves:
    """Angles between the rays of two lenses at the same pixels, turned onto each other."""
    pixels = grid_pixels(a.width, a.height)
    flat = pixels.reshape(-1, 2)
    rays_a, rays_b = rays(a, flat), rays(b, flat)
    both = np.all(np.isfinite(rays_a) & np.isfinite(rays_b), axis=1)
    trusted = both & (field_angle(rays_a) <= valid_angle)
    degrees = np.full(len(flat), np.nan)
    if trusted.sum() < 3:
        return Halves(degrees.reshape(pixels.shape[:2]), float("nan"), float("nan"))
    rotation = best_rotation(rays_b[trusted], rays_a[trusted])
    turned = rays_b[both] @ rotation.T
    chord = np.linalg.norm(turned - rays_a[both], axis=1)
    degrees[both] = np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))
    return Halves(
        degrees.reshape(pixels.shape[:2]),
        float(np.median(degrees[trusted])),
        float(np.max(degrees[trusted])),
    )


def agreement_angle(a: CameraSolution, b: CameraSolution, limit: float) -> float:
    """Radians from the axis up to which two lenses agree within AGREEMENT_DEGREES everywhere.

    Args:
        a, b: two lenses of one camera. limit: not further than this.
    """
    pixels = grid_pixels(a.width, a.height).reshape(-1, 2)
    rays_a, rays_b = rays(a, pixels), rays(b, pixels)
    angle = field_angle(rays_a)
    both = np.all(np.isfinite(rays_a) & np.isfinite(rays_b), axis=1)
    for outer in np.arange(limit, 0.0, -np.radians(1.0)):
        inside = both & (angle <= outer)
        if inside.sum() < 3:
            break
        turn = best_rotation(rays_b[inside], rays_a[inside])
        chord = np.linalg.norm(rays_b[inside] @ turn.T - rays_a[inside], axis=1)
        if np.degrees(chord.max()) <= AGREEMENT_DEGREES:
            return float(outer)
    return 0.0


def best_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3, 3) the rotation that brings directions (N, 3) onto others with least squares (Kabsch)."""
    u, _, vt = np.linalg.svd(target.T @ source)
    sign = np.sign(np.linalg.det(u @ vt))
    return u @ np.diag([1.0, 1.0, sign]) @ vt
