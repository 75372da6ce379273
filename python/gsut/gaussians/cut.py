"""Selects Gaussians of a scene, joins scenes and finds the ground."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import check_direction, name_wrong_kinds
from gsut.gaussians.arrays import Gaussians
from gsut.gaussians.quaternions import rotations_from_quaternions

# Second axis over the thinnest from which a Gaussian counts as a piece of surface.
_FLATNESS = 2.0
# Cosine of the steepest slope that counts as level ground.
_LEVEL = np.cos(np.radians(30.0))
# Areas above this percentile count as equal to it: one Gaussian may be a whole wall or sky.
_LARGEST_PERCENT = 95
# Rounds of fitting the plane to what lies near the last one; it settles in three.
_ROUNDS = 5
# Slices of the scene's height in which level area is summed.
_LAYERS = 64
# Share of the fullest slice's area that the ground, the lowest such slice, has at least.
_LAYER_SHARE = 0.3


@name_wrong_kinds
def merge_gaussians(scenes: Sequence[Gaussians]) -> Gaussians:
    """Joins scenes of one world, in their order.

    Args:
        scenes: at least one.

    Returns:
        All Gaussians, relative to the first scene's origin; harmonics that a scene lacks are 0.

    Raises:
        InputError: there is no scene, or their responses, orders or primitives differ.
    """
    if not scenes:
        raise InputError("there are no scenes to merge; give at least one")
    for kind in ("response", "order", "primitive"):
        kinds = [getattr(g, kind) for g in scenes]
        if len(set(kinds)) > 1:
            raise InputError(
                f"scenes can be merged if they have one {kind}, found {', '.join(kinds)}"
            )
    origin = scenes[0].origin
    most = max(g.sh.shape[1] for g in scenes)
    parts = []
    for g in scenes:
        sh = np.zeros((len(g), most, 3), g.dtype)
        sh[:, : g.sh.shape[1]] = g.sh
        parts.append(dataclasses.replace(g.with_origin(origin), sh=sh))
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(g, name) for g in parts]) for name in parts[0].list_arrays()
    }
    return dataclasses.replace(parts[0], **joined)


@name_wrong_kinds
def find_ground(gaussians: Gaussians, up: np.ndarray) -> tuple[np.ndarray, float]:
    """Finds the plane that a scene stands on from its nearly level surfaces.

    Args:
        gaussians: the scene.
        up: (3,) roughly away from the ground, such as the cameras' mean up.

    Returns:
        (3,) the plane's upward unit normal, and its level: normal . x = level for points x of the
        plane in world coordinates.

    Raises:
        InputError: `up` is no direction, or fewer than three flat Gaussians lie level within 30
            degrees.
    """
    g, up = gaussians, check_direction(up, "up")
    unit = g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True)
    thin = np.argmin(g.log_scales, axis=1)
    normals = rotations_from_quaternions(unit.astype(np.float64))[np.arange(len(g)), :, thin]
    normals *= np.where(normals @ up < 0, -1.0, 1.0)[:, None]
    others = np.sort(g.log_scales, axis=1)
    flat = (others[:, 1] - others[:, 0] > np.log(_FLATNESS)) & (g.opacity_logits > 0)
    flat &= normals @ up > _LEVEL
    if np.count_nonzero(flat) < 3:
        raise InputError("no ground is found: no flat Gaussians lie level within 30 degrees")
    means = g.means[flat].astype(np.float64)
    areas = np.exp(others[flat, 1:].sum(axis=1).astype(np.float64))
    areas = np.minimum(areas, np.percentile(areas, _LARGEST_PERCENT))
    leaning = normals[flat] * areas[:, None]
    up = leaning.sum(axis=0) / np.linalg.norm(leaning.sum(axis=0))  # level surfaces know it better
    low = _find_lowest_layer(means @ up, areas)
    for _ in range(_ROUNDS):  # total least squares on a layer about the plane, ever thinner
        weights = areas * low
        middle = weights @ means / weights.sum()
        spread = (means - middle).T @ ((means - middle) * weights[:, None])
        normal = np.linalg.eigh(spread)[1][:, 0]
        normal *= np.sign(normal @ up)
        away = np.abs((means - middle) @ normal)
        low = away <= 2 * np.median(away[low]) + 1e-12
    return normal, float(normal @ (middle + g.origin))


def _find_lowest_layer(heights: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Finds (M,) bool the surfaces in the lowest slice of heights with much level area."""
    bottom, top = np.percentile(heights, [1, 99])
    edges = np.linspace(bottom, top, _LAYERS + 1)
    filled = np.histogram(heights, edges, weights=areas)[0]
    lowest = int(np.argmax(filled >= _LAYER_SHARE * filled.max()))
    step = edges[1] - edges[0]
    return (heights >= edges[lowest] - step) & (heights <= edges[lowest + 1] + step)
