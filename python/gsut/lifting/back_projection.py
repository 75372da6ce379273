"""Lifts what the pixels of many views say onto the Gaussians that they see, without training."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.lifting.lifted import Lifted
from gsut.render import Render, render
from gsut.run import check_fits

_MOST_CHANNELS = 512  # values of a pixel, or labels: more would be colours or distances by mistake


@name_wrong_kinds
def lift(
    gaussians: Any,
    scene: Any,
    maps: Mapping[str, np.ndarray],
    *,
    labels: bool = False,
    unknown: int | None = None,
    indices: Sequence[int] | None = None,
    on_view: Callable[[int, int], None] | None = None,
) -> Lifted:
    """Lifts maps of views onto Gaussians: each gets the mean of the pixels that see it.

    A pixel counts by the weight that the Gaussian has in it, which the render of the view gives:
    normalised back-projection. Nothing is trained; the same bits on any number of threads.

    Args:
        gaussians: in memory, in the scene's coordinates.
        scene: a dataset, from `load_dataset`.
        maps: by the views' names; views without one are left out. (H, W) or (H, W, D) numbers,
            any pixel with one that is not finite left out, or with `labels` (H, W) integers. Each
            has the size of the view's image in the scene or in its file; the view's mask holds.
        labels: the maps' numbers are names, of which a mean makes no sense: Gaussians get the share
            of each label, and pixels and Gaussians the label of most.
        unknown: a label that says nothing, as those below 0 do.
        indices: which of `scene.views`; None: the training views, or all where there are none.
        on_view: called with (views done, views in all).

    Returns:
        The lifted values; `Lifted.render` shows them from anywhere.

    Raises:
        InputError: no view has a map, or one has the wrong shape or kind, with the view's name.
    """
    if indices is None:
        indices = scene.train_indices or range(len(scene.views))
    sums: _Sums = _LabelSums(len(gaussians), unknown) if labels else _ValueSums(len(gaussians))
    drawn, used = gaussians.order_by_centers(), 0
    for done, index in enumerate(indices):
        if on_view is not None:
            on_view(done, len(indices))
        name = scene.views[index].name
        values = maps.get(name)
        if values is None:
            continue
        values = np.asarray(values)
        camera = choose_camera(scene, index, values)
        mask = resize_mask(scene.mask(index), camera.height, camera.width)
        try:
            sums.add(render(drawn, camera, scene.views[index].motion), values, mask)
        except InputError as error:
            raise InputError(f"the map of {name}: {error}") from None
        used += 1
    if on_view is not None:
        on_view(len(indices), len(indices))
    if not used:
        raise InputError(
            f"none of the {len(indices)} views has a map; maps are named like the views, such as "
            f"{scene.views[indices[0]].name}"
        )
    return sums.finish()


def choose_camera(scene: Any, index: int, values: np.ndarray) -> Any:
    """Chooses a view's camera at the size of its map: that of the scene or that of the file.

    Raises:
        InputError: the map has neither size.
    """
    number = scene.views[index].camera_index
    cameras = (scene.cameras[number], scene.file_cameras[number])
    for camera in cameras:
        if values.shape[:2] == (camera.height, camera.width):
            return camera
    sizes = " or ".join(dict.fromkeys(f"{camera.width} x {camera.height}" for camera in cameras))
    found = " x ".join(map(str, values.shape[1::-1] if values.ndim > 1 else values.shape))
    raise InputError(
        f"the map of {scene.views[index].name} is {found}, its image {sizes}; give maps at the "
        "size of the images"
    )


def resize_mask(mask: np.ndarray, height: int, width: int) -> np.ndarray:
    """Resizes a mask to another size of the same image: a pixel takes the one that it lies in."""
    if mask.shape == (height, width):
        return mask
    rows = (np.arange(height) + 0.5) * mask.shape[0] / height
    columns = (np.arange(width) + 0.5) * mask.shape[1] / width
    return mask[rows.astype(int)[:, None], columns.astype(int)]


class _Sums:
    """Sums over pixels of blend weight x value, a column a value, and of the weights."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._sums = np.zeros((count, 0), np.float32)
        self._weights = np.zeros((count, 1), np.float32)

    def add(self, drawn: Render, values: np.ndarray, mask: np.ndarray) -> None:
        """Adds a view's map, where `mask` is True."""
        raise NotImplementedError

    def finish(self) -> Lifted:
        """Divides the sums."""
        raise NotImplementedError

    def _widen(self, columns: int) -> None:
        check_fits(
            f"lifting {columns} values onto {self._count:,} Gaussians",
            2.0 * self._sums.itemsize * columns * self._count,
            "lift fewer at a time, or onto fewer Gaussians (gsut compact)",
        )
        added = np.zeros((self._count, columns - self._sums.shape[1]), np.float32)
        self._sums = np.concatenate([self._sums, added], axis=1)

    def _divide(self) -> np.ndarray:
        return np.divide(
            self._sums, self._weights, out=np.zeros_like(self._sums), where=self._weights > 0
        )


