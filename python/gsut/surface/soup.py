"""The triangles of a model as a mesh of opaque ones, for programs that draw meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians, rotations_from_quaternions
from gsut.render import render
from gsut.surface.mesh import Mesh

_TRIANGLE = "triangle"
_OPAQUE = 0.5  # a triangle reaches to where it hides this much of what lies behind
# Of the gauge 1, in units of the scales.
_CORNERS = np.array([[0.0, 1.0], [-np.sqrt(0.75), -0.5], [np.sqrt(0.75), -0.5]])


def make_soup(gaussians: Gaussians, scene: Any) -> Mesh:
    """Makes a mesh of a model's triangles, each as large as it hides half of what lies behind it.

    Triangles that hide less everywhere are left out. Each keeps three vertices of its own, of one
    colour: the mean of what the training views see of it, by its weight in their pixels.

    Args:
        gaussians: of the primitive "triangle".
        scene: the dataset that they were trained on.

    Returns:
        The mesh; faces are in the order of the triangles.

    Raises:
        InputError: another primitive, or no triangle hides half.
    """
    if gaussians.primitive != _TRIANGLE:
        raise InputError(
            f"triangles are taken from models of them, found primitive {gaussians.primitive}; "
            "train with --primitive triangle, or make a mesh of the surface"
        )
    squared = _core.compute_cutoffs(
        gaussians.primitive,
        gaussians.response,
        gaussians.opacity_logits.astype(np.float64),
        _OPAQUE,
    )
    kept = np.flatnonzero(squared > 0.0)
    if not len(kept):
        raise InputError(f"none of the {len(gaussians):,} triangles hides half of what is behind")
    colors = _average_colors(gaussians, scene)[kept]
    some = gaussians[kept].to_dtype(np.float64)
    reach = np.exp(some.log_scales[:, :2]) * np.sqrt(squared[kept])[:, None]
    unit = some.quats / np.linalg.norm(some.quats, axis=1, keepdims=True)
    axes = rotations_from_quaternions(unit)[:, :, :2] * reach[:, None]
    corners = (some.means + some.origin)[:, None] + np.einsum("nij,cj->nci", axes, _CORNERS)
    faces = np.arange(3 * len(kept), dtype=np.uint32).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), faces, np.repeat(colors, 3, axis=0))


def _average_colors(gaussians: Gaussians, scene: Any) -> np.ndarray:
    """Averages (N, 3) the colours that the training views see of each, by weight in pixels."""
    total = np.zeros((len(gaussians), 1), np.float32)
    colors = np.zeros((len(gaussians), 3))
    for index in scene.train_indices or range(len(scene.views)):
        camera, view = scene.camera(index), scene.views[index]
        weights = np.zeros_like(total)
        render(gaussians.order_by_centers(), camera, view.motion).add_map(
            np.ones((camera.height, camera.width, 1), np.float32), weights
        )
        seen = np.flatnonzero(weights[:, 0])
        away = gaussians.means[seen] + (gaussians.origin - view.camera_center)
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        shown = _core.eval_harmonics(away, gaussians.sh[seen])
        colors[seen] += weights[seen] * np.clip(shown, 0.0, 1.0)
        total[seen] += weights[seen]
    return (colors / np.maximum(total, 1e-30)).astype(np.float32)
