"""Where a page of a run's scene begins: at one of its photographs."""

from __future__ import annotations

from typing import Any

import numpy as np

_FOV_DEGREES = (45.0, 85.0)  # along a screen's longer side, whatever the photograph's lens
_SMALL = 64  # pixels a side of the picture that says how far the scene is


def start_view(scene: Any, gaussians: Any, origin: np.ndarray) -> Any:
    """Returns the first training view, upright, turning about its subject.

    Args:
        scene: the dataset.
        gaussians: of the run.
        origin: (3,) where the zero of the file's coordinates lies in the world.
    """
    import gsut
    from gsut.data.scene import find_up
    from gsut.formats import StartView

    rows = list(scene.train_indices or range(len(scene)))
    camera, pose = scene.camera(rows[0]), scene.views[rows[0]].camera_from_world
    scale = _SMALL / max(camera.width, camera.height)
    sides = [max(1, round(scale * side)) for side in (camera.width, camera.height)]
    seen = gsut.render(gaussians, camera.resize(*sides), pose)
    hit = seen.alpha > 0.5
    distance = np.median(seen.depth[hit] / seen.alpha[hit]) if hit.any() else scene.extent
    position = -pose[:3, :3].T @ pose[:3, 3] - origin
    size = np.array([camera.width, camera.height], np.float64)
    half = 0.499 * np.where(np.arange(2) == np.argmax(size), size, 0.0)  # of the longer side
    rays, valid = camera.unproject(np.stack([size / 2 - half, size / 2 + half]))
    fov = np.degrees(np.arccos(np.clip(rays[0] @ rays[1], -1, 1))) if valid.all() else np.inf
    target = position + float(distance) * pose[2, :3]
    return StartView(position, target, find_up(scene), float(np.clip(fov, *_FOV_DEGREES)))
