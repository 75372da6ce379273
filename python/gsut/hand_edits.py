"""Repeats edits made by hand: regions of pictures select Gaussians, which are deleted or kept."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.data.poses import check_rigid
from gsut.files import Number, check_shape, read_json, register_reader
from gsut.gaussians import OPAQUE, Gaussians
from gsut.lens import Camera
from gsut.lens.files import camera_from_values
from gsut.render import render

# What an edit can do.
_ACTIONS = ("select", "clear", "delete", "keep")
# Of an edit that selects.
_REGION = {
    "camera_from_world": list, "lens": dict, "points": Number(shape=(None, 2)),
    "radius?": Number(least=0.0), "subtract?": bool, "front?": bool,
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Edited:
    """What edits have left of N Gaussians, and what is selected now.

    Attributes:
        kept, selected: (N,) bool; what is selected is also kept.
    """

    kept: np.ndarray
    selected: np.ndarray


@name_wrong_kinds
def read_edits(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Reads the edits that the viewer saves.

    The file is an object whose "edits" are done one after another. Each has "do":

    - "select" adds the Gaussians whose centres lie in a region of a picture, or takes them from
      the selection if "subtract" is true. The picture is one of "lens" (a lens file's content) at
      "camera_from_world" (4 x 4, the dataset's coordinates). The region is the polygon of "points"
      in its pixels or, with "radius", all within this distance of the line along them. If "front"
      is true, a Gaussian must not be behind the surface: the distance to its centre is at most the
      expected distance that its pixel shows, plus its own largest standard deviation.
    - "clear" empties the selection, "delete" removes what is selected, and "keep" all the rest.

    No Gaussian is named, so the file also fits another training of the same dataset and poses,
    where it selects what lies in the same places. It does not fit poses found anew or a scene that
    was turned or scaled.

    Args:
        path: the file, JSON.

    Returns:
        The edits, for `apply_edits`.

    Raises:
        InputError: the file cannot be read; the message says why.
    """
    return list(_read_content(path)["edits"])


@register_reader("edits made in the viewer", ".json")
def _read_content(path: str | os.PathLike[str]) -> Any:
    content = read_json(path, {"edits": [{"do": frozenset(_ACTIONS)}]})
    for edit in content["edits"]:
        check_edit(edit, path)
    return content


def check_edit(edit: Mapping[str, Any], where: object) -> None:
    """Checks an edit's values.

    Raises:
        InputError: one is missing or impossible; the message names `where`.
    """
    try:
        check_shape(edit, {"do": frozenset(_ACTIONS)}, "an edit")
        if edit["do"] == "select":
            check_shape(edit, _REGION, "an edit")
    except TypeError as error:
        raise InputError(f"{where}: {error}; save the edits in the viewer again") from None
    if edit["do"] == "select":
        check_rigid(edit["camera_from_world"], where)
        camera_from_values(edit["lens"], str(where))


@name_wrong_kinds
def apply_edits(gaussians: Gaussians, edits: Iterable[Mapping[str, Any]]) -> np.ndarray:
    """Repeats edits that were made by hand.

    Args:
        gaussians: N Gaussians in the dataset's coordinates.
        edits: done one after another, as `read_edits` returns them.

    Returns:
        (N,) bool, which Gaussians are left.

    Raises:
        InputError: an edit is impossible.
    """
    edited = start_edits(gaussians)
    for edit in edits:
        check_edit(edit, "edits")
        edited = apply_edit(gaussians, edited, edit)
    return edited.kept


def start_edits(gaussians: Gaussians) -> Edited:
    """Returns the state before the first edit: all are kept, none is selected."""
    return Edited(np.ones(len(gaussians), bool), np.zeros(len(gaussians), bool))


def apply_edit(gaussians: Gaussians, before: Edited, edit: Mapping[str, Any]) -> Edited:
    """Applies one checked edit.

    Args:
        gaussians: N Gaussians in the dataset's coordinates.
        before: of the edits so far.
        edit: see `read_edits`.
    """
    kept, selected = before.kept, before.selected
    none = np.zeros(len(kept), bool)
    if edit["do"] == "delete":
        return Edited(kept & ~selected, none)
    if edit["do"] == "keep":
        return Edited(selected if selected.any() else kept, none)
    if edit["do"] == "clear":
        return Edited(kept, none)
    found = kept & _find_in_region(gaussians, kept, edit)
    return Edited(kept, selected & ~found if edit.get("subtract") else selected | found)


def _find_in_region(gaussians: Gaussians, kept: np.ndarray, edit: Mapping[str, Any]) -> np.ndarray:
    """Finds (N,) bool whose centres lie in the region of an edit."""
    camera = camera_from_values(edit["lens"])
    pose = check_rigid(edit["camera_from_world"], "camera_from_world")
    points = np.array(edit["points"], np.float64).reshape(-1, 2)
    places = (gaussians.means + gaussians.origin) @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(places)
    size, radius = (camera.width, camera.height), edit.get("radius")
    found = valid & kept
    if not len(points):
        return found & False
    low = np.maximum(points.min(axis=0) - (radius or 0), 0)
    high = np.minimum(points.max(axis=0) + (radius or 0), size)
    with np.errstate(invalid="ignore"):
        found &= np.all((pixels >= low) & (pixels <= high), axis=1)
    rows = np.flatnonzero(found)
    inside = (
        _is_in_polygon(pixels[rows], points)
        if radius is None
        else _is_near_line(pixels[rows], points, radius)
    )
    rows = rows[inside]
    if edit.get("front") and len(rows):
        rows = rows[_is_in_front(gaussians, kept, camera, pose, rows, places[rows], pixels[rows])]
    found[:] = False
    found[rows] = True
    return found


def _is_in_polygon(pixels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns which pixels (n, 2) a closed polygon surrounds an odd number of times."""
    x, y = pixels.T
    inside = np.zeros(len(pixels), bool)
    for (ax, ay), (bx, by) in zip(points, np.roll(points, -1, axis=0), strict=True):
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    return inside


def _is_near_line(pixels: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Returns which pixels (n, 2) lie within `radius` of the line along points."""
    near = np.zeros(len(pixels), bool)
    for a, b in zip(points, [*points[1:], points[-1]], strict=True):
        way, off = b - a, pixels - a
        square = float(way @ way)
        along = np.clip(off @ way / square, 0, 1) if square > 0 else np.zeros(len(pixels))
        near |= np.sum((off - along[:, None] * way) ** 2, axis=1) <= radius * radius
    return near


def _is_in_front(
    gaussians: Gaussians, kept: np.ndarray, camera: Camera, pose: np.ndarray, rows: np.ndarray,
    places: np.ndarray, pixels: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Returns which of the Gaussians `rows` are not behind the surface that their pixels show."""
    seen = render(gaussians[kept], camera, pose)
    x, y = np.minimum(pixels.astype(np.int64), np.array([camera.width, camera.height]) - 1).T
    alpha, depth = seen.alpha[y, x], seen.depth[y, x]
    reach = np.exp(gaussians.log_scales[rows].max(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        farthest = np.where(alpha > OPAQUE, depth / alpha, np.inf) + reach
    return np.linalg.norm(places, axis=1) <= farthest
