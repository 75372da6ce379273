"""Depth maps to coloured points of the world, one in each voxel."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.lens import measure_pixel_angle
from gsut.surface.depth_map import DepthMap
from gsut.surface.mesh import Mesh
from gsut.surface.rays import cast_world_rays

_MOST_VOXELS = 2**21  # to a side of a cloud: three such numbers fit 64 bits
_NO_FACES = np.zeros((0, 3), np.uint32)


class Cloud:
    """Points that are gathered view by view; of each voxel the first stays.

    Args:
        voxel: world units; None: a pixel's width at the first view's median depth.
    """

    def __init__(self, voxel: float | None = None) -> None:
        if voxel is not None and not 0 < voxel < np.inf:
            raise InputError(f"voxel is {voxel:g}; it must be positive")
        self.voxel = voxel
        self._corner = np.zeros(3)
        self._keys = np.zeros(0, np.int64)
        self._points: list[np.ndarray] = []
        self._colors: list[np.ndarray] = []

    def add(self, view: DepthMap) -> None:
        """Adds the points at a view's depths that are numbers."""
        origins, rays = cast_world_rays(view.camera, view.motion)
        there = np.isfinite(view.depth) & np.isfinite(rays[..., 0])
        if not there.any():
            return
        depth = view.depth[there].astype(np.float64)
        points = origins[there] + depth[:, None] * rays[there]
        if self.voxel is None:
            self.voxel = float(np.median(depth)) * measure_pixel_angle(view.camera)
        if not self._points:
            self._corner = points[0]
        cells = np.floor((points - self._corner) / self.voxel)
        inside = np.all(np.abs(cells) < _MOST_VOXELS / 2, axis=1)
        cells = cells[inside].astype(np.int64) + _MOST_VOXELS // 2
        keys = (cells[:, 0] * _MOST_VOXELS + cells[:, 1]) * _MOST_VOXELS + cells[:, 2]
        new, rows = np.unique(keys, return_index=True)
        fresh = ~np.isin(new, self._keys, assume_unique=True)
        rows = np.flatnonzero(inside)[np.sort(rows[fresh])]
        self._keys = np.union1d(self._keys, new)
        self._points.append(points[rows])
        if view.image is not None:
            self._colors.append(view.image[there][rows].astype(np.float32) / np.float32(255))

    def __len__(self) -> int:
        return len(self._keys)

    def to_mesh(self) -> Mesh:
        """Returns the points as a mesh without faces, with colours if all views had images.

        Raises:
            InputError: there are none.
        """
        if not len(self):
            raise InputError("no view has a depth: there are no points")
        colors = np.concatenate(self._colors) if len(self._colors) == len(self._points) else None
        return Mesh(np.concatenate(self._points), _NO_FACES, colors)


@name_wrong_kinds
def points_from_depth(maps: Iterable[DepthMap], voxel: float | None = None) -> Mesh:
    """Collects the points that depth maps of any lenses and shutters see, one in each voxel.

    Args:
        maps: distances along the rays, with images for colours.
        voxel: world units; None: a pixel's width at the first map's median depth.

    Returns:
        A mesh without faces, in the world of the maps' poses, for `save_mesh`.

    Raises:
        InputError: no map has a depth, or a voxel that is not positive.
    """
    cloud = Cloud(voxel)
    for view in maps:
        cloud.add(view)
    return cloud.to_mesh()
