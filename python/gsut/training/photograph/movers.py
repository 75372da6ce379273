"""Finds what moved while photographs were taken: where one contradicts all others.

A surface that a view shows is looked up in training photographs that see it, too. Where these agree
with each other and not with the view's own photograph, something stood before the surface that was
not there in the others. What shines, or is badly reconstructed, differs among all photographs and
does not count. The Gaussians must not show the mover themselves, as they do after many steps: ask
early, or after a training that left movers out.

Somebody who stays in the middle of the pictures hides the same surface in many of them, so that
the others agree about a part of them only. What is connected with that part, and is not what the
Gaussians show, belongs to them too.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut.gaussians import OPAQUE
from gsut.render import Light, render

# Longest side in pixels at which photographs are compared: enough for what spoils a picture.
_SIDE = 128
# Photographs that a pixel is compared with: the nearest that see its surface, at most and at least.
_MOST_OTHERS = 8
_FEWEST_OTHERS = 4
# Photographs that are looked at for them, the nearest first.
_NEAREST = 20
# Relative difference of distances below which two photographs show the same surface; distances are
# rough early in a training.
_SAME_DEPTH = 0.1
# Colour difference, of full scale, from which a photograph contradicts the others, beyond what a
# pixel's neighbours show; these must agree among themselves to half of it.
_DIFFERENT = 0.06
# The same as a multiple of the spread of the others.
_SPREADS = 3.0
# Ratio of brightness that shade and exposure may explain.
_SHADE = 1.6
# Side in pixels of the window in which more than half must differ: single pixels are no mover.
_WINDOW = 5
# Share of the compared pixels of a connected misfit that must contradict the others: of what is
# badly reconstructed a tenth do, of people a third or more.
_CONTRADICTS = 0.25
# Pixels from which something moved in a view in which the first comparison found nothing: fewer
# photographs are left for the second one.
_LEAST_NEW = 2 * _WINDOW**2


@dataclasses.dataclass(frozen=True)
class _Look:
    """What a photograph shows, and how far away it is.

    Attributes:
        colors: (H, W, 9): the photograph's colour in [0, 1], its light divided out, and the lowest
            and the highest of each pixel's neighbours.
        distances: (H, W), infinite where nothing is and outside the mask.
        misfit: (H, W), by how much the photograph differs from all that the Gaussians show within a
            pixel.
        camera, pose: through which it is seen. mask: (H, W) bool, True where pixels count.
    """

    colors: np.ndarray
    distances: np.ndarray
    misfit: np.ndarray
    camera: Any
    pose: np.ndarray
    mask: np.ndarray

    def hide(self, moved: np.ndarray | None) -> _Look:
        """Returns what is seen beside what moved, (H, W) bool; None: nothing did."""
        if moved is None:
            return self
        distances = np.where(moved, np.float32(np.inf), self.distances)
        return dataclasses.replace(self, distances=distances)

    @property
    def center(self) -> np.ndarray:
        """(3,) of the camera, in the world."""
        return -self.pose[:3, :3].T @ self.pose[:3, 3]


@dataclasses.dataclass(frozen=True)
class Movers:
    """What moved while photographs were taken.

    Args:
        masks: view -> (h, w) bool at a small size, True where something moved; views in which
            nothing did are absent.
    """

    masks: Mapping[int, np.ndarray] = dataclasses.field(default_factory=dict)

    @classmethod
    def find(
        cls,
        gaussians: Any,
        scene: Any,
        indices: Sequence[int],
        light: Light | None = None,
    ) -> Movers:
        """Finds what moved in some photographs.

        Args:
            gaussians: of a scene that does not show the movers.
            scene: with training views, which views are compared with.
            indices: of the views, training views or others.
            light: of the photographs; None: 1.
        """
        side = max(max(camera.width, camera.height) for camera in scene.cameras)
        small = scene.scale_images(min(1.0, _SIDE / side), keep_larger=True)
        looks = dict[int, _Look]()

        def look_at(index: int) -> _Look:
            if index not in looks:
                looks[index] = _look(gaussians, small, index, light)
            return looks[index]

        train = np.array(small.train_indices, np.int64)
        centers = np.array([view.camera_center for view in small.views])

        def list_looks(index: int) -> list[_Look]:
            """Lists what the view shows, and what the nearest training views show."""
            away = np.linalg.norm(centers[train] - centers[index], axis=1)
            nearest = [int(i) for i in train[np.argsort(away, kind="stable")] if i != index]
            others = [look_at(each).hide(moved.get(each)) for each in nearest[:_NEAREST]]
            return [look_at(index), *others]

        def compare_all(views: Sequence[int]) -> dict[int, np.ndarray]:
            tasks = [threads.submit(_compare, *list_looks(index)) for index in views]
            found = zip(views, (task.result() for task in tasks), strict=True)
            return {index: mask for index, mask in found if mask.any()}

        moved = dict[int, np.ndarray]()
        with concurrent.futures.ThreadPoolExecutor(_core.num_threads(), "gsut-movers") as threads:
            found = compare_all(indices)
            if found:  # once more, without what the others show of the movers
                moved = compare_all(train.tolist()) if set(indices) - set(train) else found
                again = compare_all(indices)
                found |= {
                    index: found[index] | mask if index in found else mask
                    for index, mask in again.items()
                    if index in found or np.count_nonzero(mask) > _LEAST_NEW
                }
        return cls(found)

    def scale_mask(self, view: int, width: int, height: int) -> np.ndarray | None:
        """Returns a view's mask (height, width), or None where nothing moved."""
        import cv2

        mask, size = self.masks.get(view), (width, height)
        if mask is None:
            return None
        return cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0

    def measure_share(self, views: int) -> float:
        """Measures the share of the pixels of that number of views that movers take."""
        return sum(float(mask.mean()) for mask in self.masks.values()) / max(1, views)


