"""Projects points through a shutter: one pose for the image, or one for each of its lines."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import CameraMotion

# Rounds until a point has settled on its line of a rolling shutter: each reduces the error by the
# ratio of the point's speed to the shutter's, far below one.
_LINE_STEPS = 4
# Steps of the exposure at which poses are interpolated: finer ones move points by less than a
# hundredth of a pixel.
_TIMES = 256
# A point is hidden if it is this many times as far as the nearest one in its cell of the image:
# surfaces seen at a slant span less within a cell.
_HIDES = 1.2
# Points in a cell on average: enough that one of them lies on the nearest surface.
_IN_CELL = 8


def project_points(
    camera: Any, motion: Any, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Projects points of the world into a view, each by the pose of the line that sees it.

    Args:
        camera: of the view.
        motion: `View.motion`.
        points: (n, 3) in the scene's coordinates.

    Returns:
        Points (n, 3) in the camera's frame; pixels (n, 2), NaN if not visible; valid (n,) bool.
    """
    if not isinstance(motion, CameraMotion):
        in_camera = points @ motion[:3, :3].T + motion[:3, 3]
        return in_camera, *camera.project(in_camera)
    times = np.full(len(points), 0.5)
    for _ in range(_LINE_STEPS):
        poses = interpolate_poses(motion, times)
        in_camera = np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]
        pixels, valid = camera.project(in_camera)
        times = find_line_times(camera, motion, np.nan_to_num(pixels))
    return in_camera, pixels, valid


def interpolate_poses(motion: CameraMotion, times: np.ndarray) -> np.ndarray:
    """Returns camera_from_world (n, 4, 4) at times (n,) of the exposure, from 0 to 1."""
    steps = np.round(times * _TIMES).astype(np.int64)
    first = steps.min(initial=0)
    between = range(first, steps.max(initial=first) + 1)
    return np.array([motion.at(step / _TIMES) for step in between])[steps - first]


def find_line_times(camera: Any, motion: CameraMotion, pixels: np.ndarray) -> np.ndarray:
    """Returns the times (n,) of the exposure at which the lines of pixels (n, 2) are read."""
    lines = motion.shutter.line_times(camera.width, camera.height)
    along = pixels[:, 0 if "left" in motion.shutter.direction else 1]
    return np.interp(along - 0.5, np.arange(len(lines)), lines)


def find_visible_points(
    scene: Any, view: int, points: np.ndarray, in_cell: float = _IN_CELL
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns rows (n,), places (n, 2) as shares of the image size and distances, farthest first.

    Which points a view sees is not stored with them: a point well behind another in the same part
    of the image is left out.
    """
    camera, motion = scene.camera(view), scene.views[view].motion
    in_camera, pixels, valid = project_points(camera, motion, points)
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        valid = valid & np.all((pixels >= 0) & (pixels < size), axis=1)
    places = np.where(valid[:, None], pixels, 0.0)
    column, row = places.astype(np.int64).T
    valid &= scene.mask(view)[row, column]
    distances = np.linalg.norm(in_camera[valid] - camera.origins()[row, column][valid], axis=1)
    places = places[valid] / size
    cells = max(1, int(np.sqrt(len(places) / in_cell)))
    cell = np.floor(places * cells).astype(np.int64) @ np.array([1, cells])
    nearest = np.full(cells * cells, np.inf)
    np.minimum.at(nearest, cell, distances)
    seen = np.flatnonzero(distances <= _HIDES * nearest[cell])
    seen = seen[np.argsort(-distances[seen], kind="stable")]  # the nearest of a pixel comes last
    return np.flatnonzero(valid)[seen], places[seen], distances[seen]
