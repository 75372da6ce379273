"""A recording: pictures of one or more cameras, their lenses, and a file of poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut.data.images import IMAGE_SUFFIXES
from gsut.data.poses import is_time
from gsut.data.rigs import Mount
from gsut.data.scene import DISTANCES, DepthForm
from gsut.files import split_numbers

TIME_TOLERANCE = 0.02  # seconds, as TUM's own tools use
MASK = "mask.png"


@dataclasses.dataclass
class Stream:
    """The pictures of one camera.

    Args:
        name: of the camera.
        images: its pictures.
        times: of each as decimal text; None: the files' stems.
        mask: of all pictures, or None.
        depths: depth files by picture. depth_form: how they are meant.
    """

    name: str
    images: list[Path]
    times: list[str] | None = None
    mask: Path | None = None
    depths: dict[Path, Path] = dataclasses.field(default_factory=dict)
    depth_form: DepthForm = DISTANCES

    def list_times(self) -> list[str]:
        """Lists each picture's time as text; empty if its name is not a number."""
        texts = [path.stem for path in self.images] if self.times is None else self.times
        return [text if is_time(text) else "" for text in texts]


@dataclasses.dataclass
class Recording:
    """What a layout found, before pictures and poses are brought together.

    Args:
        path: the dataset's folder.
        streams: one a camera.
        mounts: lenses and places of the cameras of these names; None: no lens was found.
        poses: file of the trajectory, or None.
        poses_of: see `find_body_from_camera`.
        body_from_poses: (4, 4) where the poses are of another sensor on the body (EuRoC's T_BS).
        names_from: pictures are named by their paths from here.
        points, masks: a PLY, a folder; or None.
        cameras: names of those to use; empty: all.
        time_offset: seconds to add to the times of pictures for the clock of the poses.
        time_tolerance: seconds between a picture and its nearest pose, at most.
        image_times, pose_times: their units, see `UNITS`; None: by their number of digits.
        notes: what the user should know.
    """

    path: Path
    streams: list[Stream]
    mounts: Callable[[Sequence[str]], dict[str, Mount]] | None = None
    poses: Path | None = None
    poses_of: str | None = None
    body_from_poses: np.ndarray | None = None
    names_from: Path | None = None
    points: Path | None = None
    masks: Path | None = None
    cameras: tuple[str, ...] = ()
    time_offset: float = 0.0
    time_tolerance: float = TIME_TOLERANCE
    image_times: str | None = None
    pose_times: str | None = None
    notes: list[str] = dataclasses.field(default_factory=list)


def list_pictures(folder: Path, *, below: bool = False) -> list[Path]:
    """Lists the pictures of a folder (and below it), sorted, without a mask.png."""
    found = folder.rglob("*") if below else folder.glob("*")
    pictures = (
        p for p in found if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file() and p.name != MASK
    )
    return sorted(pictures, key=lambda path: split_numbers(path.as_posix()))


def find_stream(name: str, folder: Path) -> Stream:
    """Finds the pictures of a folder as a stream, with its mask.png if there is one."""
    mask = folder / MASK
    return Stream(name, list_pictures(folder), mask=mask if mask.is_file() else None)
