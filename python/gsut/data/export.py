"""A dataset as layouts write it, and how its pictures get to their places."""

from __future__ import annotations

import dataclasses
import errno
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from gsut._core import InputError
from gsut.data.listing import Frame
from gsut.data.points import format_points_ply
from gsut.data.poses import invert_pose
from gsut.files import WriteError, claim_name, write_file
from gsut.lens import Camera
from gsut.system import rename_over

POINTS = "points3D.ply"
_SAME_PLACE = 1e-6  # of a rig's poses against each other, relative to its distances
_STEP_NS = 100_000_000  # between pictures whose times nobody knows


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


def copy_file(source: Path, target: Path) -> None:
    """Copies a file, making the folders above it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        shutil.copyfile(source, target)
    except OSError as error:  # of which it names the source, whatever failed
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        raise WriteError(f"cannot write {target}: {error.strerror}; is the disk full?") from None


def link_file(source: Path, target: Path) -> None:
    """Makes a symbolic link to a file, and the folders above it.

    Raises:
        WriteError: the file system or the system knows none (Windows wants a privilege).
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.symlink(source.resolve(), target)
    except OSError as error:
        raise WriteError(
            f"cannot link {target}: {error.strerror}; give it without --link, which copies"
        ) from None


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


def require_one_lens(export: Export, layout: str) -> Camera:
    """Returns the only lens.

    Raises:
        InputError: there are several.
    """
    lenses = {frame.camera for frame in export.frames}
    if len(lenses) > 1:
        raise InputError(
            f"{layout}'s layout, as gsut writes it, holds one camera, found {len(lenses)}; choose"
            " one with --cameras, or another layout"
        )
    (lens,) = lenses
    return lens


def list_losses(
    export: Export,
    layout: str,
    *,
    masks: bool = False,
    times: bool = False,
    lens_limits: bool = True,
) -> list[str]:
    """Lists what a layout with one pose an image cannot hold, one sentence each.

    Args:
        export: what is written.
        layout: its name, for the sentences.
        masks: whether it holds masks.
        times: whether it names images by time, which then may have been made up.
        lens_limits: whether its lenses keep the field in which they are valid.
    """
    found = []
    if not lens_limits:
        found += _list_lens_losses(export, layout)
    if any(frame.shutter is not None for frame in export.frames):
        found.append(f"{layout} has the pose in the middle of each readout: it knows no other")
    masked = sum(frame.mask_path is not None for frame in export.frames)
    if masked and not masks:
        found.append(f"{layout} has no place for masks: those of {masked} images are left out")
    if export.test is not None:
        found.append(f"{layout} has no place for lists of held-out images: give --set test_names")
    has_times = find_frame_times(export.frames)[1]
    if times and not has_times:
        found.append("the images have no times: they are named as if taken ten a second")
    if has_times and not times:
        found.append(f"{layout} has no place for the times of images: they are left out")
    deep = sum(f.depth_path is not None or f.normal_path is not None for f in export.frames)
    if deep:
        found.append(
            f"{layout} has no place for depths and normals: those of {deep} images are left out"
        )
    return found


def _list_lens_losses(export: Export, layout: str) -> list[str]:
    """Lists what pixels get rays, or lose their calibrated ones, without the lens' limits."""
    lenses = {frame.camera for frame in export.frames}
    angles = [c.valid_field_angle for c in lenses if c.valid_field_angle is not None]
    found = []
    if angles:
        found.append(
            f"{layout} has no place for the field angle to which a lens is valid: pixels beyond "
            f"{np.degrees(min(angles)):.1f} degrees, which had no ray, have one there; mask them"
        )
    if any(c.valid_region is not None and len(c.valid_region) for c in lenses):
        found.append(
            f"{layout} has no place for the region in which a lens is valid: mask the rest"
        )
    return found


def find_frame_times(frames: Sequence[Frame]) -> tuple[list[int], bool]:
    """Returns each frame's time in nanoseconds, by default ten a second, and whether it is known.

    Frames of one stem in several folders then have one time: those of a rig.
    """
    known = [frame.time_ns for frame in frames]
    if frames and all(time is not None for time in known):
        return [time for time in known if time is not None], True
    seconds = [frame.time for frame in frames]
    if frames and all(time is not None for time in seconds):
        return [round(time * 1e9) for time in seconds if time is not None], True
    stems = {stem: i for i, stem in enumerate(sorted({f.image_path.stem for f in frames}))}
    if len({(f.image_path.parent, f.image_path.stem) for f in frames}) < len(frames):
        return [i * _STEP_NS for i in range(len(frames))], False
    return [stems[f.image_path.stem] * _STEP_NS for f in frames], False


@dataclasses.dataclass
class Seat:
    """One camera of a body: its lens, its place, and its frames with their times."""

    camera: Camera
    body_from_camera: np.ndarray
    frames: list[Frame]
    times: list[int]


def group_seats(frames: Sequence[Frame], layout: str) -> tuple[list[Seat], dict[int, np.ndarray]]:
    """Groups frames by the camera of one body that took them.

    Returns:
        One seat for each lens and folder, the body being the first camera, and world_from_body by
        time in nanoseconds.

    Raises:
        InputError: cameras that took pictures at the same times do not move as one body.
    """
    times, _ = find_frame_times(frames)
    groups: dict[tuple, Seat] = {}
    for frame, time in zip(frames, times, strict=True):
        key = (PurePosixPath(frame.name).parent, frame.camera)
        seat = groups.setdefault(key, Seat(frame.camera, np.eye(4), [], []))
        seat.frames.append(frame)
        seat.times.append(time)
    bodies: dict[int, np.ndarray] = {}
    for seat in groups.values():
        met = [i for i, time in enumerate(seat.times) if time in bodies]
        if bodies and not met:
            raise InputError(
                f"{layout} holds one body's poses, and {seat.frames[0].name} and others of its "
                "camera were taken at no time of another camera, so that nothing says where on the "
                "body it is; write one camera at a time with --cameras, or as nerfstudio"
            )
        if met:
            first = invert_pose(bodies[seat.times[met[0]]]) @ seat.frames[met[0]].world_from_camera
            seat.body_from_camera = first
        for frame, time in zip(seat.frames, seat.times, strict=True):
            body = frame.world_from_camera @ invert_pose(seat.body_from_camera)
            before = bodies.setdefault(time, body)
            scale = 1 + np.abs(before[:3, 3]).max() + np.abs(seat.body_from_camera[:3, 3]).max()
            if np.abs(before - body).max() > _SAME_PLACE * scale:
                raise InputError(
                    f"{layout} holds one body's poses, and the cameras of {frame.name} and others "
                    f"of its time differ in place by {np.abs(before - body).max():.2g} from image "
                    "to image; write one camera at a time with --cameras, or as nerfstudio"
                )
    return list(groups.values()), bodies
