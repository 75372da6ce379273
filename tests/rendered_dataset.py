"""Writes a small dataset that gsut itself rendered from known Gaussians, for tests of training."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

import gsut
from gsut.gaussians import SH_C0
from random_scenes import pinhole
from small_datasets import write_ply

VIEWS = 12
EVERY_TEST = 6  # views 0 and 6 are held out
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def truth(rng: np.random.Generator, count: int = 60) -> gsut.Gaussians:
    """Opaque coloured blobs in a ball of radius 1 around the origin."""
    means = rng.normal(size=(count, 3))
    means *= (rng.uniform(0, 1, (count, 1)) ** (1 / 3)) / np.linalg.norm(
        means, axis=1, keepdims=True
    )
    return gsut.Gaussians(
        means.astype(np.float32),
        rng.normal(size=(count, 4)),
        np.log(rng.uniform(0.08, 0.25, (count, 3))),
        np.full(count, 2.5),
        rng.uniform(-1.5, 1.5, (count, 1, 3)),
    )


def poses() -> list[np.ndarray]:
    """Camera_from_world of cameras on a ring of radius 4 that look at the origin."""
    placed = []
    for i in range(VIEWS):
        angle = 2 * np.pi * i / VIEWS
        center = np.array([4 * np.cos(angle), 0.5 * np.sin(3 * angle), 4 * np.sin(angle)])
        placed.append(look_from(center))
    return placed


def look_from(center: np.ndarray) -> np.ndarray:
    """Camera_from_world of a camera that looks at the origin."""
    forward = -center / np.linalg.norm(center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ center
    return pose


def write_dataset(
    path: Path,
    rng: np.random.Generator,
    *,
    camera: gsut.Camera | None = None,
    with_points: bool = True,
    with_test: bool = True,
    mask: np.ndarray | None = None,
) -> Path:
    """A transforms.json with images, points and, if given, a mask.

    Args:
        camera: a pinhole, which is what the file says in any case; None: 48 x 48.
        with_points: writes the truth's centres, moved by 0.02, with their colours.
        with_test: names views 0 and 6 as the test split; else all views train.
        mask: (H, W) bool; True where pixels count.
    """
    camera = pinhole(48) if camera is None else camera
    g = truth(rng)
    (path / "images").mkdir(parents=True)
    frames = []
    for i, pose in enumerate(poses()):
        image = gsut.render(g, camera, pose).image
        name = f"images/{i:03d}.png"
        pixels = np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)
        cv2.imwrite(str(path / name), pixels[..., ::-1])
        world_from_camera = np.linalg.inv(pose) @ _OPENGL_FROM_OPENCV
        frame = {"file_path": name, "transform_matrix": world_from_camera.tolist()}
        if mask is not None:
            frame["mask_path"] = "mask.png"
        frames.append(frame)
    if mask is not None:
        cv2.imwrite(str(path / "mask.png"), 255 * mask.astype(np.uint8))
    fx, fy, cx, cy = camera.params[:4]
    names = [frame["file_path"] for frame in frames]
    test = names[::EVERY_TEST] if with_test else []
    content = {
        "camera_model": "PINHOLE", "w": camera.width, "h": camera.height,
        "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "frames": frames,
        "train_filenames": [name for name in names if name not in test], "test_filenames": test,
    }  # fmt: skip
    if with_points:
        points = g.means + 0.02 * rng.normal(size=g.means.shape)
        colors = 255 * np.clip(0.5 + g.sh[:, 0] * SH_C0, 0, 1)
        write_ply(path / "points3D.ply", points, np.round(colors))
        content["ply_file_path"] = "points3D.ply"
    (path / "transforms.json").write_text(json.dumps(content))
    return path
