"""COLMAP models: their files, binary and text, read and written."""

from gsut.data.colmap.binary import read_images_bin, read_points_bin
from gsut.data.colmap.model import (
    ColmapImage,
    ColmapModel,
    format_model_binaries,
    format_model_texts,
)
from gsut.data.colmap.text import read_images_txt, read_points_txt

__all__ = [
    "ColmapImage",
    "ColmapModel",
    "format_model_binaries",
    "format_model_texts",
    "read_images_bin",
    "read_images_txt",
    "read_points_bin",
    "read_points_txt",
]
