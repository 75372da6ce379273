"""Writes COLMAP's layout: images/, masks/, and the model in sparse/0."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gsut.data.export import Export, losses, place_images, plain_name
from gsut.data.poses import inverse
from gsut.data.write_colmap import ColmapImage, ColmapModel, colmap_binaries, colmap_texts
from gsut.files import write_file

MODEL = "sparse/0"


def write_colmap(folder: Path, export: Export) -> list[str]:
    """Writes the dataset with a binary model; returns what the layout cannot hold.

    Raises:
        InputError: COLMAP has no such lens.
    """
    return _write(folder, export, colmap_binaries(_model(export)))


def write_colmap_text(folder: Path, export: Export) -> list[str]:
    """As `write_colmap`, with a model as text."""
    return _write(folder, export, colmap_texts(_model(export)))


def _model(export: Export) -> ColmapModel:
    images = [
        ColmapImage(number, plain_name(frame), frame.camera, inverse(frame.world_from_camera))
        for number, frame in enumerate(export.frames, 1)
    ]
    return ColmapModel(images, export.points, export.point_colors)


def _write(folder: Path, export: Export, files: Mapping[str, str | bytes]) -> list[str]:
    place_images(export, folder)
    (folder / MODEL).mkdir(parents=True)
    for name, content in files.items():
        write_file(folder / MODEL / name, content)
    return losses(export, "COLMAP", masks=True)
