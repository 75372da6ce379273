"""A dataset in memory: cameras, views, points, and images that are decoded on demand."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import CameraMotion, InputError, Shutter
from gsut.data.errors import DatasetError
from gsut.data.images import decode_scaled, make_lens_mask, read_mask, shrink_both
from gsut.data.scene.depth_form import DISTANCES, DepthForm
from gsut.data.scene.lru_cache import LruCache
from gsut.lens import Camera

IMAGE_CACHE_BYTES = 1 << 30  # decoded pixels kept by one scene
_IN_WORLD = {"views", "points", "world_offset"}  # what a scene has in world coordinates
EXTENT_MARGIN = 1.1  # of 3DGS: the scene's extent over the cameras' radius


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One image of a dataset.

    Args:
        name: as in the dataset, often with a folder.
        image_path: the file.
        camera_index: into `Scene.cameras`.
        camera_from_world: (4, 4) float64, OpenCV axes, the dataset's world; with a rolling shutter
            the pose of the middle row.
        camera_from_world_start, camera_from_world_end: poses of the first and the last edge of a
            rolling shutter, or None.
        mask_path: image that is white where pixels are valid, or None.
        depth_path: as the dataset names it, not read here, or None.
        depth_form: how it is read.
        turns: quarter turns clockwise that show the image upright, by EXIF; its pixels, lens and
            pose are as stored.
        shutter: how the image was read out between the start and the end pose, or None.
        pixels: (H, W, 3) uint8 RGB of an image that is in memory, not in a file, else None.
        valid: (H, W) bool of it, True where pixels count, or None: all.
    """

    name: str
    image_path: Path
    camera_index: int
    camera_from_world: np.ndarray
    camera_from_world_start: np.ndarray | None = None
    camera_from_world_end: np.ndarray | None = None
    mask_path: Path | None = None
    depth_path: Path | None = None
    shutter: Shutter | None = None
    pixels: np.ndarray | None = None
    valid: np.ndarray | None = None
    turns: int = 0
    depth_form: DepthForm = DISTANCES

    def __post_init__(self) -> None:
        for name in ("camera_from_world", "camera_from_world_start", "camera_from_world_end"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _read_only(getattr(self, name), np.float64))

    def __repr__(self) -> str:
        at = ", ".join(f"{value:.3g}" for value in self.camera_center)
        readout = "" if self.shutter is None else f", rolling {self.shutter.direction}"
        return f"View({self.name!r}, camera {self.camera_index}, at ({at}){readout})"

    @property
    def motion(self) -> np.ndarray | CameraMotion:
        """The pose that `render` takes, or with a rolling shutter the motion between both."""
        start, end = self.camera_from_world_start, self.camera_from_world_end
        if self.shutter is None or start is None or end is None:
            return self.camera_from_world
        return CameraMotion(start, end, self.shutter)

    @property
    def camera_center(self) -> np.ndarray:
        """(3,) position of the camera in the world."""
        pose = self.camera_from_world
        return -pose[:3, :3].T @ pose[:3, 3]


