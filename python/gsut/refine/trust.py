"""Estimates how far poses from colours can be trusted, by two disjoint halves of each photograph.

Each half is solved by itself. If colours determine a pose, both halves agree; if texture is poor or
the scene still wrong, they differ. Their difference estimates the error of the colours (see
`Halves`). It is weighed against the error of the starting poses: known for tracks, otherwise
estimated from how far colours lead away from them. A view moves as far as its weight says, which
may be not at all.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut.data import list_some
from gsut.lens import Camera
from gsut.refine.motion import extrapolate, measure_pose_changes

# Actual error over half the difference of the halves: both see the same scene and share its errors.
_SHARED = 2.5
# Blocks of a half's checkerboard along the longer side: larger than what an error spreads over.
_BLOCKS = 16
# Weight below which a view is listed, because its start counts more than its colours.
_REJECTED = 0.5


@dataclasses.dataclass(frozen=True)
class Halves:
    """Poses (n, 4, 4), camera_from_world, of the same views from two disjoint sets of pixels."""

    first: np.ndarray
    second: np.ndarray

    def average(self) -> np.ndarray:
        """Returns the poses (n, 4, 4) halfway between both."""
        return extrapolate(self.first, self.second, 0.5)

    def estimate_errors(self) -> np.ndarray:
        """Estimates (n, 2) errors of `average()`, degrees and world units, view by view."""
        apart = measure_pose_changes(self.first, self.second)
        return _SHARED / 2 * np.stack([apart.degrees, apart.distances], axis=1)


@dataclasses.dataclass(frozen=True)
class Trust:
    """Weights of the poses from colours.

    Attributes:
        weights: (n,) 0: a view stays at its start; 1: it takes the pose from its colours.
        errors: (2,) of the colours' poses, degrees and world units, medians over the views.
    """

    weights: np.ndarray
    errors: np.ndarray

    def list_rejected(self, names: list[str]) -> list[dict[str, Any]]:
        """Lists views whose start counts more than their colours, for metrics.json."""
        return [
            {"name": name, "weight": float(weight)}
            for name, weight in zip(names, self.weights, strict=True)
            if weight < _REJECTED
        ]

    def note(self, names: list[str]) -> str:
        """Notes for the report which views keep their poses; empty if all follow their colours."""
        named = [row["name"] for row in self.list_rejected(names)]
        if not named:
            return ""
        by = f"by {self.errors[0]:.2g} degrees and {self.errors[1]:.2g} units"
        if len(named) > len(names) / 2:
            return (
                f"For {len(named)} of {len(names)} training views colours count less than the "
                f"poses they had: halves of their pixels put a view off {by}."
            )
        return (
            f"{len(named)} of {len(names)} training views stay near the poses they had: halves of "
            f"their pixels disagree (others are off {by}). {list_some(named)}"
        )


def weigh_lens(first: Camera, second: Camera, start: Camera) -> tuple[float, float]:
    """Weighs the mean of the lenses of both halves, and estimates its error in pixels.

    As for poses whose start has an unknown error, but by the pixels that lenses give to rays
    (`measure_lens_distance`), since coefficients of a polynomial compensate for each other.
    """
    error = _SHARED / 2 * measure_lens_distance(first, second)
    middle = first.with_params((np.array(first.params) + np.array(second.params)) / 2)
    moved = measure_lens_distance(middle, start)
    return (1.0 - (error / moved) ** 2 if moved > error else 0.0), error


def measure_lens_distance(first: Camera, second: Camera) -> float:
    """Measures the RMS distance in pixels between the images of the second lens' rays in both."""
    rays, valid = second.rays()
    seen, known = first.project(rays[valid])
    expected, _ = second.project(rays[valid])
    if not known.any():
        return float("inf")
    return float(np.sqrt(np.mean(np.sum((seen - expected)[known] ** 2, axis=1))))


def select_half(height: int, width: int, half: int) -> np.ndarray:
    """Selects (H, W) bool the white (0) or black (1) blocks of a checkerboard."""
    side = max(1, round(max(height, width) / _BLOCKS))
    rows, columns = np.arange(height) // side, np.arange(width) // side
    return (rows[:, None] + columns[None]) % 2 == half


def weigh_poses(
    halves: Halves, start: np.ndarray, tracked: np.ndarray, sigma: float | None
) -> Trust:
    """Weighs the poses from colours against those that the views started from.

    The best mean of two independent estimates weights each by the other's share of the variance.
    Over the views, the squared distance of colours from the start is the sum of both variances.
    This gives the start's error if it is unknown (`sigma` is None); if it is known, it shows where
    colours err by more than their halves do.

    Args:
        halves: poses from colours.
        start: (n, 4, 4) poses before any refinement by colours.
        tracked: (n,) bool: views to which `sigma` applies; the error of others is unknown.
        sigma: degrees, predicted standard deviation of the tracked views' rotations. That of their
            centres depends on the gauge, so rotations are taken for both.
    """
    own = np.maximum(halves.estimate_errors(), 1e-12)
    errors = np.median(own, axis=0)
    changes = measure_pose_changes(halves.average(), start)
    distances = np.stack([changes.degrees, changes.distances], axis=1)
    # Beyond the usual error a view's own counts.
    excess = np.maximum(1.0, np.mean((own / errors) ** 2, axis=1))
    known = tracked & (sigma is not None)
    ratios = np.zeros(len(start))  # of the start's variance to the colours'
    if not known.all():
        at = np.median(distances[~known], axis=0)
        ratios[~known] = max(0.0, float(np.mean((at / errors) ** 2)) - 1.0)
    if sigma is not None and known.any():
        at = float(np.median(distances[known, 0]))
        ratios[known] = sigma**2 / max(errors[0] ** 2, at**2 - sigma**2)
    return Trust(ratios / (ratios + excess), errors)
