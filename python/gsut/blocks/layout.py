"""Cuts a scene into blocks by bisection; far things are a block of their own."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import read_json, register_reader
from gsut.run.options import MOST_BLOCKS

# Distance from the cameras' box, x its diagonal, beyond which things are far.
_FAR = 2.0
# Least work of far things, x the mean of the blocks, for a block of their own.
_FAR_WORTH = 0.5
_DAMAGED = "it is damaged: start a new run"


@dataclasses.dataclass(frozen=True)
class Layout:
    """A partition of space: every point lies in exactly one block.

    Attributes:
        tree: {"axis": 0 to 2, "at": coordinate, "below": tree, "above": tree}, where a point at the
            coordinate is above; or None: one block. Blocks are numbered by the leaves, below first.
        near: (low, high) corners beyond which everything is the last block; None: no such block.

    Coordinates are the dataset's.
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
        """Returns a dict for JSON, which `read` reads."""
        return {"tree": self.tree, "near": None if self.near is None else list(self.near)}

    @classmethod
    @register_reader("layout of blocks", ".json")
    def read(cls, path: str) -> Layout:
        """Reads a layout from a JSON file.

        Raises:
            InputError: it cannot be read or is damaged.
        """
        values = read_json(path, {"tree": object, "near": object}, advice=_DAMAGED)
        near = values["near"]
        if not (_is_tree(values["tree"]) and (near is None or np.shape(near) == (2, 3))):
            raise InputError(f"{path}: is no layout of blocks; {_DAMAGED}")
        return cls(values["tree"], near and (tuple(near[0]), tuple(near[1])))


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


def _is_tree(tree: Any) -> bool:
    """Returns whether a value of JSON is a tree of `Layout`."""
    return tree is None or (
        isinstance(tree, dict)
        and tree.keys() == {"axis", "at", "below", "above"}
        and tree["axis"] in (0, 1, 2)
        and isinstance(tree["at"], float)
        and _is_tree(tree["below"])
        and _is_tree(tree["above"])
    )