def _read_only(values: np.typing.ArrayLike, dtype: np.typing.DTypeLike) -> np.ndarray:
    array = np.asarray(values, dtype).view()
    array.setflags(write=False)
    return array


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """Cameras, views, points and the split into training and test views; immutable.

    Its images are read on demand. The world is the dataset's. Training works in
    `centred`, the same scene about the mean of the camera centres, where float32 suffices.

    Args:
        path: the dataset.
        cameras: of Camera, at the scene's image scale.
        views: of View, sorted by name.
        points: (N, 3) float64, may be empty.
        point_colors: (N, 3) uint8.
        train_indices, test_indices: of int into `views`.
        world_offset: (3,) float64: dataset coordinates = this scene's + world_offset; zero but in
            a scene that was moved by `about`.
        notes: what was left out or changed on loading, one sentence each.
        file_cameras: the cameras at the size of the image files, if `cameras` are smaller.
        larger: the same scene at a larger size, whose images are shrunk in place of the files'.
        decodes_small: JPEG files are decoded at a part of their size: see `decode_scaled`.
        known_up: (3,) up in the world, as the dataset states it, or None.
        fixed: of each camera, (h, w) bool at any size, True where its pixels do not show the scene,
            or None; empty: none of them has any.

    Any sequences are taken and kept as tuples, arrays are read-only; `replace` makes another scene.
    """

    path: Path
    cameras: tuple[Camera, ...]
    views: tuple[View, ...]
    points: np.ndarray
    point_colors: np.ndarray
    train_indices: tuple[int, ...]
    test_indices: tuple[int, ...]
    world_offset: np.ndarray
    notes: tuple[str, ...] = ()
    file_cameras: tuple[Camera, ...] = ()
    larger: Scene | None = None
    decodes_small: bool = False
    known_up: np.ndarray | None = None
    fixed: tuple[np.ndarray | None, ...] = ()
    _images: LruCache = dataclasses.field(init=False)
    _masks: LruCache = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        values: dict[str, Any] = {
            "path": Path(self.path),
            "points": _read_only(np.reshape(self.points, (-1, 3)), np.float64),
            "point_colors": _read_only(np.reshape(self.point_colors, (-1, 3)), np.uint8),
            "world_offset": _read_only(self.world_offset, np.float64),
            "file_cameras": self.file_cameras or self.cameras,
            "_images": LruCache(IMAGE_CACHE_BYTES),
            "_masks": LruCache(IMAGE_CACHE_BYTES),
        }
        for name in ("cameras", "views", "train_indices", "test_indices", "notes", "file_cameras"):
            values[name] = tuple(values.get(name, getattr(self, name)))
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def replace(self, **changes: Any) -> Scene:
        """Returns the scene with other values of these attributes; decoded images are shared."""
        scene = dataclasses.replace(self, **changes)
        object.__setattr__(scene, "_images", self._images)
        if not changes.keys() & {"cameras", "file_cameras", "fixed"}:  # what a mask depends on
            object.__setattr__(scene, "_masks", self._masks)
        if not changes.keys() & _IN_WORLD:
            scene._keep_centred(self, lambda near: near.replace(**changes))
        return scene

    @functools.cached_property
    def centred(self) -> Scene:
        """The scene with the mean of its camera centres as origin; itself if it was moved."""
        if self.world_offset.any() or not self.views:
            return self
        return self.move_origin(np.mean([view.camera_center for view in self.views], axis=0))

    def move_origin(self, origin: np.typing.ArrayLike) -> Scene:
        """Returns the scene in coordinates whose zero lies at `origin` (3,) of the dataset's.

        `move_origin((0, 0, 0))` is in the dataset's coordinates.
        """
        origin = np.array(origin, np.float64)
        shift = origin - self.world_offset
        if not shift.any():
            return self
        names = ("camera_from_world", "camera_from_world_start", "camera_from_world_end")
        views = []
        for view in self.views:
            poses = ((name, getattr(view, name)) for name in names)
            near: Any = {name: _move_pose(pose, shift) for name, pose in poses if pose is not None}
            views.append(dataclasses.replace(view, **near))
        scene = self.replace(views=views, points=self.points - shift, world_offset=origin)
        if not origin.any():
            scene.__dict__["centred"] = self  # exactly this one, not a copy
        return scene

    def _keep_centred(self, old: Scene, change: Callable[[Scene], Scene]) -> None:
        """Takes over the centred scene that another one has made, changed likewise."""
        near = old.__dict__.get("centred")
        if near is not None and near is not old:
            self.__dict__["centred"] = change(near)

    def with_poses(self, indices: Sequence[int], camera_from_world: Iterable[np.ndarray]) -> Scene:
        """Returns the scene with other poses (n, 4, 4) of n views."""
        views = list(self.views)
        for index, pose in zip(indices, camera_from_world, strict=True):
            views[index] = dataclasses.replace(views[index], camera_from_world=np.array(pose))
        return self.replace(views=views)

    def with_lenses(self, file_cameras: Sequence[Camera]) -> Scene:
        """Returns the scene seen through other lenses.

        Args:
            file_cameras: one for each of this scene's `file_cameras`, of the same size.
        """
        cameras = [
            full if (full.width, full.height) == (c.width, c.height)
            else full.resize(c.width, c.height)
            for c, full in zip(self.cameras, file_cameras, strict=True)
        ]  # fmt: skip
        return self.replace(cameras=cameras, file_cameras=file_cameras)

    def scale_images(
        self, factor: float, *, keep_larger: bool = False, decodes_small: bool = False
    ) -> Scene:
        """Returns the scene with images of `factor` (0 to 1] times the size.

        Images are averaged over areas; intrinsics scale about the pixel corner.

        Args:
            factor: of the size.
            keep_larger: shrink this scene's own images and keep them, in place of the files'; for
                when both sizes are needed: each file is decoded once.
            decodes_small: see the attribute.
        """
        if not 0 < factor <= 1:
            raise InputError(f"scale must be above 0 and at most 1, found {factor}; use e.g. 0.5")
        cameras = [
            c.resize(max(1, int(c.width * factor + 0.5)), max(1, int(c.height * factor + 0.5)))
            for c in self.cameras
        ]
        # Images of other pixels: nothing that is decoded can be shared.
        scene = dataclasses.replace(
            self, cameras=tuple(cameras), larger=self if keep_larger else None,
            decodes_small=decodes_small or self.decodes_small,
        )  # fmt: skip
        how = {"keep_larger": keep_larger, "decodes_small": decodes_small}
        scene._keep_centred(self, lambda near: near.scale_images(factor, **how))
        return scene

    def __len__(self) -> int:
        return len(self.views)

    def __repr__(self) -> str:
        return (
            f"Scene({str(self.path)!r}: {len(self.train_indices)} training and"
            f" {len(self.test_indices)} test views, {len(self.cameras)} cameras,"
            f" {len(self.points)} points)"
        )

    def camera(self, index: int) -> Camera:
        """Returns the camera of view `index`."""
        return self.cameras[self.views[index].camera_index]

    def poses(self, indices: Sequence[int]) -> np.ndarray:
        """Returns camera_from_world (n, 4, 4) of views."""
        return np.array([self.views[i].camera_from_world for i in indices]).reshape(-1, 4, 4)

    def to_dataset(self, camera_from_world: np.ndarray) -> np.ndarray:
        """Returns a pose (4, 4) of the scene in the dataset's coordinates."""
        return _move_pose(camera_from_world, -self.world_offset)

    def from_dataset(self, camera_from_world: np.ndarray) -> np.ndarray:
        """Returns a pose (4, 4) of the dataset in the scene's coordinates."""
        return _move_pose(camera_from_world, self.world_offset)

    @functools.cached_property
    def extent(self) -> float:
        """The largest distance of a training camera from their centroid times 1.1, in world units.

        Where all cameras stand at one place: the points' root mean square distance from their
        centroid, else 1.
        """
        rows = self.train_indices or range(len(self.views))
        radius = _measure_radius(np.array([self.views[i].camera_center for i in rows]), np.max)
        if radius <= np.finfo(np.float32).eps * (1 + np.abs(self.points).max(initial=0)):
            radius = _measure_radius(self.points, lambda d: np.sqrt(np.mean(d**2)))
        return EXTENT_MARGIN * radius if radius > 0 else 1.0

    def image(self, index: int) -> np.ndarray:
        """Reads (H, W, 3) uint8 RGB of view `index` at the scene's scale; read-only, cached.

        Raises:
            DatasetError: the file is truncated, cannot be decoded or changed its size.
        """
        return self._read_pixels(self.views[index])[0]

    def alpha(self, index: int) -> np.ndarray | None:
        """Reads (H, W) bool, True where the image of view `index` is opaque; None: everywhere."""
        return self._read_pixels(self.views[index])[1]

    def mask(self, index: int) -> np.ndarray:
        """Makes (H, W) bool, True where view `index` can be compared; read-only, cached.

        The dataset's mask, full alpha, and pixels with a ray in the lens' domain. In a scaled
        scene a pixel is valid only if all source pixels are.
        """
        view = self.views[index]
        key = (view.image_path, view.mask_path, view.camera_index)
        return self._masks.get(key, lambda: (self._make_mask(view),))[0]

    def find_lens_mask(self, camera_index: int) -> np.ndarray:
        """Finds (H, W) bool, True where a camera sees the scene: pixels with a ray, not fixed."""
        sizes = self.cameras[camera_index], self.file_cameras[camera_index]
        fixed = self.fixed[camera_index] if self.fixed else None
        return self._masks.get(("lens", camera_index), lambda: (_mask_lens(*sizes, fixed),))[0]

    def check_pixels(self) -> None:
        """Decodes every image and mask once: raises the DatasetError of the first damaged one."""
        with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
            for _ in threads.map(self.mask, range(len(self.views))):  # which looks at the alpha
                pass

    def _read_pixels(self, view: View) -> tuple[np.ndarray, np.ndarray | None]:
        camera = self.cameras[view.camera_index]
        key = (view.image_path, camera.width, camera.height)
        return self._images.get(key, lambda: self._decode(view, camera))

    def _decode(self, view: View, camera: Camera) -> tuple[np.ndarray, np.ndarray | None]:
        if self.larger is not None:
            return shrink_both(*self.larger._read_pixels(view), camera.width, camera.height)
        if view.pixels is not None:
            return shrink_both(view.pixels, view.valid, camera.width, camera.height)
        full = self.file_cameras[view.camera_index]
        sizes = (full.width, full.height), (camera.width, camera.height)
        return decode_scaled(view.image_path, *sizes, in_parts=self.decodes_small)

    def _make_mask(self, view: View) -> np.ndarray:
        camera = self.cameras[view.camera_index]
        valid = self.find_lens_mask(view.camera_index)
        alpha = self._read_pixels(view)[1]
        if alpha is not None:
            valid = valid & alpha
        path = view.mask_path
        if path is not None:
            key = (path, camera.width, camera.height)
            full = self.file_cameras[view.camera_index]
            valid = valid & self._masks.get(
                key, lambda: (read_mask(path, full, camera.width, camera.height),)
            )[0]  # fmt: skip
        return _require_pixels(valid, view)


