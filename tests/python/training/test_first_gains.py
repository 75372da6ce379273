"""Gains of photographs from the scene's points alone, before anything is trained."""

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.render import Falloff, compute_field_angles
from gsut.training.first.gains import find_first_gains
from random_scenes import pinhole

VIEWS, HEIGHT = 10, 3.0
CAMERA = pinhole(64)
ANGLES = compute_field_angles(CAMERA)
FALLOFF = Falloff(float(ANGLES.max()), np.tile([-0.2, -0.1, 0.0], (3, 1)))


def wall_colors(x, y):
    """(n, 3) smooth colours of the wall z = HEIGHT."""
    return np.stack([0.3 + 0.1 * np.sin(k * x + y) * np.cos(y - k) for k in (1, 2, 3)], axis=-1)


def photographs(log_gains, bright_side=1.0):
    """A scene of views over a wall; the right half of each photograph times `bright_side`."""
    rng = np.random.default_rng(2)
    rays = CAMERA.rays()[0].astype(float)
    poses, images = [], []
    for view, gain in enumerate(np.exp(log_gains)):
        center = np.array([0.25 * view - 1.2, 0.2 * np.sin(view), 0.0])
        at = center + rays * (HEIGHT / rays[..., 2:])
        image = wall_colors(at[..., 0], at[..., 1]) * gain * FALLOFF.evaluate(ANGLES)
        image[:, CAMERA.width // 2 :] *= bright_side
        image += rng.normal(0.0, 0.01, image.shape)
        images.append(np.clip(np.rint(255 * image), 0, 255).astype(np.uint8))
        pose = np.eye(4)
        pose[:3, 3] = -center
        poses.append(pose)
    x, y = rng.uniform(-3, 3, (2, 900))
    points = np.stack([x, y, np.full(900, HEIGHT)], axis=1)
    return gsut.scene_from_arrays(images, CAMERA, np.array(poses), points=points, test_every=0)


def test_gains_are_found_under_falloff_and_noise():
    drift = 0.07 * np.sin(np.arange(VIEWS))[:, None] + 0.02 * np.cos(
        np.arange(VIEWS)[:, None] + [0, 1, 2]
    )
    drift -= drift.mean(axis=0)
    error = np.abs(find_first_gains(photographs(drift)) - drift).max()
    print("worst log-gain off by", error)
    assert error < tol.FIRST_GAIN


@pytest.mark.parametrize("bright_side", [1.0, 1.2])
def test_photographs_alike_give_none_whatever_is_uneven_within_them(bright_side):
    assert find_first_gains(photographs(np.zeros((VIEWS, 3)), bright_side)) is None


def test_few_points_or_views_say_nothing():
    scene = photographs(0.3 * np.sin(np.arange(VIEWS))[:, None] * np.ones(3))
    assert find_first_gains(scene) is not None
    assert find_first_gains(scene.replace(points=scene.points[:20])) is None
    assert find_first_gains(scene.replace(train_indices=(0, 1, 2))) is None
