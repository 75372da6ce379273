"""Reads the images and points of COLMAP models, text or binary."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut.data.colmap.fields import open_records
from gsut.data.colmap.records import ImageRow


def read_images(path: Path) -> list[ImageRow]:
    """Reads images.txt or images.bin without their 2D points.

    Raises:
        DatasetError: truncated, a malformed line, or a name that is not UTF-8.
    """
    records, rows = open_records(path, "image"), []
    for where in records:
        image_id, *pose, camera_id = records.take("IdddddddI")
        rows.append(ImageRow(image_id, pose[:4], pose[4:], camera_id, records.take_name(), where))
        records.skip_points()
    return rows


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads points3D.txt or points3D.bin: (N, 3) float64 and (N, 3) uint8 RGB.

    Raises:
        DatasetError: truncated, or a malformed line.
    """
    records, points, colors = open_records(path, "point"), [], []
    for _ in records:
        _, x, y, z, red, green, blue, _ = records.take("QdddBBBd")
        records.skip_track()
        points.append((x, y, z))
        colors.append((red, green, blue))
    return np.array(points, np.float64).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3)
