"""Cuts a scene into blocks by bisection; far things are a block of their own."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import read_json, register_reader
from gsut.run.options import MOST_BLOCKS

# Distance from the cameras' box, x its diagonal, beyond which things are far.
_FAR = 2.0
# Least work of far things, x the mean of the blocks, for a block of their own.
_FAR_WORTH = 0.5


@dataclasses.dataclass(frozen=True)
class Layout:
    """A partition of space: every point lies in exactly one block.

    Attributes:
        tree: {"axis": 0 to 2, "at": coordinate, "below": tree, "above": tree}, where a point at the
            coordinate is above; or None: one block. Blocks are numbered by the leaves, below first.
        near: (low, high) corners beyond which everything is the last block; None: no such block.

    Coordinates are the dataset's, so that a file is valid for every run on it.
    """

    tree: dict[str, Any] | None
    near: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def __len__(self) -> int:
        return _count_leaves(self.tree) + (self.near is not None)

    def find_owners(self, points: np.ndarray) -> np.ndarray:
        """Returns the block (N,) of each point (N, 3), float64 in the dataset's coordinates."""
        out = np.zeros(len(points), np.int32)
        _number_points(self.tree, points, np.arange(len(points)), 0, out)
        if self.near is not None:
            low, high = (np.array(corner) for corner in self.near)
            out[~((points >= low) & (points <= high)).all(axis=1)] = len(self) - 1
        return out

    def as_dict(self) -> dict[str, Any]:
        """Returns a dict for JSON, which `from_dict` reads."""
        return {"tree": self.tree, "near": None if self.near is None else list(self.near)}

    @classmethod
    def from_dict(cls, values: Any, source: str) -> Layout:
        """Makes a layout of the result of `as_dict`, or of what somebody wrote by hand.

        Raises:
            InputError: names what is wrong in the file `source`.
        """
        if not isinstance(values, dict) or "tree" not in values:
            raise InputError(
                f'{source}: a layout is {{"tree": {{"axis": 0, "at": 1.5, "below": null, "above": '
                'null}}, with "near": [[low], [high]] if far things are a block of their own'
            )
        _check_tree(values["tree"], source, "tree")
        near = values.get("near")
        if near is not None:
            corners = np.array(near, float) if _are_numbers(near) else np.zeros(0)
            if corners.shape != (2, 3) or not (corners[0] < corners[1]).all():
                raise InputError(f'{source}: "near" is two corners, the lower one first: {near!r}')
            near = (tuple(corners[0].tolist()), tuple(corners[1].tolist()))
        layout = cls(values["tree"], near)
        if len(layout) > MOST_BLOCKS:
            raise InputError(f"{source}: {len(layout)} blocks, more than {MOST_BLOCKS}")
        return layout

    @classmethod
    @register_reader("layout of blocks", ".json")
    def read(cls, path: str) -> Layout:
        """Reads a layout from a JSON file.

        Raises:
            InputError: it cannot be read or understood.
        """
        return cls.from_dict(read_json(path, advice="correct it"), path)


def cut_scene(points: np.ndarray, work: np.ndarray, centers: np.ndarray, count: int) -> Layout:
    """Cuts a scene into blocks of equal work.

    Each box is cut across the axis along which its work spreads furthest, so that both sides have
    work in proportion to their numbers of blocks.

    Args:
        points: (N, 3) Gaussians' centres in the dataset's coordinates.
        work: (N,) cost of each: the sum of its blend weights.
        centers: (C, 3) of the cameras.
        count: number of blocks, at least 1; fewer result if there are not enough different points.

    Returns:
        The layout; outer boxes reach to infinity, or to where far things begin.
    """
    if not 1 <= count <= MOST_BLOCKS:
        raise InputError(f"--blocks {count}: from 1 to {MOST_BLOCKS}")
    low, high = centers.min(axis=0), centers.max(axis=0)
    margin = _FAR * float(np.linalg.norm(high - low))
    low, high = low - margin, high + margin
    far = ~((points >= low) & (points <= high)).all(axis=1)
    near = None
    if count > 1 and margin > 0 and work[far].sum() * count >= _FAR_WORTH * work.sum():
        near = (tuple(low.tolist()), tuple(high.tolist()))
        points, work, count = points[~far], work[~far], count - 1
    return Layout(_cut(points, work, count), near)


def _cut(points: np.ndarray, work: np.ndarray, count: int) -> dict[str, Any] | None:
    if count == 1 or len(points) < 2:
        return None
    total = work.sum()
    share = work / total if total > 0 else np.full(len(points), 1 / len(points))
    spread = share @ (points - share @ points) ** 2
    for axis in np.argsort(-spread, kind="stable"):
        order = np.argsort(points[:, axis], kind="stable")
        sorted_points = points[order, axis]
        target = (count // 2) / count
        place = int(np.searchsorted(np.cumsum(share[order]), target)) + 1
        place = min(max(place, 1), len(points) - 1)
        at = float(0.5 * (sorted_points[place - 1] + sorted_points[place]))
        below = points[:, axis] < at
        if below.any() and not below.all():
            return {
                "axis": int(axis),
                "at": at,
                "below": _cut(points[below], work[below], count // 2),
                "above": _cut(points[~below], work[~below], count - count // 2),
            }
    return None  # all points at one place


def _count_leaves(tree: dict[str, Any] | None) -> int:
    return 1 if tree is None else _count_leaves(tree["below"]) + _count_leaves(tree["above"])


def _number_points(
    tree: dict[str, Any] | None, points: np.ndarray, rows: np.ndarray, first: int, out: np.ndarray
) -> None:
    if tree is None:
        out[rows] = first
        return
    below = points[rows, tree["axis"]] < tree["at"]
    _number_points(tree["below"], points, rows[below], first, out)
    _number_points(tree["above"], points, rows[~below], first + _count_leaves(tree["below"]), out)


def _check_tree(tree: Any, source: str, where: str, depth: int = 0) -> None:
    if tree is None:
        return
    known = {"axis", "at", "below", "above"}
    if not isinstance(tree, dict) or set(tree) != known or depth > MOST_BLOCKS:
        raise InputError(
            f'{source}: {where} must be null (one block) or have "axis", "at", "below" and "above"'
        )
    if tree["axis"] not in (0, 1, 2) or isinstance(tree["axis"], bool):
        raise InputError(f"{source}: {where}.axis is {tree['axis']!r}; 0, 1 or 2")
    if not (_are_numbers([[tree["at"]]]) and math.isfinite(tree["at"])):
        raise InputError(f"{source}: {where}.at is {tree['at']!r}; a coordinate")
    for side in ("below", "above"):
        _check_tree(tree[side], source, f"{where}.{side}", depth + 1)


def _are_numbers(rows: Any) -> bool:
    """Returns whether `rows` is a list of lists of numbers."""
    return isinstance(rows, list) and all(
        isinstance(row, list)
        and all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in row)
        for row in rows
    )
