"""Streamed SOG, version 1: a folder of levels of detail, each cut by place into SOGs of files."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import read_bytes, read_json, register_reader, write_file, write_json
from gsut.formats._fields import Fields
from gsut.formats._format import SceneFile, check_claim, find_drawable, list_losses
from gsut.formats._origin import prepare_for_file
from gsut.formats._quantize import normalize_quats
from gsut.formats.sog import FORMAT, META, decode_members, encode_members, find_visible
from gsut.gaussians import (
    Gaussians,
    merge_gaussians,
    order_by_morton_code,
    rotations_from_quaternions,
)

TABLE = "lod-meta.json"  # by this name readers know the format
_ENVIRONMENT = "env"
# Bytes of a table: a leaf has about 200 a level.
_MOST_TABLE = 64 << 20
# Gaussians of the finest level in a leaf: readers choose the level of each leaf by its distance.
_LEAF = 1 << 14
# Gaussians in a file: half a megabyte, a second of a slow network.
_CHUNK = 1 << 15
# Standard deviations to which a Gaussian reaches: where its weight is 1/90.
_REACH = 3.0


@dataclasses.dataclass(frozen=True)
class StreamedFiles:
    """What was written.

    Attributes:
        counts: Gaussians of each level, from the finest.
        chunks: files that each level is cut into.
        level_bytes: of each level.
        environment_bytes: 0 without an environment.
        first_bytes: after which the first picture of the whole scene can be drawn: the table, the
            coarsest level and the environment.
        left_out: sentences about what the format has no place for.
    """

    counts: list[int]
    chunks: list[int]
    level_bytes: list[int]
    environment_bytes: int
    first_bytes: int
    left_out: tuple[str, ...]


def write_levels(
    folder: Path,
    levels: Sequence[Gaussians],
    psnrs: Sequence[float],
    environment: Gaussians | None = None,
) -> StreamedFiles:
    """Writes levels of detail as streamed SOG.

    Args:
        folder: an empty one, which becomes the scene.
        levels: from the finest; at least one.
        psnrs: of each level, dB of its pictures with the environment against photographs.
        environment: far Gaussians that belong to every level; None: there are none.

    Returns:
        What was written.

    Raises:
        InputError: a level has nothing to store, or the files cannot be written.
    """
    origin = prepare_for_file(levels[0]).origin
    stored = [_prepare(level, origin) for level in levels]
    means = [g.means for g in stored]
    leaves: list[dict[str, Any]] = []
    tree = _divide([np.arange(len(g)) for g in stored], means, leaves)
    names: list[str] = []
    sizes, chunks = [], []
    for number, g in enumerate(stored):
        first = len(names)
        total = 0
        for chunk in _pack_leaves(leaves, number):
            names.append(f"{number}_{len(names) - first}/{META}")
            total += _write_chunk(folder / names[-1], g, chunk, number, len(names) - 1)
        sizes.append(total)
        chunks.append(len(names) - first)
    _bound(tree, stored)
    counts = [len(g) for g in stored]
    table = {
        "version": 1,
        "asset": {"generator": "gsut", "psnr": list(psnrs)},
        "count": sum(counts), "counts": counts, "lodLevels": len(levels),
    }  # fmt: skip
    far = 0
    if environment is not None and len(g := _prepare(environment, origin)):
        table["environment"] = f"{_ENVIRONMENT}/{META}"
        far = _write_members(folder / _ENVIRONMENT, g)
    write_json(folder / TABLE, {**table, "filenames": names, "tree": tree})
    first_bytes = (folder / TABLE).stat().st_size + sizes[-1] + far
    left_out = list_losses(levels[0].with_origin(origin), FORMAT)
    if unseen := len(levels[0]) - counts[0]:
        left_out += (f"{unseen:,} Gaussians that nobody sees were left out",)
    return StreamedFiles(counts, chunks, sizes, far, first_bytes, left_out)


def _prepare(gaussians: Gaussians, origin: np.ndarray) -> Gaussians:
    """Prepares Gaussians about `origin` (3,) for SOG, in an order of their places."""
    g = gaussians.with_origin(origin).to_dtype(np.float32)
    g = g[find_drawable(g)].to_primitive(Gaussians.PRIMITIVES[0])
    g = g[find_visible(g)]
    return g[order_by_morton_code(g.means)]


def _divide(
    rows: list[np.ndarray], means: list[np.ndarray], leaves: list[dict[str, Any]]
) -> dict[str, Any]:
    """Divides the levels by the same planes, until few of the finest are left.

    Args:
        rows: of each level.
        means: of each level (N, 3).
        leaves: to which leaves are added, in the order of the tree; each with its `rows`.

    Returns:
        The node.
    """
    finest = means[0][rows[0]]
    if len(finest) > _LEAF:
        axis = int(np.argmax(np.ptp(finest, axis=0)))
        plane = np.median(finest[:, axis])
        below = [m[r, axis] < plane for m, r in zip(means, rows, strict=True)]
        if below[0].any():  # else most lie on one place
            parts = (
                [r[b == side] for r, b in zip(rows, below, strict=True)] for side in (True, False)
            )
            return {"children": [_divide(part, means, leaves) for part in parts]}
    leaves.append({"rows": rows, "lods": {}})
    return leaves[-1]


def _pack_leaves(leaves: list[dict[str, Any]], level: int) -> Iterator[list[dict[str, Any]]]:
    """Yields neighbouring leaves whose Gaussians of a level fit into one file."""
    chunk: list[dict[str, Any]] = []
    total = 0
    for leaf in leaves:
        count = len(leaf["rows"][level])
        if chunk and total + count > _CHUNK:
            yield chunk
            chunk, total = [], 0
        if count:
            chunk.append(leaf)
            total += count
    if chunk:
        yield chunk


def _write_chunk(
    path: Path, g: Gaussians, chunk: list[dict[str, Any]], level: int, file: int
) -> int:
    """Writes leaves of a level as one file, and into each where it lies there."""
    offset = 0
    for leaf in chunk:
        count = len(leaf["rows"][level])
        leaf["lods"][str(level)] = {"file": file, "offset": offset, "count": count}
        offset += count
    rows = np.concatenate([leaf["rows"][level] for leaf in chunk])
    return _write_members(path.parent, g[rows])


def _write_members(folder: Path, g: Gaussians) -> int:
    """Writes a SOG as files of its own; returns their bytes."""
    members = encode_members(folder, g, False)
    folder.mkdir()
    for name, content in members.items():
        write_file(folder / name, content)
    return sum(map(len, members.values()))


def _bound(node: dict[str, Any], levels: list[Gaussians]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds nodes by what their Gaussians reach, and drops the rows of leaves."""
    if "children" in node:
        boxes = [_bound(child, levels) for child in node["children"]]
    else:
        boxes = [
            _find_box(g[rows]) for g, rows in zip(levels, node.pop("rows"), strict=True)
            if len(rows)
        ]  # fmt: skip
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    node["bound"] = {"min": low.tolist(), "max": high.tolist()}
    return low, high


