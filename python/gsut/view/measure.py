"""Finds the point of the scene that a pixel sees."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError
from gsut.gaussians import OPAQUE
from gsut.render import Confidence, render
from gsut.view.stage import Stage

# Standard deviation of a coordinate of a pixel that a person points at, in pixels.
_POINTING = 0.5


def find_pose_of_pixel(place: Any, camera: Any, pixel: np.ndarray) -> np.ndarray:
    """Returns camera_from_world (4, 4) at the moment at which a pixel was read.

    Args:
        place: (4, 4) camera_from_world, or a CameraMotion.
        camera: of the image.
        pixel: (2,).
    """
    if not isinstance(place, CameraMotion):
        return np.asarray(place, np.float64)
    times = place.shutter.line_times(camera.width, camera.height)
    line = pixel[1] if len(times) == camera.height else pixel[0]
    return place.at(float(times[int(np.clip(line, 0, len(times) - 1))]))


def find_point_at(
    place: Any, camera: Any, pixel: np.ndarray, alpha: np.ndarray, depth: np.ndarray
) -> np.ndarray | None:
    """Returns the point (3,) at the expected distance along a pixel's ray; None if nothing is
    there.

    Args:
        place, camera: of the image.
        pixel: (2,) x and y.
        alpha, depth: (H, W), see `gsut.render`.
    """
    at = np.asarray(pixel, np.float64)[None]
    rays, valid = camera.unproject(at)
    column, row = (int(np.clip(value, 0, side - 1)) for value, side in
                   zip(at[0], (camera.width, camera.height), strict=True))  # fmt: skip
    if not valid[0] or alpha[row, column] < OPAQUE:
        return None
    in_camera = camera.ray_origins(at)[0][0] + depth[row, column] / alpha[row, column] * rays[0]
    pose = find_pose_of_pixel(place, camera, at[0])
    return pose[:3, :3].T @ (in_camera - pose[:3, 3])


def find_point_in_photograph(
    stage: Stage, name: str, pixel: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the point (3,) that a photograph's pixel sees, in the dataset's coordinates.

    The covariance (3, 3) that is returned beside it is that of the rendered distance and of
    pointing; it leaves out errors of the pose.

    Args:
        stage: with photographs.
        name: of the photograph; its folders may be left out.
        pixel: x and y in the photograph's own pixels.

    Raises:
        InputError: no such photograph or pixel, or nothing is seen there.
    """
    scene = stage.scene
    if scene is None:
        raise InputError(f"{stage.name} has no photographs; give a run, a dataset, or points")
    rows = [i for i, view in enumerate(scene.views) if view.name == name]
    rows = rows or [i for i, view in enumerate(scene.views) if view.name.endswith(f"/{name}")]
    if len(rows) != 1:
        near = ", ".join(view.name for view in scene.views[:3])
        raise InputError(f"{len(rows)} photographs are named {name}; names are like {near}")
    view, camera = scene.views[rows[0]], scene.camera(rows[0])
    full = scene.file_cameras[view.camera_index]
    if not (0 <= pixel[0] <= full.width and 0 <= pixel[1] <= full.height):
        raise InputError(f"{name} has {full.width} x {full.height} pixels, found {pixel}")
    at = np.array(pixel) * [camera.width / full.width, camera.height / full.height]
    point = None
    if stage.gaussians is not None and len(stage.gaussians):
        seen = render(stage.gaussians, camera, view.motion)
        point = find_point_at(view.motion, camera, at, seen.alpha, seen.depth)
    if point is None:
        raise InputError(f"{name}: nothing is seen at pixel {pixel[0]:g}, {pixel[1]:g}")
    row, column = (int(np.clip(value, 0, side - 1)) for value, side in
                   zip(at[::-1], (camera.height, camera.width), strict=True))  # fmt: skip
    alpha, depth = float(seen.alpha[row, column]), float(seen.depth[row, column])
    along = float(Confidence.find_depth_sigma(float(seen.distortion[row, column]), depth, alpha))
    pose = find_pose_of_pixel(view.motion, camera, at)
    rays = camera.unproject(at + _POINTING * np.array([[0, 0], [1, 0], [0, 1]]))[0] @ pose[:3, :3]
    steps = np.stack([along * rays[0], *(depth / alpha * (rays[1:] - rays[0]))])
    return point + scene.world_offset, steps.T @ steps
