"""Photographs that are much less sharp than their neighbours are left out, if asked for."""

import cv2
import numpy as np
import pytest

import gsut
from gsut.training.first import leave_out_blurred
from random_scenes import pinhole

VIEWS, BLURRED = 12, (3, 8)


@pytest.fixture
def scene(rng):
    """Photographs of one texture under noise, two of them moved while they were exposed."""
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (64, 64, 3)), (0, 0), 1.0)
    images = []
    for view in range(VIEWS):
        seen = np.roll(texture, 3 * view, axis=1)
        seen = cv2.blur(seen, (9, 1)) if view in BLURRED else seen
        images.append(np.clip(seen + rng.normal(0, 1, seen.shape), 0, 255).astype(np.uint8))
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    names = [f"frame_{view}.png" for view in range(VIEWS)]  # 10 sorts before 2
    return gsut.scene_from_arrays(images, pinhole(64), poses, names=names, test_every=0)


def test_blurred_photographs_are_left_out_and_named(scene):
    kept = leave_out_blurred(scene, gsut.TrainOptions(drop_blurred=True))
    left = [scene.views[i].name for i in set(scene.train_indices) - set(kept.train_indices)]
    assert sorted(left) == [f"frame_{view}.png" for view in BLURRED]
    assert any("frame_3.png" in note and "left out" in note for note in kept.notes)


def test_all_are_kept_unless_asked_for(scene):
    assert leave_out_blurred(scene, gsut.TrainOptions()) is scene


def test_photographs_alike_are_all_kept(scene):
    sharp = scene.replace(train_indices=[i for i, v in enumerate(scene.views)
                                         if int(v.name[6:-4]) not in BLURRED])  # fmt: skip
    assert leave_out_blurred(sharp, gsut.TrainOptions(drop_blurred=True)) is sharp
