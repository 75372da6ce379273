"""Images coarser than the photographs, without aliasing: Gaussians as wide as their pixels ask.

Trained Gaussians are right at the size of the photographs' pixels: the mean over such a pixel is
theirs already. A pixel that is larger where a Gaussian stands takes the mean over more: the
variance of a square, its side squared over 12, less that of the finest photograph's pixel there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import CameraMotion
from gsut.gaussians import StoredGaussians, compute_pixel_density, find_pixel_sizes
from gsut.render.motion import place_about

_SQUARE = 1.0 / 12.0  # variance of a square pixel along a side of length 1
_MOST_CAMERAS = 32  # photographs, evenly chosen, that say how fine a Gaussian was seen
_ALIKE = 0.98  # of the pixels a unit of area, above which sizes count as one
_LEAST = 1e-4  # of the squared smallest scale, below which nothing is widened


class PixelFilter:
    """Widens Gaussians for images that are coarser than the photographs they were trained on.

    Args:
        gaussians: float32, at the dataset's coordinates.
        cameras: of the photographs.
        camera_from_world: (C, 4, 4), one a camera.
        most_cameras: that are asked, evenly chosen.
    """

    def __init__(
        self,
        gaussians: Any,
        cameras: Sequence[Any],
        camera_from_world: np.ndarray,
        most_cameras: int = _MOST_CAMERAS,
    ) -> None:
        self.gaussians = gaussians
        step = -(-len(cameras) // most_cameras)
        poses = [
            np.asarray(place_about(pose, gaussians.origin)) for pose in camera_from_world[::step]
        ]
        self._means = gaussians.means.astype(np.float64)
        self._finest = find_pixel_sizes(self._means, cameras[::step], np.stack(poses)) ** 2

    @staticmethod
    def from_scene(gaussians: Any, scene: Any, most_cameras: int = _MOST_CAMERAS) -> PixelFilter:
        """Makes the filter of Gaussians that were trained on a scene's training views.

        Args:
            gaussians: see above.
            scene: at the size that was trained at.
            most_cameras: see above.
        """
        if isinstance(gaussians, StoredGaussians):
            return _StoredPixelFilter(gaussians, scene, most_cameras)
        rows = scene.train_indices or range(len(scene))
        cameras = [scene.camera(row) for row in rows]
        return PixelFilter(gaussians, cameras, scene.poses(rows), most_cameras)

    @staticmethod
    def is_coarser(camera: Any, photographs: Sequence[Any]) -> bool:
        """Returns whether a lens' pixels are larger, at its axis, than the finest photograph's."""
        axis, pose = np.array([[0.0, 0.0, 1.0]]), np.eye(4)
        finest = max(float(compute_pixel_density(axis, each, pose)[0]) for each in photographs)
        return bool(compute_pixel_density(axis, camera, pose)[0] < _ALIKE * finest)

    def widen(self, camera: Any, camera_from_world: Any) -> Any:
        """Returns the Gaussians as wide as the pixels of one image need them.

        Args:
            camera: lens and size of the image.
            camera_from_world: (4, 4), or a CameraMotion, whose middle counts.
        """
        place = place_about(camera_from_world, self.gaussians.origin)
        pose = place.at(0.5) if isinstance(place, CameraMotion) else np.asarray(place)
        density = compute_pixel_density(self._means, camera, pose)
        with np.errstate(divide="ignore"):
            side2 = np.where(density > 0, 1.0 / density, 0.0)
        missing = _SQUARE * (side2 - self._finest)
        return self.widen_by(self.gaussians, missing, pose)

    @staticmethod
    def widen_by(gaussians: Any, variances: np.ndarray, camera_from_world: np.ndarray) -> Any:
        """Widens Gaussians by isotropic variances, so that as much light passes to a camera.

        Scales s become sqrt(s^2 + v). The largest response along a ray is what is drawn, so the
        opacities are multiplied by the ratio of the areas of shadows along the ray to the centre.

        Args:
            gaussians: N Gaussians; returned themselves if none is widened.
            variances: (N,) of their coordinates, squared.
            camera_from_world: (4, 4), about the Gaussians' origin.
        """
        g, pose = gaussians, camera_from_world
        scales = g.log_scales.astype(np.float64)
        rows = np.flatnonzero(variances > _LEAST * np.exp(2.0 * scales.min(axis=1)))
        if not len(rows):
            return g
        before = np.exp(2.0 * scales[rows])
        after = before + variances[rows, None]
        center = -pose[:3, :3].T @ pose[:3, 3]
        away = g.means[rows].astype(np.float64) - center
        along = _to_own_axes(g.quats[rows].astype(np.float64), away) ** 2
        # det S^2 times d' S^-2 d: the squared area of the shadow along d.
        areas = [v.prod(axis=1) * (along / v).sum(axis=1) for v in (before, after)]
        opacity = np.sqrt(areas[0] / areas[1]) / (
            1.0 + np.exp(-g.opacity_logits[rows].astype("f8"))
        )
        log_scales, logits = g.log_scales.copy(), g.opacity_logits.copy()
        log_scales[rows] = 0.5 * np.log(after)
        logits[rows] = np.log(opacity) - np.log1p(-opacity)
        return dataclasses.replace(g, log_scales=log_scales, opacity_logits=logits)


class _StoredPixelFilter(PixelFilter):
    """`PixelFilter` of Gaussians in a file: each image's are widened when they are read.

    Args:
        gaussians: in a file.
        scene, most_cameras: see `PixelFilter.from_scene`.
    """

    def __init__(self, gaussians: StoredGaussians, scene: Any, most_cameras: int) -> None:
        self.gaussians = gaussians
        self._scene, self._most_cameras = scene, most_cameras

    def widen(self, camera: Any, camera_from_world: Any) -> StoredGaussians:
        """Does as `PixelFilter.widen`, when the Gaussians are read."""

        def widen_part(part: Any) -> Any:
            own = PixelFilter.from_scene(part, self._scene, self._most_cameras)
            return own.widen(camera, camera_from_world)

        return self.gaussians.with_change(widen_part)


def _to_own_axes(quats: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotates world vectors (N, 3) into the axes of Gaussians of these quaternions (N, 4)."""
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    w, axis = unit[:, :1], -unit[:, 1:]
    turned = 2.0 * np.cross(axis, vectors)
    return vectors + w * turned + np.cross(axis, turned)
