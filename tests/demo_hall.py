"""Writes the demo's hall with fewer or smaller images, for tests."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from gsut.demo import write_demo_scene

_LENS_KEYS = ("fl_x", "fl_y", "cx", "cy")


def write_hall(folder: Path, views: int = 30, test_views: int = 5, size: int = 200) -> Path:
    """Writes images of the demo's hall, evenly spread along its walk.

    Args:
        folder: is created.
        views, test_views: numbers of training and of held-out images; at most 35 together.
        size: width and height of the images, pixels; the lens is the demo's at that size.
    """
    write_demo_scene(folder)
    file = folder / "transforms.json"
    content = json.loads(file.read_text())
    frames = sorted(content["frames"], key=lambda f: f["file_path"][-len("000.png") :])
    count = views + test_views
    kept = [frames[int(i * len(frames) / count)] for i in range(count)]
    # Held out: those that have a depth file, then any others.
    order = sorted(range(count), key=lambda i: "depth_file_path" not in kept[i])
    held_out = {kept[i]["file_path"] for i in order[:test_views]}
    for frame in frames:
        if frame not in kept:
            for kind in ("images", "labels", "depth"):
                (folder / kind / Path(frame["file_path"]).name).unlink(missing_ok=True)
        elif frame["file_path"] not in held_out and frame.pop("depth_file_path", None):
            (folder / "depth" / Path(frame["file_path"]).name).unlink()
    content["frames"] = [frame for frame in content["frames"] if frame in kept]
    names = [frame["file_path"] for frame in content["frames"]]
    content["train_filenames"] = [name for name in names if name not in held_out]
    content["test_filenames"] = [name for name in names if name in held_out]
    scale = size / content["w"]
    content |= {key: content[key] * scale for key in _LENS_KEYS} | {"w": size, "h": size}
    file.write_text(json.dumps(content))
    if scale != 1:
        for picture in folder.rglob("*.png"):
            _shrink_picture(picture, size)
    return folder


def _shrink_picture(file: Path, size: int) -> None:
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    way = cv2.INTER_AREA if pixels.ndim == 3 or file.name == "mask.png" else cv2.INTER_NEAREST
    small = cv2.resize(pixels, (size, size), interpolation=way)
    if file.name == "mask.png":
        small = np.where(small == 255, 255, 0).astype(np.uint8)
    cv2.imwrite(str(file), small)
