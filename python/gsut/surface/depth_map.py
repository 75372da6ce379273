"""One view's depth along its rays."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import CameraMotion


@dataclasses.dataclass(frozen=True)
class DepthMap:
    """One view's depth along its rays.

    Attributes:
        camera, motion: as the map was rendered.
        depth: (H, W) float32 from the rays' origins; infinity: the ray meets nothing, NaN: unknown.
        weight: (H, W) float32 in [0, 1], or None: 1.
        image: (H, W, 3) uint8, or None.
        normals: (H, W, 3) float32 unit normals in the camera's axes, 0: unknown; or None.
    """

    camera: Any
    motion: np.ndarray | CameraMotion
    depth: np.ndarray
    weight: np.ndarray | None = None
    image: np.ndarray | None = None
    normals: np.ndarray | None = None


def list_views(maps: Sequence[DepthMap], center: np.ndarray) -> _core.DepthViews:
    """Lists maps for the core, about a centre."""
    views = _core.DepthViews(list(center))
    for m in maps:
        views.add(m.camera, m.motion, m.depth, m.weight, m.image)
    return views
