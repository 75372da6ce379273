"""How far poses found from colours can be trusted, by two disjoint halves of each photograph.

Both halves are solved alone. Where colours know a pose, both say the same; where texture is poor or
the scene still wrong, they differ. How much they do is the colours' error (see `Halves`), against
which stands that of the poses they started from: known for tracks, else estimated from how far
colours lead away. The weight that follows decides how far a view goes, down to not at all.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut.lens import Camera
from gsut.refine.motion import extrapolate, pose_changes

# Both halves see the same scene, whose own errors they share. On a demo scene (seed 11) poses were
# off by 1.4 (young scene) to 2.7 (finished scene) times what half their difference says.
_SHARED = 2.5
_BLOCKS = 16  # of a half's checkerboard, along the longer side: larger than what errors spread over
_NAMED = 5  # views in a note, at most
_REJECTED = 0.5  # weight below which a view is named: its start counts more than its colours


@dataclasses.dataclass(frozen=True)
class Halves:
    """Two sets of poses (n, 4, 4), camera_from_world, of the same views by different pixels."""

    first: np.ndarray
    second: np.ndarray

    def middle(self) -> np.ndarray:
        """(n, 4, 4) halfway between both."""
        return extrapolate(self.first, self.second, 0.5)

    def errors(self) -> np.ndarray:
        """(n, 2) errors of `middle` in degrees and world units, as one view alone shows them."""
        apart = pose_changes(self.first, self.second)
        return _SHARED / 2 * np.stack([apart.degrees, apart.distances], axis=1)


@dataclasses.dataclass(frozen=True)
class Trust:
    """Weights of the poses that colours found.

    Attributes:
        weights: (n,) 0: a view stays where it started; 1: it goes where its colours say.
        errors: (2,) of the colours, degrees and world units, median over the views.
    """

    weights: np.ndarray
    errors: np.ndarray

    def rejected(self, names: list[str]) -> list[dict[str, Any]]:
        """Views whose start counts more than their colours, for metrics.json."""
        return [
            {"name": name, "weight": float(weight)}
            for name, weight in zip(names, self.weights, strict=True)
            if weight < _REJECTED
        ]

    def note(self, names: list[str]) -> str:
        """What a reader of the report should know; empty where all views follow their colours."""
        named = [row["name"] for row in self.rejected(names)]
        if not named:
            return ""
        by = f"by {self.errors[0]:.2g} degrees and {self.errors[1]:.2g} units"
        if len(named) > len(names) / 2:
            return (
                f"For {len(named)} of {len(names)} training views colours count less than the "
                f"poses they had: halves of their pixels put a view off {by}."
            )
        shown = ", ".join(named[:_NAMED]) + (" ..." if len(named) > _NAMED else "")
        return (
            f"{len(named)} of {len(names)} training views stay near the poses they had: halves of "
            f"their pixels disagree (others are off {by}). {shown}"
        )


def weigh_lens(first: Camera, second: Camera, start: Camera) -> tuple[float, float]:
    """What the mean of the lenses that both halves found is worth, and its error in pixels.

    As for poses whose start is unknown, by the places that lenses give to rays (`lens_distance`):
    coefficients of a polynomial trade with each other.
    """
    error = _SHARED / 2 * lens_distance(first, second)
    middle = first.with_params((np.array(first.params) + np.array(second.params)) / 2)
    moved = lens_distance(middle, start)
    return (1.0 - (error / moved) ** 2 if moved > error else 0.0), error


def lens_distance(first: Camera, second: Camera) -> float:
    """Root mean square distance in pixels between where two lenses see the second one's rays."""
    rays, valid = second.rays()
    seen, known = first.project(rays[valid])
    expected, _ = second.project(rays[valid])
    if not known.any():
        return float("inf")
    return float(np.sqrt(np.mean(np.sum((seen - expected)[known] ** 2, axis=1))))


def select_half(height: int, width: int, half: int) -> np.ndarray:
    """(H, W) bool: the white, or the black, blocks of a checkerboard."""
    side = max(1, round(max(height, width) / _BLOCKS))
    rows, columns = np.arange(height) // side, np.arange(width) // side
    return (rows[:, None] + columns[None]) % 2 == half


def weigh_poses(
    halves: Halves, start: np.ndarray, tracked: np.ndarray, sigma: float | None
) -> Trust:
    """How far views may go from where they started to where their colours say.

    The best mean of two independent poses gives one the share of the other's variance. Over the
    views, colours differ from the start by distance^2 = start's^2 + colours'^2. That gives the
    start's error where it is not known (`sigma` is None), and shows where colours err by more than
    their halves tell where it is.

    Args:
        halves: what the colours say.
        start: (n, 4, 4) poses before any refinement by colours.
        tracked: (n,) bool: views to which `sigma` belongs; the others count as unknown.
        sigma: degrees, standard deviation of the tracked views' turns as tracks predict it. Their
            centres' depends on where the gauge is held, so that turns stand for both.
    """
    own = np.maximum(halves.errors(), 1e-12)
    errors = np.median(own, axis=0)
    changes = pose_changes(halves.middle(), start)
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
