"""Writes COLMAP models, as text or binary: cameras, images with their 2D points, and points3D."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence

import numpy as np

from gsut.gaussians import quaternion_from_rotation
from gsut.lens import Camera
from gsut.lens.files import to_colmap

_NO_ERROR = 0.0


@dataclasses.dataclass
class ColmapImage:
    """One image: `pixels` (M, 2) and `points` (M,), the place in the model's points of each."""

    number: int
    name: str
    camera: Camera
    camera_from_world: np.ndarray
    pixels: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    points: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))


@dataclasses.dataclass
class ColmapModel:
    """Images, and points (P, 3) with colours (P, 3) uint8 and errors (P,) in pixels."""

    images: Sequence[ColmapImage]
    points: np.ndarray
    colors: np.ndarray
    errors: np.ndarray | None = None

    def number_lenses(self) -> dict[Camera, int]:
        """Numbers the lenses from 1, each once."""
        found = dict.fromkeys(image.camera for image in self.images)
        return {camera: number for number, camera in enumerate(found, 1)}

    def get_error(self, point: int) -> float:
        return _NO_ERROR if self.errors is None else float(self.errors[point])

    def list_tracks(self) -> list[list[tuple[int, int]]]:
        """Lists, for each point, the images that see it and its index among their pixels."""
        list_tracks: list[list[tuple[int, int]]] = [[] for _ in range(len(self.points))]
        for image in self.images:
            for place, point in enumerate(image.points):
                list_tracks[int(point)].append((image.number, place))
        return list_tracks


def format_model_texts(model: ColmapModel) -> dict[str, str]:
    """Formats cameras.txt, images.txt and points3D.txt; cameras and points count from 1.

    Raises:
        InputError: COLMAP has no such lens.
    """
    number_lenses = model.number_lenses()
    cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for camera, number in number_lenses.items():
        name, _, params = to_colmap(camera)
        values = " ".join(map(repr, params))
        cameras.append(f"{number} {name} {camera.width} {camera.height} {values}")
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
    for image in model.images:
        pose = image.camera_from_world
        numbers = _format_numbers((*quaternion_from_rotation(pose[:3, :3]), *pose[:3, 3]))
        images.append(f"{image.number} {numbers} {number_lenses[image.camera]} {image.name}")
        images.append(
            " ".join(
                f"{x:.6f} {y:.6f} {point + 1}"
                for (x, y), point in zip(
                    np.asarray(image.pixels).tolist(),
                    np.asarray(image.points).tolist(),
                    strict=True,
                )
            )
        )
    points = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    for i, track in enumerate(model.list_tracks()):
        color = " ".join(str(int(v)) for v in model.colors[i])
        seen = " ".join(f"{image} {place}" for image, place in track)
        points.append(
            f"{i + 1} {_format_numbers(model.points[i])} {color} {model.get_error(i):.6f} {seen}"
        )
    files = {"cameras.txt": cameras, "images.txt": images, "points3D.txt": points}
    return {name: "\n".join([*lines, ""]) for name, lines in files.items()}


def format_model_binaries(model: ColmapModel) -> dict[str, bytes]:
    """Packs cameras.bin, images.bin and points3D.bin.

    Raises:
        InputError: COLMAP has no such lens.
    """
    number_lenses = model.number_lenses()
    cameras = [struct.pack("<Q", len(number_lenses))]
    for camera, number in number_lenses.items():
        _, model_id, params = to_colmap(camera)
        head = struct.pack("<IiQQ", number, model_id, camera.width, camera.height)
        cameras.append(head + struct.pack(f"<{len(params)}d", *params))
    images = [struct.pack("<Q", len(model.images))]
    for image in model.images:
        pose = image.camera_from_world
        values = (*quaternion_from_rotation(pose[:3, :3]), *pose[:3, 3])
        images.append(struct.pack("<I7dI", image.number, *values, number_lenses[image.camera]))
        images.append(image.name.encode() + b"\0" + struct.pack("<Q", len(image.points)))
        seen = np.empty(len(image.points), [("xy", "<f8", 2), ("point", "<u8")])
        seen["xy"], seen["point"] = image.pixels, image.points + 1
        images.append(seen.tobytes())
    points = [struct.pack("<Q", len(model.points))]
    for i, track in enumerate(model.list_tracks()):
        color = [int(v) for v in model.colors[i]]
        points.append(
            struct.pack("<Q3d3BdQ", i + 1, *model.points[i], *color, model.get_error(i), len(track))
        )
        points += [struct.pack("<II", *row) for row in track]
    files = {"cameras.bin": cameras, "images.bin": images, "points3D.bin": points}
    return {name: b"".join(parts) for name, parts in files.items()}


def _format_numbers(values: Sequence[float] | np.ndarray | tuple) -> str:
    return " ".join(repr(float(value)) for value in values)