class _ValueSums(_Sums):
    """Sums of values."""

    def add(self, drawn: Render, values: np.ndarray, mask: np.ndarray) -> None:
        if values.ndim not in (2, 3) or values.dtype.kind not in "fiub":
            raise InputError(f"needs numbers (H, W) or (H, W, D), found {_describe(values)}")
        values = values.reshape(*values.shape[:2], -1).astype(np.float32)
        width = values.shape[2]
        if not 0 < width <= _MOST_CHANNELS:
            raise InputError(f"needs 1 to {_MOST_CHANNELS} values a pixel, found {width}")
        if self._sums.shape[1] == 0:
            self._widen(width)
        if width != self._sums.shape[1]:
            raise InputError(f"has {width} values a pixel, those before {self._sums.shape[1]}")
        valid = mask & np.isfinite(values).all(axis=2)
        drawn.add_map(np.where(valid[..., None], values, 0.0), self._sums)
        drawn.add_map(valid[..., None], self._weights)

    def finish(self) -> Lifted:
        return Lifted(self._divide(), self._weights[:, 0])


class _LabelSums(_Sums):
    """Sums of labels' weights, a column a label in the order of their first pixels."""

    def __init__(self, count: int, unknown: int | None) -> None:
        super().__init__(count)
        self._unknown = unknown
        self._columns: dict[int, int] = {}

    def add(self, drawn: Render, values: np.ndarray, mask: np.ndarray) -> None:
        if values.ndim != 2 or values.dtype.kind not in "iub":
            raise InputError(f"needs integers (H, W), found {_describe(values)}")
        valid = mask & (values >= 0)
        if self._unknown is not None:
            valid &= values != self._unknown
        here = np.unique(values[valid])
        for label in here.tolist():
            self._columns.setdefault(label, len(self._columns))
        if len(self._columns) > _MOST_CHANNELS:
            raise InputError(
                f"has labels beyond {_MOST_CHANNELS} different ones; are they distances or "
                "colours? Then lift them as values"
            )
        if len(self._columns) > self._sums.shape[1]:
            self._widen(len(self._columns))
        if len(here) == 0:
            return
        of_view = np.zeros((self._count, len(here)), np.float32)
        drawn.add_map((values[..., None] == here) & valid[..., None], of_view)
        self._sums[:, [self._columns[label] for label in here.tolist()]] += of_view
        self._weights += of_view.sum(axis=1, keepdims=True)

    def finish(self) -> Lifted:
        if not self._columns:
            raise InputError("no pixel of any map has a label")
        ids = np.array(list(self._columns), np.int64)
        if ids.max() > np.iinfo(np.int32).max:
            raise InputError(f"labels must lie below 2^31, found {ids.max()}")
        order = np.argsort(ids)
        return Lifted(
            np.ascontiguousarray(self._divide()[:, order]), self._weights[:, 0],
            ids[order].astype(np.int32),
        )  # fmt: skip


def _describe(values: np.ndarray) -> str:
    return f"{values.dtype} of shape {values.shape}"
