"""Reads normals that are known before training: the maps that a dataset's frames name."""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.data.scene import read_normals


class KnownNormals:
    """Holds the known normals of each view, at the size requested last."""

    def __init__(self) -> None:
        self._kept: dict[int, np.ndarray] = {}  # in the camera's frame

    def map(self, scene: Scene, view: int, directions: np.ndarray) -> np.ndarray | None:
        """Returns (H, W, 3) float32 in the world's axes, towards the camera, 0 if not known; None:
        no map.

        Args:
            scene: with the view's current pose.
            view: its number.
            directions: (H, W, 3) of the rays in the world, at any size.

        Raises:
            InputError: the file is missing, damaged or of another size than the image.
        """
        import cv2  # here, because gsut --help needs none

        kept, size = self._kept.get(view), directions.shape[1::-1]
        if kept is None or kept.shape[1::-1] != size:
            whole = read_normals(scene, view)
            if whole is None:
                return None
            kept = self._kept[view] = cv2.resize(whole, size, interpolation=cv2.INTER_NEAREST)
        in_world = kept @ scene.views[view].camera_from_world[:3, :3].astype(np.float32)
        away = np.einsum("hwi,hwi->hw", in_world, directions) > 0
        in_world[away] *= -1
        return in_world


def add_known_normals(
    known: np.ndarray, weight: float, image: np.ndarray, alpha: np.ndarray, dimage: np.ndarray,
    dalpha: np.ndarray,
) -> float:  # fmt: skip
    """Adds the gradients of the disagreement between rendered and known normals.

    The term is the sum of weight x (1 - normal . known normal), averaged over the known pixels.

    Args:
        known: (H, W, 3), see `KnownNormals.map`.
        weight: of the term.
        image: (H, W, 3), 0.5 + 0.5 (sum of weight x unit normal).
        alpha: (H, W).
        dimage, dalpha: gradients, to which those of the term are added.

    Returns:
        The term times its weight.
    """
    there = np.any(known != 0, axis=2)
    share = weight / max(1, int(there.sum()))
    agree = np.einsum("hwi,hwi->hw", 2.0 * image - 1.0, known)
    dimage -= np.float32(2.0 * share) * known
    dalpha += np.where(there, np.float32(share), np.float32(0.0))
    return float(share * np.sum((alpha - agree)[there], dtype=np.float64))
