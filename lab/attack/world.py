"""Makes small valid inputs of every kind, once; each case spoils a copy."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

import gsut
import rendered_dataset
import small_datasets
import small_recordings
import small_videos
import synthetic_boards
from formats.scene_cases import plain_scene
from gsut import formats
from gsut.cli import main
from gsut.lens import convert_camera
from lab.demo_tracer import make_demo_rig
from lens_cases import FOREIGN_FILES
from random_scenes import pinhole

STEPS = "20"
RIG_SIZE = 160  # of the square images of two cameras on a body
RIG = "".join(
    f"cam{i}:\n  camera_model: pinhole\n  intrinsics: [90, 90, 24, 18]\n  resolution: [48, 36]\n"
    f"  distortion_model: none\n  distortion_coeffs: []\n{pose}"
    for i, pose in enumerate(
        ("", "  T_cn_cnm1:\n  - [1, 0, 0, 0.1]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n"
             "  - [0, 0, 0, 1]\n")
    )
)  # fmt: skip
LENSES = ("gsut.lens.json", "opencv.yaml", "opencv.json", "camchain.yaml", "cameras.txt",
          "cameras.bin", "transforms.json", "lens.cameramodel")  # fmt: skip
SCENES = ("a.ply", "b.compressed.ply", "c.spz", "d.sog", "e.glb", "f.splat")


@contextlib.contextmanager
def enter_folder(folder: Path) -> Iterator[None]:
    """Makes a folder the current one for the duration of the block."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def make_world(folder: Path) -> Path:
    """Makes datasets of every layout, a run, scene files, lens files, a film and tables."""
    rng = np.random.default_rng(5)
    rendered_dataset.write_dataset(folder / "ds", rng)
    small_datasets.write_nerfstudio(folder / "plane")
    small_datasets.write_colmap_text(folder / "colmap_text")
    small_datasets.write_colmap_binary(folder / "colmap_binary")
    small_datasets.write_folder(folder / "folder")
    small_recordings.write_euroc(folder / "euroc")
    small_recordings.write_tumvi(folder / "tumvi")
    write_lenses(folder / "lenses")
    (folder / "scenes").mkdir()
    gaussians = plain_scene(rng, 60)
    for name in SCENES:
        formats.save_gaussians(folder / "scenes" / name, gaussians)
    small_videos.walk_past(folder / "film.mp4", 8)
    write_tables(folder)
    with contextlib.redirect_stdout(io.StringIO()), enter_folder(folder):
        status = main(["train", "ds", "-o", "run", "--steps", STEPS, "--preset", "fast", "--quiet"])
    assert status == 0, "the attack's own run cannot be trained"
    return folder


def write_lenses(folder: Path) -> None:
    folder.mkdir()
    fisheye = gsut.Camera("kannala_brandt", [90, 91, 50, 40, 0.01, -0.002, 1e-4, 2e-5], 100, 80)
    barrel = gsut.Camera("opencv5", [90, 91, 50, 40, -0.1, 0.02, 1e-3, -1e-3, 0], 100, 80)
    ocam = convert_camera(fisheye, "ocam").camera
    for name in LENSES:
        for camera in (fisheye, barrel, ocam):
            with contextlib.suppress(gsut.InputError):  # not a lens of this format
                gsut.save_camera(camera, folder / name)
                break
        assert (folder / name).is_file(), name
    for name, text in FOREIGN_FILES.items():
        (folder / name).write_text(text)


def write_tables(folder: Path) -> None:
    """Writes what some flags name: a camera path, positions, a mask, points, a picture."""
    poses = [np.eye(4).tolist() for _ in range(3)]
    (folder / "path.json").write_text(json.dumps({"camera_from_world": poses}))
    rows = (f"images/{i:03d}.png,{i},0.5,{i * i}" for i in range(rendered_dataset.VIEWS))
    (folder / "positions.csv").write_text("\n".join(["name,x,y,z", *rows]) + "\n")
    small_datasets.write_png(folder / "mask.png", np.full((48, 48), 255, np.uint8))
    small_datasets.write_ply(folder / "points.ply", *small_datasets.points())
    shutil.copy(folder / "ds/images/003.png", folder / "photo.png")
    gsut.save_camera(pinhole(48), folder / "lens48.json")
    gsut.save_camera(
        gsut.Camera("pinhole", [300, 300, 160, 120], 320, 240), folder / "lens320.json"
    )
    (folder / "rig.yaml").write_text(RIG)


def write_walked(place: Path) -> None:
    """A dataset of photographs with texture, whose poses gsut found."""
    words = ("poses", "film.mp4", "-o", str(place), "--camera", "lens320.json", "--quiet")
    with contextlib.redirect_stdout(io.StringIO()), enter_folder(place.parent):
        assert main(words) == 0, "the attack's own film cannot be used"


def write_boards(place: Path) -> None:
    place.mkdir()
    camera = gsut.Camera("kannala_brandt", [75, 75, 80, 60, 0.01, 0, 0, 0], 160, 120)
    board = synthetic_boards.Board(5, 4, 0.05)
    poses = synthetic_boards.random_poses(camera, board, 5, 35.0, np.random.default_rng(4))
    for number, pose in enumerate(poses):
        picture = synthetic_boards.draw(camera, board, pose)
        cv2.imwrite(str(place / f"{number:02d}.png"), picture)


def write_blocks(place: Path) -> None:
    """A run in blocks that was killed after its coarse model."""
    words = ("train", "ds", "-o", str(place), "--steps", STEPS, "--blocks", "2", "--quiet")
    with contextlib.redirect_stdout(io.StringIO()), enter_folder(place.parent):
        assert main(words) == 0, "the attack's own run in blocks cannot be trained"
    for name in ("report.html", "metrics.json", "scene.ply", "history.jsonl"):
        (place / name).unlink()
    for state in place.glob("blocks/b*/*.npz"):
        state.unlink()


def write_rig_images(place: Path) -> None:
    """Two cameras on a body, with their lenses and rig.json."""
    make_demo_rig(place, 6, RIG_SIZE, progress=False, path_share=0.1)


# What takes a while to make, and few cases need.
LATER: dict[str, Callable[[Path], object]] = {
    "walked": write_walked,
    "blocks": write_blocks,
    "boards": write_boards,
    "rig": write_rig_images,
    "walk.mp4": lambda place: small_videos.walk(place, 40),
}


def copy_needs(needs: tuple[str, ...], world: Path, scratch: Path) -> None:
    """Copies of what lies in the world, made now where nobody has needed it before."""
    for need in needs:
        source, target = world / need, scratch / need
        make = LATER.get(Path(need).parts[0])
        if make is not None and not (world / Path(need).parts[0]).exists():
            make(world / Path(need).parts[0])
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copy(source, target)
