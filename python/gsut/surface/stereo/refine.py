"""Moves rendered depths to where windows of the photographs correlate best.

Gaussians reproduce photographs with depths that are off by a third of a pixel of parallax and
jump from pixel to pixel. Windows of 7 x 7 pixels on the planes of rendered distance and normal say
more: compared with neighbouring photographs by normalised correlation, which ignores exposure.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut.data import Scene
from gsut.surface.depth_map import DepthMap, list_views
from gsut.surface.stereo.neighbours import MIDDLE, choose_neighbours
from gsut.surface.stereo.photograph import Photograph

# Neighbours of a view: more cost time and gain nothing.
_NEIGHBOURS = 3
# Times the weight of a depth that no windows confirm.
_UNSURE = 0.25
# Pixels from the middle of a window to its sides.
_HALF = 3
# Of an inverse distance: how much it may bend over a window on one surface.
_BEND = 0.05


class DepthRefiner:
    """Photographs of views and their neighbours, by which depths are moved.

    Args:
        scene: the dataset.
        rows: indices of the views.
        maps: their depths, about.
    """

    def __init__(self, scene: Scene, rows: Sequence[int], maps: Sequence[DepthMap]) -> None:
        scene = scene.replace(train_indices=list(rows), test_indices=[])
        found = [_look_around(scene, row, m) for row, m in zip(rows, maps, strict=True)]
        places = {row: place for place, row in enumerate(rows)}
        self._greys = [grey for grey, _ in found]
        self._beside = [[places[row] for row in near[:_NEIGHBOURS]] for _, near in found]
        self._center = np.mean([scene.views[row].camera_center for row in rows], axis=0)

    def move(
        self,
        maps: Sequence[DepthMap],
        normals: Sequence[np.ndarray],
        on_view: Callable[[int, int], None],
    ) -> list[DepthMap]:
        """Moves depths along rays to where the photographs agree; see RefineDepth in the core.

        Args:
            maps: of the views.
            normals: (H, W, 3) of the surfaces, in the world's axes, of any length.
            on_view: called with the number of views done and of all.

        Returns:
            The maps: depths whose windows hold an edge stay; those without a clear best distance
            stay, too, with a quarter of their weight.
        """
        views = list_views(maps, self._center)
        refined = []
        for place, m in enumerate(maps):
            on_view(place, len(maps))
            towards = normals[place].astype(np.float32)
            edges = _find_edges(m.depth)
            start = np.where(edges, np.float32(np.nan), m.depth)
            depth, moved = views.refine(place, self._beside[place], self._greys, towards, start)
            depth = np.where(edges, m.depth, depth)
            sure = (moved > 0) | edges | np.isinf(depth)
            weight = np.ones_like(depth) if m.weight is None else m.weight
            weight = np.where(sure, weight, np.float32(_UNSURE) * weight)
            refined.append(dataclasses.replace(m, depth=depth, weight=weight))
        on_view(len(maps), len(maps))
        return refined


def _find_edges(depth: np.ndarray) -> np.ndarray:
    """Finds the pixels (H, W) whose windows hold more than one surface, so that no plane fits."""
    edges = np.zeros(depth.shape, bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        near = 1 / depth
    for each, found in ((near, edges), (near.T, edges.T)):
        middle = each[_HALF:-_HALF]
        bend = np.abs(each[: -2 * _HALF] + each[2 * _HALF :] - 2 * middle)
        found[_HALF:-_HALF] |= bend > _BEND * middle
    return edges


def _look_around(scene: Scene, row: int, m: DepthMap) -> tuple[np.ndarray, list[int]]:
    """Returns a photograph's grey values at its map's size, NaN where masked, and neighbours."""
    import cv2  # here, because gsut --help needs none

    photograph = Photograph(scene, row)
    grey, mask, size = photograph.grey, photograph.mask, m.depth.shape[::-1]
    if mask.shape != m.depth.shape:
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
    known = m.depth[np.isfinite(m.depth)]
    beside = []
    if len(known):
        distances = np.percentile(known, MIDDLE).tolist()
        beside = choose_neighbours(scene, row, photograph, distances)
    return np.where(mask, grey, np.float32(np.nan)), beside
