"""What a scene is made of, as short strings: two that agree are trained to the same bits."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable

import numpy as np

from gsut.data.scene.scene import Scene
from gsut.files import read_ends


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
            read_ends(v.image_path)
            if v.pixels is None
            else np.ascontiguousarray(v.pixels).tobytes()
            for v in views
        ),
        "masks": itertools.chain(
            (read_ends(path) for path in dict.fromkeys(v.mask_path for v in views) if path),
            (np.packbits(v.valid).tobytes() for v in views if v.valid is not None),
        ),
        "poses": (np.ascontiguousarray(pose).tobytes() for pose in poses),
        "lenses": (text.encode() for text in lenses),
        "points": (scene.points.tobytes(), scene.point_colors.tobytes()),
        "split": (split.encode(errors="surrogateescape"),),
    }
    return {name: _digest(content) for name, content in parts.items()}


def _digest(content: Iterable[bytes]) -> str:
    whole = hashlib.sha256()
    for part in content:
        whole.update(len(part).to_bytes(8, "little"))
        whole.update(part)
    return whole.hexdigest()[:16]