def _mask_lens(camera: Camera, full: Camera, fixed: np.ndarray | None) -> np.ndarray:
    """Makes (H, W) bool, True where a camera has rays and its pixels are not `fixed`."""
    valid = make_lens_mask(camera, full)
    if fixed is None:
        return valid
    sizes = zip(valid.shape, fixed.shape, strict=True)
    nearest = (np.arange(size) * of // size for size, of in sizes)
    return valid & ~fixed[np.ix_(*nearest)]


def keep_at_most(scene: Scene, size: float) -> None:
    """Sets the number of bytes of a scene's decoded images to keep, and of its masks."""
    scene._images.limit(size)
    scene._masks.limit(size)


def _require_pixels(valid: np.ndarray, view: View) -> np.ndarray:
    if not valid.any():
        raise DatasetError(
            view.mask_path or view.image_path,
            "the mask leaves no pixel that counts",
            "masks are white where the picture counts: is it inverted, or does this picture lie "
            "outside the lens' circle?",
        )
    return valid


def _move_pose(camera_from_world: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Returns the pose (4, 4) in coordinates whose zero lies at `origin` of its own."""
    pose = np.array(camera_from_world)
    pose[:3, 3] += pose[:3, :3] @ origin
    return pose


def _measure_radius(points: np.ndarray, reduce: Callable[[np.ndarray], float]) -> float:
    if len(points) == 0:
        return 0.0
    return float(reduce(np.linalg.norm(points - points.mean(axis=0), axis=1)))
