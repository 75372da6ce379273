"""Walks through the demo's hall, one through a lens of each family, for `./run bench poses`."""

from __future__ import annotations

from pathlib import Path

from gsut.data import save_dataset
from gsut.data.poses import invert_pose
from gsut.lens import Camera, convert_camera
from gsut.sfm.lens.candidates import make_lens
from tests.bench.walk_film import Film, plan_walk, trace_frames

_SIZE = 480, 320
_SECONDS = 10.5  # 42 frames at _RATE
_RATE = 4.0
_SPLINE_COLUMNS = 30  # control points across, in 22 rows: 1,328 parameters


def make_family(family: str) -> Camera:
    """Makes the lens of a family: a wide one with barrel distortion, where the family has it.

    Args:
        family: a name of `FAMILIES`.
    """
    width, height = _SIZE
    if family == "equirectangular":
        return Camera(family, [], width, width // 2)
    barrel = make_lens(width, height, 100, 0.7)
    if family == "kannala_brandt":
        return barrel
    if family == "pinhole":
        return Camera(family, barrel.params[:4], width, height)
    return convert_camera(barrel, family, columns=_SPLINE_COLUMNS).camera


FAMILIES = (
    "pinhole", "kannala_brandt", "opencv8", "cahvor", "equirectangular", "splined_stereographic"
)  # fmt: skip
WALKS = tuple(f"lens_{family}" for family in FAMILIES)


def write_walk(name: str, folder: Path) -> None:
    """Writes a walk's dataset, with the true lens and poses.

    Args:
        name: one of `WALKS`.
        folder: a new one.
    """
    camera = make_family(name.removeprefix("lens_"))
    film = Film(
        camera, plan_walk(_SECONDS, around=0.6, seed=3), _SECONDS, _RATE, readout=0.0, exposure=0.0,
        samples=2,
    )  # fmt: skip
    poses = [invert_pose(pose) for pose in film.path(film.times)]
    save_dataset(folder, list(trace_frames(film)), camera, poses)
