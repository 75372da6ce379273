"""From Gaussians and the cameras that saw them to a mesh: depth of every view, filtered, fused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError
from gsut.bounds import check_number, name_wrong_kinds
from gsut.data import Scene
from gsut.data.poses import find_centers
from gsut.lens import measure_pixel_angle
from gsut.render import render, render_surface, to_uint8
from gsut.run import check_fits, free_memory
from gsut.sampling import ENOUGH_SAMPLES
from gsut.surface.depth_map import DepthMap, list_views
from gsut.surface.mesh import Mesh
from gsut.surface.rays import cast_onto
from gsut.surface.stereo import DepthRefiner
from gsut.surface.worth import build_tree

_NEIGHBOURS = 8  # views, nearest by place and direction, against which a depth map is checked
_AGREEMENT = 0.01  # largest difference of two views' depths, of the distance (PGSR)
_MOST_VOXELS = 1024  # along the scene's extent: finer ones need memory and show no more
_NOTHING = 0.05  # alpha of pixels whose rays meet nothing
_TRUNCATION = 4.0  # voxels on both sides of the surface that a depth says something about
_OPEN_RATIO = 5.0  # times the median depth, beyond which depths make a scene open
_EVEN_SHARE = 1.5  # of the median distance: how far voxels are even in an open scene
_MOST_BLOCKS = 1_000_000  # of 8 x 8 x 8 voxels: 2.3 GB
_BLOCK_BYTES = 2300  # of a block with its surface
_MAP_BYTES = 20  # of a pixel of a depth map
_REFINE_BYTES = 20  # more of one that is refined: normal, grey value, a second depth and weight
_NEAR = 0.05  # of the distance: where a mesh takes the place of a depth that it was made of
_LENS_BYTES = 25  # of a pixel of a lens
_SMALL_PART = 1e-3  # of the faces: connected parts below are left out
_BEHIND = 2.0  # voxels that a coloured point may lie behind a view's surface


# What each number may be, both ends allowed but for the 0 of lengths.
_RANGES = (
    ("voxel", 0, None), ("support", 0, _NEIGHBOURS), ("max_side", 1, None),
    ("holes", 0, None),
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class MeshOptions:
    """How a mesh is made.

    Attributes:
        voxel: world units; None: a pixel's width at the median depth, at least a 1024th of the
            scene.
        support: other views, of the 8 nearest, that must see a pixel's point at its depth.
        refine: moves each depth to where windows of the photographs correlate best, twice: the
            second time from the mesh that the moved depths give.
        max_side: of the depth maps, pixels: larger images are rendered at this size.
        photographs: colours from the photographs in place of the renders.
        holes: longest edge of the mesh that is closed, in faces along it; 0: none is.
        crop: (2, 3) corners of a box in the dataset's coordinates, outside of which nothing stays.
    """

    voxel: float | None = None
    support: int = 2
    refine: bool = False
    max_side: int = 1024
    photographs: bool = False
    holes: int = 0
    crop: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Raises InputError for a number out of its range."""
        for name, low, high in _RANGES:
            value, is_length = getattr(self, name), name == "voxel"
            if value is not None:
                check_number(value, name, low, high, whole=not is_length, above=is_length)


OnProgress = Callable[[str, int, int], None]


def ignore_progress(stage: str, done: int, total: int) -> None: ...


@name_wrong_kinds
def extract_mesh(
    gaussians: Any,
    scene: Scene,
    options: MeshOptions | None = None,
    *,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    progress: OnProgress = ignore_progress,
) -> Mesh:
    """Extracts the surface of trained Gaussians as a mesh, through the lenses that saw them.

    Each training view's depth is rendered, kept where neighbouring views agree, and fused into a
    truncated signed distance field whose voxels are projected with the lens itself.

    Args:
        gaussians: the Gaussians, in the dataset's coordinates.
        scene: the dataset, from `load_dataset`.
        options: None: the defaults.
        background: colour behind the Gaussians; None: see `render`.
        progress: called with (stage, done, total).

    Returns:
        The mesh, in the dataset's coordinates, with colours. The same bits on any number of
        threads. Memory: 20 bytes a pixel of all depth maps, 40 if they are refined, and 2.3 kB
        a block of 8 x 8 x 8 voxels near the surface.

    Raises:
        InputError: an option out of range, no view, or no surface.
    """
    maps = render_depth_maps(gaussians, scene, options, background=background, progress=progress)
    return fuse_depth(maps, options, progress=progress)


