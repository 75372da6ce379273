"""Small valid inputs of every kind, made once; each case spoils a copy."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import numpy as np

import gsut
import rendered_dataset
import small_datasets
import small_recordings
import small_videos
from attack.harness import inside
from formats.scene_cases import plain_scene
from gsut import formats
from gsut.cli import main
from gsut.lens import convert_camera

STEPS = "20"
LENSES = ("gsut.lens.json", "opencv.yaml", "opencv.json", "camchain.yaml", "cameras.txt",
          "cameras.bin", "transforms.json", "aria.json", "matlab.json", "camera_models.json",
          "calibration.xml", "lens.cameramodel", "calib_results.txt")  # fmt: skip
SCENES = ("a.ply", "b.compressed.ply", "c.spz", "d.sog", "e.glb", "f.splat")


def make_world(folder: Path) -> Path:
    """Datasets of every layout, a finished run, scene files, lens files, a film, tables."""
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
    with contextlib.redirect_stdout(io.StringIO()), inside(folder):
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
                camera.save(folder / name)
                break
        assert (folder / name).is_file(), name


def write_tables(folder: Path) -> None:
    """What some flags name: a camera path, positions, a mask, points, a picture."""
    poses = [np.eye(4).tolist() for _ in range(3)]
    (folder / "path.json").write_text(json.dumps({"camera_from_world": poses}))
    rows = (f"images/{i:03d}.png,{i},0.5,{i * i}" for i in range(rendered_dataset.VIEWS))
    (folder / "positions.csv").write_text("\n".join(["name,x,y,z", *rows]) + "\n")
    small_datasets.write_png(folder / "mask.png", np.full((48, 48), 255, np.uint8))
    small_datasets.write_ply(folder / "points.ply", *small_datasets.points())
    small_datasets.write_png(folder / "photo.png", small_datasets.texture(np.ones((48, 48, 2))))
