"""A dataset as layouts write it, and how its pictures get to their places."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from gsut.data.listing import Frame
from gsut.data.points import format_points_ply
from gsut.data.poses import NANOSECONDS
from gsut.files import claim_name, copy_file, write_file
from gsut.system import rename_over

POINTS = "points3D.ply"


@dataclasses.dataclass
class Export:
    """What is written.

    Args:
        frames: sorted by name; `image_path` is where a picture is now. Their names become those of
            the new pictures: paths below a folder, without "images", no two the same.
        points, point_colors: (P, 3) float64 and uint8.
        test: names of the frames held out by the dataset's own lists, or None.
        place: puts a file to its new place.
        up: (3,) in the world, or None where it is not known.
    """

    frames: list[Frame]
    points: np.ndarray
    point_colors: np.ndarray
    test: list[str] | None
    place: Callable[[Path, Path], None]
    up: np.ndarray | None = None

    def __post_init__(self) -> None:
        taken: set[str] = set()
        held_out = None if self.test is None else set(self.test)
        before = [frame.name for frame in self.frames]
        self.frames = [
            dataclasses.replace(frame, name=claim_name(strip_images_folder(frame), taken))
            for frame in self.frames
        ]
        if held_out is not None:
            self.test = [
                f.name for f, name in zip(self.frames, before, strict=True) if name in held_out
            ]

    def write_points(self, path: Path) -> None:
        """Writes the points' PLY; nothing where there are none."""
        if len(self.points):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_file(path, format_points_ply(self.points, self.point_colors))


def move_file(source: Path, target: Path) -> None:
    """Moves a file within a file system, making the folders above it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    rename_over(source, target)


def strip_images_folder(frame: Frame) -> str:
    """Strips the folder "images", into which layouts put pictures anyway, from a frame's name."""
    parts = PurePosixPath(frame.name).parts
    kept = [part for part in parts if part not in ("..", "/", ".")]
    return "/".join(kept[1:] if len(kept) > 1 and kept[0] == "images" else kept)


def place_images(export: Export, folder: Path) -> list[Frame]:
    """Puts pictures to folder/images and masks to folder/masks; the frames of the new files.

    A mask is named as its picture, with .png added, once for each picture.
    """
    placed: dict[Path, Path] = {}
    frames = []
    for frame in export.frames:
        name = frame.name
        picture = folder / "images" / name
        export.place(frame.image_path, picture)
        mask = frame.mask_path
        if mask is not None:
            target = folder / "masks" / f"{name}.png"
            if mask.is_file():
                export.place(mask, target)
            else:  # moved already, as the mask of another picture
                copy_file(placed[mask], target)
            placed.setdefault(mask, target)
            mask = target
        frames.append(dataclasses.replace(frame, image_path=picture, mask_path=mask))
    return frames


def list_losses(export: Export) -> list[str]:
    """Lists what COLMAP's layout cannot hold, one sentence each."""
    lenses = {frame.camera for frame in export.frames}
    angles = [c.valid_field_angle for c in lenses if c.valid_field_angle is not None]
    found = []
    if angles:
        found.append(
            "COLMAP has no place for the field angle to which a lens is valid: pixels beyond "
            f"{np.degrees(min(angles)):.1f} degrees, which had no ray, have one there; mask them"
        )
    if any(c.valid_region is not None and len(c.valid_region) for c in lenses):
        found.append("COLMAP has no place for the region in which a lens is valid: mask the rest")
    if any(frame.shutter is not None for frame in export.frames):
        found.append("COLMAP has the pose in the middle of each readout: it knows no other")
    if export.test is not None:
        found.append("COLMAP has no place for lists of held-out images: give --test-names")
    if find_frame_times(export.frames) is not None:
        found.append("COLMAP has no place for the times of images: they are left out")
    deep = sum(f.depth_path is not None for f in export.frames)
    if deep:
        found.append(f"COLMAP has no place for depths: those of {deep} images are left out")
    return found


def find_frame_times(frames: Sequence[Frame]) -> list[int] | None:
    """Returns each frame's time in nanoseconds; None where some have none."""
    known = [frame.time_ns for frame in frames if frame.time_ns is not None]
    if len(known) < len(frames):
        known = [round(frame.time * NANOSECONDS) for frame in frames if frame.time is not None]
    return known if len(known) == len(frames) > 0 else None