@name_wrong_kinds
def render_depth_maps(
    gaussians: Any,
    scene: Scene,
    options: MeshOptions | None = None,
    *,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    progress: OnProgress = ignore_progress,
) -> list[DepthMap]:
    """Renders the training views' depths through their own lenses.

    Args:
        gaussians: the Gaussians, in the dataset's coordinates.
        scene: the dataset, from `load_dataset`.
        options: its refine, max_side and photographs; None: the defaults.
        background: colour behind the Gaussians; None: see `render`.
        progress: called with (stage, done, total).

    Returns:
        One map a training view, with colours.

    Raises:
        InputError: memory does not suffice, or depths that are refined have no surface.
    """
    o = options or MeshOptions()
    rows = list(scene.train_indices) or list(range(len(scene.views)))
    lenses = {camera: _shrink_lens(camera, o.max_side) for camera in map(scene.camera, rows)}
    pixels = sum(c.width * c.height for c in (lenses[scene.camera(i)] for i in rows))
    each = _MAP_BYTES + (_REFINE_BYTES if o.refine else 0)
    size = each * pixels + _LENS_BYTES * sum(c.width * c.height for c in lenses.values())
    check_fits(f"the depth of {len(rows)} views", size, "make it smaller (--max-side)")
    maps: list[DepthMap] = []
    normals: list[np.ndarray] = []
    for done, index in enumerate(rows):
        progress("depth", done, len(rows))
        camera = lenses[scene.camera(index)]
        made, towards = _render_map(gaussians, scene, (index, camera), o, background)
        maps.append(made)
        if o.refine:
            normals.append(towards.astype(np.float16))
    progress("depth", len(rows), len(rows))
    if not o.refine:
        return maps
    return _refine_maps(scene, rows, maps, normals, o, progress)


def _refine_maps(
    scene: Any,
    rows: Sequence[int],
    maps: list[DepthMap],
    normals: list[np.ndarray],
    o: MeshOptions,
    progress: OnProgress,
) -> list[DepthMap]:
    """Moves depths to where photographs agree, and again from the mesh that they then give.

    The mesh's planes are smoother than rendered normals, so that more windows find a place.
    """
    refiner = DepthRefiner(scene, rows, maps)
    moved = refiner.move(maps, normals, lambda *done: progress("refining", *done))
    bare = [dataclasses.replace(m, image=None) for m in moved]
    simple = MeshOptions(o.voxel, o.support)
    mesh = fuse_depth(bare, simple, progress=progress)
    tree, towards = build_tree(mesh), mesh.compute_normals()
    for place, m in enumerate(moved):
        distances, faces = cast_onto(tree, m.camera, m.motion)
        with np.errstate(invalid="ignore"):
            near = np.abs(distances - m.depth) < _NEAR * m.depth
        start = np.where(near, distances, m.depth).astype(np.float32)
        maps[place] = dataclasses.replace(maps[place], depth=start)
        normals[place][near] = towards[mesh.faces[faces[near]]].sum(axis=1)
    del moved, bare
    return refiner.move(maps, normals, lambda *done: progress("refining again", *done))


