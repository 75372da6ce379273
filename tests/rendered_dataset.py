"""Writes a small dataset that gsut itself rendered from known Gaussians, for tests of training."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import cv2
import numpy as np

import gsut
from gsut.data import Frame, write_transforms
from gsut.gaussians import SH_C0
from random_scenes import pinhole
from small_datasets import write_ply

VIEWS = 12
EVERY_TEST = 6  # views 0 and 6 are held out


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


def write_views(
    path: Path,
    g: gsut.Gaussians,
    camera: gsut.Camera,
    poses: Sequence[np.ndarray],
    *,
    points: np.ndarray | None = None,
    test: Collection[int] = (),
    mask: np.ndarray | None = None,
    stated: Sequence[np.ndarray] | None = None,
) -> Path:
    """Renders Gaussians from these poses into images, and writes a transforms.json beside them.

    Args:
        points: (N, 3) places of the Gaussians, which are written with their colours.
        test: numbers of the views that are held out.
        mask: (H, W) bool; True where pixels count.
        stated: the poses that the file states; None: the true ones.
    """
    (path / "images").mkdir(parents=True)
    masked = None if mask is None else path / "mask.png"
    if mask is not None:
        cv2.imwrite(str(masked), 255 * mask.astype(np.uint8))
    frames = []
    for number, (pose, said) in enumerate(zip(poses, stated or poses, strict=True)):
        file = path / f"images/{number:03d}.png"
        image = np.round(255 * np.clip(gsut.render(g, camera, pose).image, 0, 1))
        cv2.imwrite(str(file), image.astype(np.uint8)[..., ::-1])
        placed = np.linalg.inv(said)
        frames.append(Frame(f"images/{file.name}", file, camera, placed, mask_path=masked))
    if points is not None:
        colors = np.round(255 * np.clip(0.5 + g.sh[:, 0] * SH_C0, 0, 1))
        write_ply(path / "points3D.ply", points, colors)
    names = [frames[number].name for number in test]
    points_file = None if points is None else "points3D.ply"
    write_transforms(path / "transforms.json", frames, points_file=points_file, test=names)
    return path


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
        camera: None: a pinhole of 48 x 48.
        with_points: writes the truth's centres, moved by 0.02, with their colours.
        with_test: names views 0 and 6 as the test split; else all views train.
        mask: (H, W) bool; True where pixels count.
    """
    g = truth(rng)
    points = g.means + 0.02 * rng.normal(size=g.means.shape) if with_points else None
    test = range(0, VIEWS, EVERY_TEST) if with_test else ()
    return write_views(path, g, camera or pinhole(48), poses(), points=points, test=test, mask=mask)
