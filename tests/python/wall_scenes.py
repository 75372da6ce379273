"""Views of a wall with a pattern, through any lens and shutter, whose distance is known."""

from __future__ import annotations

import dataclasses

import numpy as np

import gsut
from gsut.data import Scene, scene_from_arrays
from gsut.lens import Camera

LENSES = {
    "pinhole": Camera("pinhole", [70.0, 70.0, 48.0, 32.0], 96, 64),
    "kannala_brandt": Camera("kannala_brandt", [38.0, 38.0, 40.0, 40.0, 0, 0, 0, 0], 80, 80),
}
CENTERS = np.array([[x, y, 0.0] for x in (-0.6, 0.0, 0.6) for y in (-0.3, 0.3)])
WALL = 3.0  # distance along z
READOUT = 0.12  # that a camera moves to the right while it reads a picture


def wall_scene(camera: Camera, *, rolling: bool = False, plain: bool = False) -> Scene:
    """Views of a wall with a pattern, without points; the camera moves while lines are read."""
    rays, valid = camera.rays()
    line = (np.arange(camera.height) + 0.5) / camera.height - 0.5
    moved = np.zeros((camera.height, 1, 3))
    moved[:, 0, 0] = READOUT * line if rolling else 0.0
    waves = np.random.default_rng(0).uniform(-9, 9, (30, 2))
    phases = np.arange(30.0)
    images = []
    for center in CENTERS:
        starts = center + moved
        with np.errstate(invalid="ignore", divide="ignore"):
            x, y, _ = np.moveaxis(starts + rays * WALL / rays[..., 2:], -1, 0)
        pattern = np.sin(np.stack([x, y], -1) @ waves.T + phases).sum(-1) / 12
        shown = valid & (rays[..., 2] > 0.3) & (not plain)
        grey = np.where(shown, np.clip(0.5 + 0.5 * pattern, 0, 1), 0.5)
        images.append(np.rint(255 * np.repeat(grey[..., None], 3, -1)).astype(np.uint8))
    poses = np.tile(np.eye(4), (len(CENTERS), 1, 1))
    poses[:, :3, 3] = -CENTERS
    scene = scene_from_arrays(images, camera, poses, test_every=0)
    if not rolling:
        return scene
    begun, ended = np.eye(4), np.eye(4)
    begun[0, 3], ended[0, 3] = READOUT / 2, -READOUT / 2
    shutter = gsut.Shutter("top_to_bottom")
    views = [
        dataclasses.replace(
            view, shutter=shutter, camera_from_world_start=begun @ view.camera_from_world,
            camera_from_world_end=ended @ view.camera_from_world,
        )
        for view in scene.views
    ]  # fmt: skip
    return scene.replace(views=views)