@name_wrong_kinds
def fuse_depth(
    maps: Sequence[DepthMap],
    options: MeshOptions | None = None,
    *,
    progress: OnProgress = ignore_progress,
) -> Mesh:
    """Fuses depth maps of any lenses and shutters to a mesh, as `extract_mesh` does.

    Args:
        maps: distances along the rays.
        options: all but refine, max_side and photographs; None: the defaults.
        progress: called with (stage, done, total).

    Returns:
        The mesh, with colours if maps have images.

    Raises:
        InputError: an option out of range, no view, no surface, or one of more voxels than memory
            holds.
    """
    o = options or MeshOptions()
    maps = keep_agreeing(maps, o.support, progress)
    places, centers = _place_cameras(maps)
    center = centers.mean(axis=0)
    voxel, inner = _choose_voxel(maps, places, centers, center, o)
    views = list_views(maps, center)
    progress("fusing", 0, 1)
    free = free_memory()
    most = _MOST_BLOCKS if free is None else max(1, min(_MOST_BLOCKS, free // _BLOCK_BYTES))
    field = views.fuse(voxel, inner, _TRUNCATION, 0.1, most)
    vertices, faces = field.mesh()
    del field
    progress("fusing", 1, 1)
    mesh = Mesh(vertices, faces)
    if o.crop is not None:
        mesh = mesh.crop(*np.sort(np.asarray(o.crop, np.float64).reshape(2, 3), axis=0))
    mesh = mesh.without_small_parts(_SMALL_PART)
    if not len(mesh):
        inside = "" if o.crop is None else " inside the box of --crop"
        raise InputError(
            f"no surface was found{inside}: no two views agree on one; try --support 0, larger "
            "voxels, or look at the renders"
        )
    mesh = mesh.close_holes(o.holes) if o.holes else mesh
    if any(m.image is not None for m in maps):
        reach = _BEHIND * voxel
        colors = views.colors(mesh.vertices, reach)
        gray = np.float32(0.5)
        mesh = dataclasses.replace(mesh, colors=np.where(np.isnan(colors), gray, colors))
    return mesh


def _shrink_lens(camera: Any, most: int) -> Any:
    """Shrinks the lens to an image whose longer side has at most `most` pixels."""
    share = most / max(camera.width, camera.height)
    sides = (max(1, round(side * share)) for side in (camera.width, camera.height))
    return camera.resize(*sides) if share < 1 else camera


def _render_map(
    gaussians: Any,
    scene: Any,
    view: tuple[int, Any],
    o: MeshOptions,
    background: Sequence[float] | None,
) -> tuple[DepthMap, np.ndarray]:
    """Renders a view's map and normals, by its number and the lens of the map's size."""
    import cv2  # here, because gsut --help needs none

    index, camera = view
    motion, mask = scene.views[index].motion, scene.mask(index)
    size = (camera.width, camera.height)
    if mask.shape[::-1] != size:
        mask = cv2.resize(mask.astype(np.uint8), size, interpolation=0) > 0
    result = render(gaussians.order_by_centers(), camera, motion, background=background)
    surface = render_surface(result)
    depth = np.where(result.alpha < _NOTHING, np.inf, surface.median)
    depth = np.where(mask & camera.rays()[1], depth, np.nan).astype(np.float32)
    with np.errstate(invalid="ignore"):
        wide = surface.spread / (_AGREEMENT * depth)  # uncertain where a pixel's Gaussians disagree
        weight = np.nan_to_num(result.alpha / (1 + wide * wide)).astype(np.float32)
    weight[np.isinf(depth)] = 1
    image = to_uint8(result.image)
    if o.photographs:
        image = scene.image(index)
        if image.shape[:2] != depth.shape:
            image = cv2.resize(image, depth.shape[::-1], interpolation=cv2.INTER_AREA)
    made = DepthMap(camera, motion, depth, weight, np.ascontiguousarray(image))
    return made, surface.normals


def _find_middle(motion: np.ndarray | CameraMotion) -> np.ndarray:
    return motion.at(0.5) if isinstance(motion, CameraMotion) else np.asarray(motion)


def _place_cameras(maps: Sequence[DepthMap]) -> tuple[np.ndarray, np.ndarray]:
    """Returns poses (N, 4, 4) in the middle of the exposures, and camera centres (N, 3)."""
    places = np.stack([_find_middle(m.motion) for m in maps])
    return places, find_centers(places)


def keep_agreeing(
    maps: Sequence[DepthMap], support: int, progress: OnProgress = ignore_progress
) -> Sequence[DepthMap]:
    """Removes pixels that fewer than `support` of the neighbouring maps confirm.

    Raises:
        InputError: no map.
    """
    if not maps:
        raise InputError("a surface needs at least one view")
    if support <= 0 or len(maps) <= support:
        return maps
    places, centers = _place_cameras(maps)
    views = list_views(maps, centers.mean(axis=0))
    apart = np.linalg.norm(centers[:, None] - centers, axis=2)
    axes = places[:, 2, :3]
    turned = np.arccos(np.clip(axes @ axes.T, -1, 1))
    far = apart / max(float(np.median(apart)), 1e-12) + turned
    np.fill_diagonal(far, np.inf)
    kept = []
    for which, m in enumerate(maps):
        progress("agreement", which, len(maps))
        others = np.argsort(far[which], kind="stable")[: min(_NEIGHBOURS, len(maps) - 1)]
        confirmed = views.support(which, others.tolist(), _AGREEMENT) >= support
        depth = np.where(confirmed | np.isinf(m.depth), m.depth, np.float32(np.nan))
        kept.append(dataclasses.replace(m, depth=depth))
    progress("agreement", len(maps), len(maps))
    return kept


def _choose_voxel(
    maps: Sequence[DepthMap],
    places: np.ndarray,
    centers: np.ndarray,
    center: np.ndarray,
    o: MeshOptions,
) -> tuple[float, float]:
    """Chooses voxel and radius of even voxels, in world units."""
    each = max(1, ENOUGH_SAMPLES // len(maps))
    away, widths = [], []
    for m, place, at in zip(maps, places, centers, strict=True):
        rays = m.camera.rays()[0].reshape(-1, 3)
        depth = m.depth.reshape(-1)
        has = np.flatnonzero(np.isfinite(depth))
        has = has[:: max(1, len(has) // each)]
        away.append(at + depth[has, None] * (rays[has] @ place[:3, :3]) - center)
        widths.append(depth[has] * measure_pixel_angle(m.camera))
    points = np.concatenate(away)
    if not len(points):
        raise InputError("no view has a depth: nothing to make a mesh of; try --support 0")
    distance = np.linalg.norm(points, axis=1)
    middle, farthest = np.percentile(distance, (50, 99))
    is_open = farthest > _OPEN_RATIO * middle
    inner = _EVEN_SHARE * float(middle) if is_open else float("inf")
    if o.voxel is not None:
        if not o.voxel > 0:
            raise InputError(f"voxel is {o.voxel:g}; it must be positive")
        return float(o.voxel), inner
    low, high = np.percentile(points, (1, 99), axis=0)
    extent = 2 * inner if is_open else float((high - low).max())
    return max(float(np.median(np.concatenate(widths))), extent / _MOST_VOXELS), inner
