"""Fits the falloff of a lens to what all its photographs show in rings of equal field angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.judge import SURE
from gsut.render import Falloff, compute_field_angles

# Rings of equal field angle that a photograph is divided into: enough for two even powers.
RINGS = 8
# Quarters of the picture that each ring is divided into, to measure disagreement.
QUADRANTS = 4
# Relative difference of rings from their mean below which a lens has no falloff.
_FALLOFF_DIFFERS = 0.05
# Share of all visible pixels below which a ring is not judged.
_FEWEST_SHOWN = 0.01
# Weight of a ring's prior; the weights of the visible rings add up to 1.
_PRIOR = 1e-4
# Fewest rows and columns of pixels over which a ring's mean is taken; more change nothing.
_BASIS_ROWS = 100


def divide_photograph(camera: _core.Camera) -> np.ndarray:
    """Returns the part of each pixel, (H, W) uint8: ring x quadrants + quadrant."""
    lower = np.arange(camera.height)[:, None] >= camera.height / 2
    right = np.arange(camera.width)[None] >= camera.width / 2
    angles = compute_field_angles(camera)
    return (
        _number_rings(angles, find_widest_angle(angles)) * QUADRANTS + 2 * lower + right
    ).astype(np.uint8)


def find_widest_angle(angles: np.ndarray) -> float:
    """Returns the largest of field angles (...) in radians, above zero even for a single pixel."""
    return float(np.nanmax(angles, initial=np.finfo(float).tiny))


def _number_rings(angles: np.ndarray, widest: float) -> np.ndarray:
    """Returns the ring of each field angle (...) of a camera; NaN counts as the last ring."""
    return np.minimum(RINGS * np.nan_to_num(angles, nan=widest) / widest, RINGS - 1).astype(int)


def average_basis(angles: np.ndarray) -> np.ndarray:
    """Returns (rings, ORDERS) means of the falloff's even powers over the pixels of each ring."""
    widest, known = find_widest_angle(angles), _select_angles(angles)
    ring, basis = _number_rings(known, widest), Falloff.compute_basis(known / widest)
    counts = np.maximum(1, np.bincount(ring, minlength=RINGS))
    sums = [np.bincount(ring, column, minlength=RINGS) for column in basis.T]
    return np.stack(sums, axis=1) / counts[:, None]


def _select_angles(angles: np.ndarray) -> np.ndarray:
    """Selects (N,) field angles of a grid of an image's pixels, without those that have no ray."""
    few = max(1, min(angles.shape) // _BASIS_ROWS)
    some = angles[::few, ::few]
    return some[~np.isnan(some)]


def measure_passed_light(scene: Scene, falloffs: Sequence[Falloff | None]) -> np.ndarray:
    """Measures the mean (3,) of cameras' falloffs over the pixels of all training photographs."""
    cameras = [scene.views[view].camera_index for view in scene.train_indices]
    means, pixels = [], []
    for index, (camera, falloff) in enumerate(zip(scene.cameras, falloffs, strict=True)):
        pixels.append(cameras.count(index) * camera.width * camera.height)
        angles = _select_angles(compute_field_angles(camera))
        means.append(np.ones(3) if falloff is None else falloff.evaluate(angles).mean(axis=0))
    return np.average(means, axis=0, weights=pixels)


def fit_falloff(angle: float, basis: np.ndarray, tc: np.ndarray, cc: np.ndarray) -> Falloff:
    """Fits the falloff of mean `basis` to sums of T C and C^2 of rings (rings, 3)."""
    basis = np.concatenate([np.ones((RINGS, 1)), basis], axis=1)
    coefficients = np.zeros((3, basis.shape[1]))
    for channel in range(3):
        of_all = cc[:, channel].sum()
        mean = tc[:, channel].sum() / of_all
        # Rings that show nothing stay at the mean.
        weight = cc[:, channel] / of_all + _PRIOR
        right = basis.T @ (tc[:, channel] / of_all + _PRIOR * mean)
        normal = basis.T @ (weight[:, None] * basis)  # singular where all is on the axis
        coefficients[channel] = np.linalg.lstsq(normal, right, rcond=None)[0]
    return Falloff(angle, coefficients[:, 1:] / coefficients[:, :1])


def is_falloff_certain(tc: np.ndarray, cc: np.ndarray) -> bool:
    """Returns whether rings differ by more than photographs (views, rings, 3) disagree."""
    tc, cc = tc.sum(axis=2), cc.sum(axis=2)
    of_ring = np.maximum(cc.sum(axis=0), np.finfo(float).tiny)
    level = tc.sum(axis=0) / of_ring
    errors = np.sqrt(np.sum((tc - level * cc) ** 2, axis=0)) / of_ring
    mean = tc.sum() / cc.sum()
    seen = of_ring > _FEWEST_SHOWN * of_ring.sum()
    apart = np.abs(level / mean - 1.0)
    return bool((seen & (apart > np.maximum(_FALLOFF_DIFFERS, SURE * errors / mean))).any())
