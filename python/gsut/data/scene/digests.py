"""What a scene is made of, as short strings: two that agree are trained to the same bits."""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.data.errors import list_some
from gsut.data.scene.scene import Scene
from gsut.files import FileError, open_binary

_END_BYTES = 1 << 16  # of both ends of a file: pictures that differ differ there


def digest_scene(scene: Scene) -> dict[str, str]:
    """Digests each part of a scene: images, masks, poses, lenses, points and split.

    Of an image or mask file its size and both ends are read, 64 KiB each.
    """
    views = scene.views
    poses = (
        pose
        for view in views
        for pose in (
            view.camera_from_world,
            view.camera_from_world_start,
            view.camera_from_world_end,
        )
        if pose is not None
    )
    lenses = (repr((c.model, c.width, c.height, tuple(c.params))) for c in scene.file_cameras)
    split = repr((scene.train_indices, scene.test_indices, [view.name for view in views]))
    parts: dict[str, Iterable[bytes]] = {
        "images": (
            _read_ends(v.image_path)
            if v.pixels is None
            else np.ascontiguousarray(v.pixels).tobytes()
            for v in views
        ),
        "masks": itertools.chain(
            (_read_ends(path) for path in dict.fromkeys(v.mask_path for v in views) if path),
            (np.packbits(v.valid).tobytes() for v in views if v.valid is not None),
        ),
        "poses": (np.ascontiguousarray(pose).tobytes() for pose in poses),
        "lenses": (text.encode() for text in lenses),
        "points": (scene.points.tobytes(), scene.point_colors.tobytes()),
        "split": (split.encode(errors="surrogateescape"),),
    }
    return {name: _digest(content) for name, content in parts.items()}


def capture_state(paths: Sequence[Path]) -> list[list[Any]]:
    """Lists path, size and digest of each file, which show whether it is still the same."""
    return [[str(p.resolve()), p.stat().st_size, _digest((_read_ends(p),))] for p in paths]


def describe_changes(before: Sequence[Sequence[Any]], paths: Sequence[Path]) -> str:
    """Names the files that were changed, added or removed since `capture_state` listed them.

    Args:
        before: what `capture_state` returned.
        paths: the files now.

    Returns:
        "" if they are the same.
    """
    old, now = ({row[0]: row[1:] for row in rows} for rows in (before, capture_state(paths)))
    changed = [name for name in old if name in now and now[name] != old[name]]
    added, removed = [n for n in now if n not in old], [n for n in old if n not in now]
    kinds = ((changed, "changed"), (added, "added"), (removed, "removed"))
    return "; ".join(f"{what}: {list_some(names)}" for names, what in kinds if names)


def _read_ends(path: Path) -> bytes:
    try:
        with open_binary(path) as file:
            size = os.fstat(file.fileno()).st_size
            first = file.read(_END_BYTES)
            file.seek(max(len(first), size - _END_BYTES))
            return size.to_bytes(8, "little") + first + file.read(_END_BYTES)
    except FileError:
        return b""  # whoever needs its pixels says so


def _digest(content: Iterable[bytes]) -> str:
    whole = hashlib.sha256()
    for part in content:
        whole.update(len(part).to_bytes(8, "little"))
        whole.update(part)
    return whole.hexdigest()[:16]
