"""Pixels that no training view could see, worked out by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

import gsut
from gsut.evaluate.unseen import find_unseen

WIDTH, HEIGHT, FOCAL, WALL = 64, 32, 40.0, 5.0
CAMERA = gsut.Camera("pinhole", [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2], WIDTH, HEIGHT)


def make_scene(tmp_path, pose, train=(0,)):
    views = [
        gsut.View(f"{i}.png", tmp_path / f"{i}.png", 0, p) for i, p in enumerate((np.eye(4), pose))
    ]
    empty = np.zeros((0, 3))
    return gsut.Scene(tmp_path, (CAMERA,), tuple(views), empty, empty, train, (1,), np.zeros(3))


def show_wall(alpha):
    """A wall at z = WALL, of this alpha, as a camera that looks along z sees it."""
    rays = CAMERA.rays()[0]
    alpha = np.full((HEIGHT, WIDTH), alpha)
    return SimpleNamespace(alpha=alpha, depth=alpha * WALL / rays[..., 2])


@pytest.mark.parametrize("columns", [0, 16, 32, 80])
def test_unseen_columns_of_a_wall_are_those_beyond_the_training_view(tmp_path, columns):
    pose = np.eye(4)
    pose[0, 3] = -columns * WALL / FOCAL  # to the right by what so many columns show
    found = find_unseen(make_scene(tmp_path, pose), 1, show_wall(0.9))
    expected = np.broadcast_to(np.arange(WIDTH) >= WIDTH - columns, found.shape)
    assert np.array_equal(found, expected)


def test_nothing_is_unseen_that_is_far_away_in_a_shifted_view_or_seen_by_itself(tmp_path):
    pose = np.eye(4)
    pose[0, 3] = -5.0
    assert not find_unseen(make_scene(tmp_path, pose), 1, show_wall(0.1)).any()
    assert find_unseen(make_scene(tmp_path, pose), 1, show_wall(0.9)).any()
    assert not find_unseen(make_scene(tmp_path, pose, train=(0, 1)), 1, show_wall(0.9)).any()
