"""Space as a dense grid: distances to the nearest surface, or what is occupied, free, unknown."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.files import write_file, write_npy
from gsut.surface.depth_map import DepthMap
from gsut.surface.extract import (
    MeshOptions,
    OnProgress,
    fuse_depth,
    ignore_progress,
    keep_agreeing,
    render_depth_maps,
)
from gsut.surface.mesh import Mesh
from gsut.surface.rays import cast_world_rays

OCCUPIED = 100  # as in a ROS OccupancyGrid
FREE = 0  # likewise
UNKNOWN = -1  # likewise
_SIDE = 128  # voxels along the longest side by default
_MOST = 2**27  # voxels: 512 MB of distances
_AROUND = 4  # voxels beyond what is seen, and behind surfaces, that are still known
_SEEN_PERCENT = (1.0, 99.0)  # percentiles of seen points that bound the scene
_SAMPLED = 1000  # points a view of those
_SLAB = 2**20  # voxels worked on together
# For a ray that meets nothing: far, and finite.
_FAR = np.float32(1e15)


@dataclasses.dataclass(frozen=True)
class Grid:
    """A dense grid of voxels along the axes of the dataset's coordinates.

    Attributes:
        distances: (X, Y, Z) float32, world units from a voxel's centre to the nearest surface:
            positive where a view saw that it is free, negative up to 4 voxels behind a surface, NaN
            where no view says anything.
        origin: (3,) float64, the centre of voxel [0, 0, 0].
        voxel: its side, world units.
    """

    distances: np.ndarray
    origin: np.ndarray
    voxel: float

    @property
    def occupancy(self) -> np.ndarray:
        """Returns (X, Y, Z) int8: 100 occupied, 0 free, -1 unknown, as in a ROS OccupancyGrid.

        Occupied: a surface lies within half a voxel's diagonal of its centre, so that none slips
        through; what lies behind it is unknown.
        """
        reach = math.sqrt(3) / 2 * self.voxel
        with np.errstate(invalid="ignore"):
            levels = np.where(self.distances > reach, FREE, UNKNOWN)
            return np.where(np.abs(self.distances) <= reach, OCCUPIED, levels).astype(np.int8)

    def __repr__(self) -> str:
        sides = " x ".join(str(side) for side in self.distances.shape)
        return f"Grid({sides} voxels of {self.voxel:.4g})"


def extract_grid(
    gaussians: Any,
    scene: Any,
    options: MeshOptions | None = None,
    *,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    progress: OnProgress = ignore_progress,
) -> Grid:
    """Extracts the space around trained Gaussians as a dense grid.

    Depths of the training views are rendered and checked as for `extract_mesh`. What lies in front
    of a depth is free; distances are those to the mesh that the depths make.

    Args:
        gaussians: the Gaussians, in the dataset's coordinates.
        scene: the dataset, from `load_dataset`.
        options: its voxel (None: a 128th of the longest side), crop (None: what views see, and the
            cameras), support, depth, max_side and parts; None: the defaults.
        background: colour behind the Gaussians; None: see `render`.
        progress: called with (stage, done, total).

    Returns:
        The grid, in the dataset's coordinates.

    Raises:
        InputError: an option out of range, no view, no surface, or more than 134 million voxels.
    """
    maps = render_depth_maps(gaussians, scene, options, background=background, progress=progress)
    return grid_from_depth(maps, options, progress=progress)


def grid_from_depth(
    maps: Sequence[DepthMap],
    options: MeshOptions | None = None,
    *,
    progress: OnProgress = ignore_progress,
) -> Grid:
    """Fuses the space that depth maps of any lenses and shutters see into a dense grid.

    Args:
        maps: distances along the rays.
        options: its voxel, crop, support and parts, as for `extract_grid`; None: the defaults.
        progress: called with (stage, done, total).

    Returns:
        The grid, in the world of the maps' poses.

    Raises:
        InputError: an option out of range, no view, no surface, or more than 134 million voxels.
    """
    o = options or MeshOptions()
    maps = keep_agreeing(maps, o.support, progress)
    low, high = (
        _bound_views(maps) if o.crop is None else np.sort(np.reshape(o.crop, (2, 3)), axis=0)
    )
    voxel = float((high - low).max()) / _SIDE if o.voxel is None else float(o.voxel)
    if not 0 < voxel < np.inf:
        raise InputError(f"voxel is {voxel:g}; it must be positive")
    if o.crop is None:
        low, high = low - _AROUND * voxel, high + _AROUND * voxel
    shape = np.maximum(np.ceil((high - low) / voxel), 1)
    if np.prod(shape) > _MOST:
        raise InputError(
            f"{' x '.join(f'{side:.0f}' for side in shape)} voxels are more than {_MOST:,}; give "
            "larger ones (--voxel) or a part of the scene (--crop)"
        )
    near = [_cut(each, low - _AROUND * voxel, high + _AROUND * voxel) for each in maps]
    alone = dataclasses.replace(o, voxel=voxel, support=0, open=False, crop=None, faces=None)
    mesh = fuse_depth(near, alone, progress=progress)
    shown = shape.astype(int)
    distances = _compute_distances(maps, mesh, low + voxel / 2, voxel, shown, progress)
    return Grid(distances.reshape(shown), low + voxel / 2, voxel)


def save_grid(path: str | os.PathLike[str], grid: Grid, *, occupancy: bool = False) -> None:
    """Writes a grid as FILE.npy, and what its numbers mean as FILE.json beside it.

    Args:
        path: FILE.npy.
        grid: what to write.
        occupancy: int8 of 100 (occupied), 0 (free) and -1 (unknown) in place of distances.

    Raises:
        InputError: another suffix.
        InputError, also an OSError: a file cannot be written.
    """
    path = Path(path)
    check_grid_name(path)
    values: dict[str, Any] = {"values": "distance to the nearest surface", "unknown": "NaN"}
    values["sign"] = "positive in free space, negative behind a surface"
    if occupancy:
        values = {"values": "occupancy", "occupied": OCCUPIED, "free": FREE, "unknown": UNKNOWN}
    values |= {
        "axes": ["x", "y", "z"],
        "shape": list(grid.distances.shape),
        "origin": [float(value) for value in grid.origin],
        "voxel": grid.voxel,
        "place": "values[i, j, k] is at origin + voxel * (i, j, k), in the dataset's coordinates",
    }
    write_file(path.with_suffix(".json"), json.dumps(values, indent=1) + "\n")
    write_npy(path, grid.occupancy if occupancy else grid.distances)


def check_grid_name(path: Path) -> None:
    """Raises InputError unless a grid can be written by this name."""
    if path.suffix.lower() != ".npy":
        raise InputError(f"{path}: grids are written as .npy")


def _bound_views(maps: Sequence[DepthMap]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds most of what the views see, and the views, by a box of two corners."""
    points, places = [], []
    for view in maps:
        origins, rays = cast_world_rays(view.camera, view.motion)
        rows = np.flatnonzero(np.isfinite(view.depth) & np.isfinite(rays[..., 0]))
        rows = rows[:: max(1, len(rows) // _SAMPLED)]
        depth = view.depth.reshape(-1, 1)[rows].astype(np.float64)
        points.append(origins.reshape(-1, 3)[rows] + depth * rays.reshape(-1, 3)[rows])
        places.append(np.nanmedian(origins.reshape(-1, 3), axis=0))
    seen = np.concatenate(points)
    if not len(seen):
        raise InputError("no view has a depth: nothing to make a grid of; try --support 0")
    low, high = np.percentile(seen, _SEEN_PERCENT, axis=0)
    return np.min([low, *places], axis=0), np.max([high, *places], axis=0)


def _cut(view: DepthMap, low: np.ndarray, high: np.ndarray) -> DepthMap:
    """Removes depths outside a box: there the map's rays meet nothing."""
    origins, rays = cast_world_rays(view.camera, view.motion)
    with np.errstate(invalid="ignore"):
        points = origins + view.depth[..., None] * rays
        outside = np.any((points < low) | (points > high), axis=-1)
    depth = np.where(outside, np.float32(np.inf), view.depth)
    return dataclasses.replace(view, depth=depth, image=None)


def _compute_distances(
    maps: Sequence[DepthMap],
    mesh: Mesh,
    origin: np.ndarray,
    voxel: float,
    shape: np.ndarray,
    progress: Callable[[str, int, int], None],
) -> np.ndarray:
    """Computes signed distances (X * Y * Z,) float32, NaN where nothing is known."""
    middle = origin + voxel * (shape - 1) / 2
    views = _core.DepthViews(list(middle))
    for view in maps:
        depth = np.where(np.isinf(view.depth), _FAR, view.depth)
        views.add(view.camera, view.motion, depth, None, np.zeros((*depth.shape, 3), np.uint8))
    tree = _core.TriangleTree(mesh.vertices - middle, mesh.faces)
    normals = mesh.compute_face_vectors()
    corners = mesh.vertices[mesh.faces[:, 0]]
    total = int(np.prod(shape))
    found = np.empty(total, np.float32)
    for begin in range(0, total, _SLAB):
        progress("grid", begin, total)
        rows = np.arange(begin, min(begin + _SLAB, total))
        points = origin + voxel * np.stack(np.unravel_index(rows, shape), axis=1)
        distance, face = tree.nearest(points - middle)
        behind = np.einsum("ij,ij->i", points - corners[face], normals[face]) < 0
        free = ~np.isnan(views.colors(points, 0.0)[:, 0])
        beside = distance <= voxel  # there the mesh says the side, elsewhere the rays
        inside = behind & (beside | (~free & (distance <= _AROUND * voxel)))
        outside = ~inside & (free | beside)
        found[rows] = np.where(inside, -distance, np.where(outside, distance, np.nan))
    progress("grid", total, total)
    return found
