"""A photograph prepared for comparison: grey values, rays and projection in the world."""

from __future__ import annotations

import numpy as np

from gsut._core import CameraMotion
from gsut.data import Scene
from gsut.data.scene import find_line_times, interpolate_poses, project_points

# Pixels a side of the cells between whose centres the lens' projection is interpolated.
CELL = 8


def shrink(scene: Scene, side: float) -> Scene:
    """Returns the scene with images of at most `side` pixels; the same if they are no larger."""
    longest = max(max(camera.width, camera.height) for camera in scene.cameras)
    return scene.scale_images(side / longest, keep_larger=True) if longest > side else scene


class Photograph:
    """A view of a scene: grey values, mask, and the way between its pixels and the world.

    Args:
        scene: at the size of the comparison.
        view: index of the view.
    """

    def __init__(self, scene: Scene, view: int) -> None:
        import cv2

        self.camera, self.motion = scene.camera(view), scene.views[view].motion
        self.pose = scene.views[view].camera_from_world
        self.color, self.mask = scene.image(view), scene.mask(view)
        grey = cv2.cvtColor(self.color, cv2.COLOR_RGB2GRAY).astype(np.float32) / np.float32(255)
        self.grey = np.where(self.mask, grey, np.float32(0))

    def trace_rays(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns origins and directions of the rays of pixels (n, 2) in the world; NaN without a
        ray."""
        starts, rays = np.zeros((len(pixels), 3)), self.camera.unproject(pixels)[0]
        if not self.camera.is_central:
            last = (self.camera.width - 1, self.camera.height - 1)
            column, row = np.clip(pixels.astype(np.int64), 0, last).T
            starts = self.camera.origins()[row, column]
        poses = self.pose[None]
        if isinstance(self.motion, CameraMotion):
            poses = interpolate_poses(
                self.motion, find_line_times(self.camera, self.motion, pixels)
            )
        back = np.broadcast_to(poses[:, :3, :3], (len(pixels), 3, 3))
        return (
            np.einsum("nji,nj->ni", back, starts - poses[:, :3, 3]),
            np.einsum("nji,nj->ni", back, rays),
        )

    def trace_cells(self) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
        """Returns origins and directions of the rays of the cells' centres, and rows, columns."""
        height, width = self.grey.shape
        rows, columns = -(-height // CELL), -(-width // CELL)
        y, x = np.mgrid[0:rows, 0:columns]
        centers = np.stack([x.ravel(), y.ravel()], axis=1) * CELL + CELL / 2
        return *self.trace_rays(centers), (rows, columns)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Projects points (n, 3): pixels (n, 2), also beside the image, NaN where the lens does
        not see, and inverse distances (n,)."""
        in_camera, pixels, valid = project_points(self.camera, self.motion, points)
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse = 1 / np.linalg.norm(in_camera, axis=1)
        return np.where(valid[:, None], pixels, np.nan), np.where(valid, inverse, 0.0)

    def is_inside(self, pixels: np.ndarray) -> np.ndarray:
        """Returns (n,) bool: whether pixels (n, 2) lie in the image; NaN does not."""
        size = np.array([self.camera.width, self.camera.height])
        return np.asarray(((pixels >= 0) & (pixels < size)).all(axis=1))
