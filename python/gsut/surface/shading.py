"""A mesh seen through any lens: lit from the camera, so that shape is seen and not colour."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError
from gsut.surface.mesh import Mesh
from gsut.surface.rays import cast_world_rays
from gsut.surface.worth import build_tree

_SAMPLES = 2  # along each side of a pixel
_AMBIENT = 0.2  # of the light, from everywhere
_FRONT = np.array([0.86, 0.85, 0.83])  # colour of faces that look at the camera
_BACK = np.array([0.30, 0.36, 0.52])  # of their backs


def shade_mesh(mesh: Mesh, camera: Any, motion: np.ndarray | CameraMotion) -> np.ndarray:
    """Shades a mesh as (H, W, 3) uint8 RGB: grey in front, blue from behind, white: nothing.

    Args:
        mesh: with faces, in the coordinates that the camera moves in.
        camera: any lens.
        motion: (4, 4) camera_from_world, or a rolling shutter's.

    Raises:
        InputError: a mesh without faces.
    """
    import cv2

    if not len(mesh.faces):
        raise InputError("a picture is of a mesh with faces; this one has none")
    fine = camera.resize(_SAMPLES * camera.width, _SAMPLES * camera.height)
    origins, world = (np.ascontiguousarray(a.reshape(-1, 3)) for a in cast_world_rays(fine, motion))
    faces = build_tree(mesh).cast(origins, world)[1]
    met = np.flatnonzero(faces >= 0)
    corners = mesh.vertices[mesh.faces[faces[met]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    towards = -np.sum(normals * world[met], axis=1)
    picture = np.ones((len(world), 3))
    light = _AMBIENT + (1 - _AMBIENT) * np.abs(towards)[:, None]
    picture[met] = light * np.where(towards[:, None] > 0, _FRONT, _BACK)
    shown = picture.reshape(fine.height, fine.width, 3)
    small = cv2.resize(shown, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.round(255 * small).astype(np.uint8)
