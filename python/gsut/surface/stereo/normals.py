"""Normals of what a view shows: planes through its distances."""

from __future__ import annotations

import itertools

import numpy as np

from gsut.surface.stereo.photograph import Photograph

# Pixels to each side of a pixel to whose distances its plane is fitted: fewer are noisy.
_REACH = 4
# Relative change of the inverse distance from pixel to pixel above which there is an edge.
_EDGE = 0.1
# Least share of the pixels around that must lie on the same surface.
_ENOUGH = 0.4


def fit_normals(photograph: Photograph, inverse: np.ndarray) -> np.ndarray:
    """Fits a plane to the distances around each pixel.

    A ray from o along d, both from the camera's middle pose, meets the plane n . x = h at the
    inverse distance q with n / h . (o q + d) = q: linear in q, whose errors are alike everywhere.

    Args:
        photograph: of the view.
        inverse: (H, W) inverse distances, 0 where unknown.

    Returns:
        (H, W, 3) float32 unit normals in the camera's axes, towards it; 0 where unknown.
    """
    height, width = inverse.shape
    y, x = np.mgrid[0:height, 0:width].reshape(2, -1)
    starts, rays = photograph.trace_rays(np.stack([x, y], axis=1) + 0.5)
    turn, shift = photograph.pose[:3, :3], photograph.pose[:3, 3]
    nearness = inverse.ravel().astype(np.float64)
    scaled = (starts @ turn.T + shift) * nearness[:, None] + rays @ turn.T
    known = (nearness > 0) & np.isfinite(scaled).all(axis=1)
    scaled = np.where(known[:, None], scaled, 0.0)
    columns = np.concatenate([scaled, np.where(known, nearness, 0.0)[:, None]], axis=1)
    moments = np.einsum("ni,nj->nij", scaled, columns).reshape(height, width, 12)
    sums, counts = _sum_around(moments, np.where(known, nearness, 0.0).reshape(height, width))
    enough = counts >= _ENOUGH * (2 * _REACH + 1) ** 2
    sums = sums[enough].reshape(-1, 3, 4)
    planes = np.linalg.solve(sums[..., :3], sums[..., 3:])[..., 0]
    normals = np.zeros((height, width, 3), np.float32)
    length = np.linalg.norm(planes, axis=1, keepdims=True)
    normals[enough] = -planes / np.maximum(length, np.finfo(float).tiny)
    return normals


def _sum_around(moments: np.ndarray, nearness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums moments (H, W, k) over the pixels around each that lie on its surface; counts them."""
    height, width = nearness.shape
    edge = ((_REACH, _REACH), (_REACH, _REACH))
    moments, beside = np.pad(moments, (*edge, (0, 0))), np.pad(nearness, edge)
    sums, counts = np.zeros((height, width, moments.shape[2])), np.zeros((height, width), int)
    steps = range(-_REACH, _REACH + 1)
    for down, right in itertools.product(steps, steps):
        part = np.s_[_REACH + down :, _REACH + right :]
        there = beside[part][:height, :width]
        most = _EDGE * max(abs(down), abs(right)) * nearness
        same = (there > 0) & (nearness > 0) & (np.abs(there - nearness) <= most)
        sums += np.where(same[..., None], moments[part][:height, :width], 0.0)
        counts += same
    return sums, counts
