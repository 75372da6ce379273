"""Writes a small fisheye dataset inside a room of blobs, whose images fix poses and lens well."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import gsut
from random_scenes import fisheye
from rendered_dataset import write_views

VIEWS = 14
TEST = (3, 10)


def room(rng: np.random.Generator, count: int = 200) -> gsut.Gaussians:
    """Opaque coloured blobs all around the origin, 2.5 to 4 units away."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return gsut.Gaussians(
        (direction * rng.uniform(2.5, 4.0, (count, 1))).astype(np.float32),
        rng.normal(size=(count, 4)),
        np.log(rng.uniform(0.15, 0.5, (count, 3))),
        np.full(count, 3.0),
        rng.uniform(-1.5, 1.5, (count, 1, 3)),
    ).to_dtype(np.float32)


def room_poses(rng: np.random.Generator) -> list[np.ndarray]:
    """Camera_from_world of cameras near the origin, turned every way by some tens of degrees."""
    return [
        gsut.exp_pose(np.concatenate([rng.uniform(-0.8, 0.8, 3), rng.normal(0, 0.4, 3)]))
        for _ in range(VIEWS)
    ]


def write_room(path: Path, rng: np.random.Generator, width: int = 64) -> Path:
    """A transforms.json with images and points; views 3 and 10 are held out."""
    lens = fisheye(width, degrees=180.0)
    camera = gsut.Camera(
        lens.model, [*lens.params[:4], 0.02, -0.005, 0.0, 0.0][: 4 + 4], width, width,
        valid_field_angle=lens.valid_field_angle,
    )  # fmt: skip
    g = room(rng)
    placed = room_poses(rng)
    points = g.means + 0.02 * rng.normal(size=g.means.shape)
    return write_views(path, g, camera, placed, points=points, test=TEST)
