"""Cuts a scene into blocks by bisection."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import read_json, register_reader
from gsut.run.options import MOST_BLOCKS

_DAMAGED = "it is damaged: start a new run"


@dataclasses.dataclass(frozen=True)
class Layout:
    """A partition of space: every point lies in exactly one block.

    Attributes:
        tree: {"axis": 0 to 2, "at": coordinate, "below": tree, "above": tree}, where a point at the
            coordinate is above; or None: one block. Blocks are numbered by the leaves, below first.

    Coordinates are the dataset's; outer blocks reach to infinity.
    """

    tree: dict[str, Any] | None

    def __len__(self) -> int:
        return _count_leaves(self.tree)

    def find_owners(self, points: np.ndarray) -> np.ndarray:
        """Returns the block (N,) of each point (N, 3), float64 in the dataset's coordinates."""
        out = np.zeros(len(points), np.int32)
        _number_points(self.tree, points, np.arange(len(points)), 0, out)
        return out

    def as_dict(self) -> dict[str, Any]:
        """Returns a dict for JSON, which `read` reads."""
        return {"tree": self.tree}

    @classmethod
    @register_reader("layout of blocks", ".json")
    def read(cls, path: str) -> Layout:
        """Reads a layout from a JSON file.

        Raises:
            InputError: it cannot be read or is damaged.
        """
        values = read_json(path, {"tree": object}, advice=_DAMAGED)
        if not _is_tree(values["tree"]):
            raise InputError(f"{path}: is no layout of blocks; {_DAMAGED}")
        return cls(values["tree"])


def cut_scene(points: np.ndarray, work: np.ndarray, count: int) -> Layout:
    """Cuts a scene into blocks of equal work.

    Each box is cut across the axis along which its work spreads furthest, so that both sides have
    work in proportion to their numbers of blocks.

    Args:
        points: (N, 3) Gaussians' centres in the dataset's coordinates.
        work: (N,) cost of each: the sum of its blend weights.
        count: number of blocks, at least 1; fewer result if there are not enough different points.

    """
    if not 1 <= count <= MOST_BLOCKS:
        raise InputError(f"--blocks {count}: from 1 to {MOST_BLOCKS}")
    return Layout(_cut(points, work, count))


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