def _find_box(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    axes = rotations_from_quaternions(normalize_quats(g.quats.astype(np.float64)))
    reach = _REACH * np.linalg.norm(axes * np.exp(g.log_scales)[:, None], axis=2)
    return (g.means - reach).min(axis=0), (g.means + reach).max(axis=0)


class _Folder:
    """Files of a SOG that stand by themselves, read as an archive is."""

    def __init__(self, table: Path, name: str) -> None:
        self.path = table.parent / _check_inside(table, name).parent

    def read(self, name: str, most_bytes: int) -> bytes:
        if Path(name).name != name:
            raise InputError(f"{self.path / META}: damaged: it names {name!r:.60}, elsewhere")
        return read_bytes(self.path / name, most_bytes)

    def count_bytes(self) -> int:
        return sum(path.stat().st_size for path in self.path.glob("*"))


def _check_inside(table: Path, name: Any) -> Path:
    """Returns a file's path beside the table; raises InputError for one that leads elsewhere."""
    path = Path(name if isinstance(name, str) else "")
    if path.name != META or path.anchor or ".." in path.parts or len(path.parts) < 2:
        raise InputError(
            f"{table}: damaged: it names {name!r:.60}, and each file of a level has to be a "
            f"{META} in a folder beside it"
        )
    return path


@register_reader("streamed SOG", TABLE)
def read_levels(path: Path) -> SceneFile:
    """Reads the finest level of a streamed SOG, and its environment.

    Args:
        path: of its table, `TABLE`.

    Raises:
        InputError: the table or a file is damaged, or they contradict each other.
    """
    table = Fields(path, read_json(path, most_bytes=_MOST_TABLE))
    if (version := table.values.get("version", 1)) != 1:
        raise InputError(f"{path}: streamed SOG version {version!r:.20}; gsut reads 1")
    names = table.values.get("filenames")
    names = table.read_names("filenames", len(names) if isinstance(names, list) else 1)
    runs: dict[int, list[tuple[int, int]]] = {}
    for leaf in _list_leaves(table.read_fields("tree")):
        lods = leaf.read_fields("lods")
        if "0" in lods.values:
            lod = lods.read_fields("0")
            file = lod.read_whole("file", 0, len(names) - 1)
            run = lod.read_whole("offset", 0), lod.read_whole("count", 0)
            runs.setdefault(file, []).append(run)
    claimed = sum(count for each in runs.values() for _, count in each)
    check_claim(path, claimed, claimed)  # against memory; each file is checked by its size
    files = [_read_chunk(path, names[file], sorted(runs[file])) for file in sorted(runs)]
    if not files:
        raise InputError(f"{path}: damaged: no leaf of its tree has Gaussians of level 0")
    far = table.values.get("environment")
    if far is not None:
        files.append(_read_members(path, far))
    antialiased = any(file.antialiased for file in files)
    return SceneFile(merge_gaussians([file.gaussians for file in files]), antialiased)


def _list_leaves(root: Fields) -> Iterator[Fields]:
    waiting = [root]
    while waiting:
        node = waiting.pop()
        children = node.values.get("children")
        if children is None:
            yield node
        else:
            count = len(children) if isinstance(children, list) else 1
            waiting.extend(node.read_fields("children", index) for index in range(count))


def _read_members(table: Path, name: Any) -> SceneFile:
    folder = _Folder(table, name)
    return decode_members(folder.path / META, folder, folder.count_bytes())


def _read_chunk(table: Path, name: str, runs: list[tuple[int, int]]) -> SceneFile:
    """Reads a file of a level; raises InputError unless its leaves' runs are all that it holds."""
    found = _read_members(table, name)
    end = 0
    for offset, count in runs:
        if offset != end:
            break
        end += count
    if end != len(found.gaussians) or sum(count for _, count in runs) != end:
        raise InputError(
            f"{table}: damaged: {name} has {len(found.gaussians):,} Gaussians, and the leaves of "
            "its tree do not name each of them once; convert the scene again"
        )
    return found
