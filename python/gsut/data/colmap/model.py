"""Writes COLMAP models, as text or binary: cameras, images with their 2D points, and points3D."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence

import numpy as np

from gsut.data.colmap.records import ColmapImage
from gsut.data.colmap.rigid import list_rig_rows, pack_pose
from gsut.data.colmap.rigs import format_rig_texts, pack_rigs
from gsut.lens import Camera
from gsut.lens.files import to_colmap


@dataclasses.dataclass
class ColmapModel:
    """Images, and points (P, 3) with colours (P, 3) uint8 and errors (P,) in pixels."""

    images: Sequence[ColmapImage]
    points: np.ndarray
    colors: np.ndarray
    errors: np.ndarray | None = None

    def number_cameras(self) -> tuple[dict[int, Camera], list[int]]:
        """Numbers the lenses from 1, each once, but each camera of a rig by itself.

        Returns:
            The lenses by number, and the number of each image.
        """
        keys = [(i.camera, None if i.rig is None else i.rig[:2]) for i in self.images]
        found = {key: number for number, key in enumerate(dict.fromkeys(keys), 1)}
        return {number: key[0] for key, number in found.items()}, [found[key] for key in keys]

    @property
    def has_rigs(self) -> bool:
        return any(image.rig is not None for image in self.images)

    def get_error(self, point: int) -> float:
        return 0.0 if self.errors is None else float(self.errors[point])

    def list_tracks(self) -> list[list[tuple[int, int]]]:
        """Lists, for each point, the images that see it and its index among their pixels."""
        list_tracks: list[list[tuple[int, int]]] = [[] for _ in range(len(self.points))]
        for image in self.images:
            for place, point in enumerate(image.points):
                list_tracks[int(point)].append((image.number, place))
        return list_tracks


def format_model_texts(model: ColmapModel) -> dict[str, str]:
    """Formats cameras.txt, images.txt and points3D.txt; cameras and points count from 1.

    Models with rigs have rigs.txt and frames.txt, too.

    Raises:
        InputError: COLMAP has no such lens.
    """
    lenses, numbers = model.number_cameras()
    cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for number, camera in lenses.items():
        name, _, params = to_colmap(camera)
        values = " ".join(map(repr, params))
        cameras.append(f"{number} {name} {camera.width} {camera.height} {values}")
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
    for image, number in zip(model.images, numbers, strict=True):
        pose = pack_pose(image.camera_from_world)
        images.append(f"{image.number} {_format_numbers(pose)} {number} {image.name}")
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
    texts = {name: "\n".join([*lines, ""]) for name, lines in files.items()}
    if not model.has_rigs:
        return texts
    return texts | format_rig_texts(*list_rig_rows(model.images, numbers))


def format_model_binaries(model: ColmapModel) -> dict[str, bytes]:
    """Packs cameras.bin, images.bin and points3D.bin; of rigs also rigs.bin and frames.bin.

    Raises:
        InputError: COLMAP has no such lens.
    """
    lenses, numbers = model.number_cameras()
    cameras = [struct.pack("<Q", len(lenses))]
    for number, camera in lenses.items():
        _, model_id, params = to_colmap(camera)
        head = struct.pack("<IiQQ", number, model_id, camera.width, camera.height)
        cameras.append(head + struct.pack(f"<{len(params)}d", *params))
    images = [struct.pack("<Q", len(model.images))]
    for image, number in zip(model.images, numbers, strict=True):
        values = pack_pose(image.camera_from_world)
        images.append(struct.pack("<I7dI", image.number, *values, number))
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
    packed = {name: b"".join(parts) for name, parts in files.items()}
    if not model.has_rigs:
        return packed
    return packed | pack_rigs(*list_rig_rows(model.images, numbers))


def _format_numbers(values: Sequence[float] | np.ndarray | tuple) -> str:
    return " ".join(repr(float(value)) for value in values)