def _look(gaussians: Any, scene: Any, index: int, light: Light | None) -> _Look:
    import cv2

    camera, view, mask = scene.camera(index), scene.views[index], scene.mask(index)
    drawn = render(gaussians, camera, view.motion, sh_degree=0, watch=False)
    image = scene.image(index).astype(np.float32) / np.float32(255)
    if light is not None:
        image = image / light.on(camera, index, view.camera_index)
    alpha, around = np.asarray(drawn.alpha), np.ones((3, 3), np.uint8)
    is_near = (alpha >= OPAQUE) & mask
    distances = np.where(is_near, drawn.depth / np.maximum(alpha, OPAQUE), np.float32(np.inf))
    colors = np.concatenate([image, cv2.erode(image, around), cv2.dilate(image, around)], axis=2)
    misfit = _measure_misfit(image, cv2.erode(drawn.image, around), cv2.dilate(drawn.image, around))
    misfit = np.where(mask, misfit, np.float32(0))
    return _Look(colors, distances, misfit, camera, view.camera_from_world, mask)


def _compare(own: _Look, *others: _Look) -> np.ndarray:
    """Finds (H, W) where a photograph contradicts others that agree."""
    import cv2

    rays, valid = own.camera.rays()
    rows, columns = np.nonzero(np.isfinite(own.distances) & valid)
    directions = rays[rows, columns] @ own.pose[:3, :3]
    points = own.center + directions * own.distances[rows, columns][:, None]
    views = [(each.camera, each.pose, each.distances, each.colors) for each in others]
    medians, spread, count = _core.compare_shown(
        points, views, _SAME_DEPTH, _MOST_OTHERS, _FEWEST_OTHERS
    )
    enough = count >= _FEWEST_OTHERS
    different = np.zeros(own.mask.shape, np.float32)
    if not enough.any():
        return different > 0
    rows, columns, spread = rows[enough], columns[enough], spread[enough]
    middle, low, high = np.split(medians[enough], 3, axis=1)
    mine = own.colors[rows, columns, :3]
    shade = _average_channels(mine) / np.maximum(_average_channels(middle), 1 / 255)
    shade = np.clip(shade, 1 / _SHADE, _SHADE)[:, None]
    off = _measure_misfit(mine, low * shade, high * shade)
    is_plain = spread < 0.5 * _DIFFERENT
    contradicts = off > np.maximum(_DIFFERENT, _SPREADS * spread)
    different[rows, columns] = is_plain & contradicts
    weights = np.zeros_like(different)  # of growth by it
    weights[rows, columns] = is_plain * (contradicts - np.float32(_CONTRADICTS))
    size = (_WINDOW, _WINDOW)
    dense = cv2.boxFilter(different, -1, size) > 0.5
    found = cv2.dilate(dense.astype(np.uint8), np.ones(size, np.uint8)) > 0
    return (found | _grow(found, own, weights)) & own.mask & valid


def _grow(found: np.ndarray, own: _Look, weights: np.ndarray) -> np.ndarray:
    """Finds (H, W) of the misfit that is connected with what was found to have moved, where
    `weights` (H, W) have a positive sum.
    """
    import cv2

    if not found.any():
        return found
    least = max(_DIFFERENT, _SPREADS * float(np.median(own.misfit[own.mask])))
    size = (_WINDOW, _WINDOW)
    dense = cv2.boxFilter((own.misfit > least).astype(np.float32), -1, size) > 0.5
    labels = cv2.connectedComponents(dense.astype(np.uint8), connectivity=4)[1]
    counts = np.bincount(labels.ravel(), weights.ravel()) > 0
    grown = np.isin(labels, np.unique(labels[found & dense])) & counts[labels]
    return cv2.dilate((grown & dense).astype(np.uint8), np.ones(size, np.uint8)) > 0


def _measure_misfit(colors: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Measures by how much colours (..., 3) lie outside a range, as a mean over the channels."""
    return _average_channels(np.maximum(np.maximum(low - colors, colors - high), 0))


def _average_channels(colors: np.ndarray) -> np.ndarray:
    """Averages the last axis, three channels, faster than `numpy.mean` does such short ones."""
    red, green, blue = np.moveaxis(colors, -1, 0)
    return (red + green + blue) / np.float32(3)
