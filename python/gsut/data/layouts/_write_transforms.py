"""Writes nerfstudio's layout: transforms.json, images/, masks/ and the points' PLY."""

from __future__ import annotations

from pathlib import Path

from gsut.data.export import POINTS, Export, place_images, plain_name
from gsut.data.write_nerfstudio import write_transforms


def write_nerfstudio(folder: Path, export: Export) -> list[str]:
    """Writes the dataset; returns what the layout cannot hold."""
    frames = place_images(export, folder)
    export.write_points(folder / POINTS)
    test = None
    if export.test is not None:
        wanted = set(export.test)
        test = [plain_name(frame) for frame in export.frames if frame.name in wanted]
    write_transforms(
        folder / "transforms.json", frames, points_file=POINTS if len(export.points) else None,
        test=test,
    )  # fmt: skip
    if any(frame.depth_path is not None for frame in frames):
        return ["depth files are named where they were, not copied"]
    return []
