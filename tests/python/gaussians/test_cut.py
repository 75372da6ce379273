"""Tests cutting, merging and levelling of scenes."""

import numpy as np
import pytest

from formats.scene_cases import plain_scene
from gsut import Gaussians, InputError
from gsut.edit import is_inside_box
from gsut.gaussians import (
    find_ground,
    merge_gaussians,
    rotate_upright,
)
from tolerances import GROUND_DEGREES, GROUND_LEVEL

FAR = np.array([4e5, -5e6, 120.0])


@pytest.mark.parametrize("origin", [np.zeros(3), FAR])
def test_box_keeps_what_lies_inside_in_world_coordinates(rng, origin):
    g = plain_scene(rng, 500).translate(origin)
    world = g.means.astype(np.float64)
    box = is_inside_box(g, np.add(origin, [-2, -3, -4]), np.add(origin, [5, 4, 3]))
    assert np.array_equal(box, np.all((world >= [-2, -3, -4]) & (world <= [5, 4, 3]), axis=1))
    assert 20 < box.sum() < 480


def test_merged_scenes_stand_where_they_stood(rng):
    a, b = plain_scene(rng, 30, 4).translate(FAR), plain_scene(rng, 20, 16).translate(FAR + 7)
    both = merge_gaussians([a, b])
    assert both.sh.shape == (50, 16, 3) and np.all(both.sh[:30, 4:] == 0)
    np.testing.assert_array_equal(both.origin, FAR)
    np.testing.assert_array_equal(both.means[:30], a.means)
    np.testing.assert_allclose(both.means[30:], b.means + 7, atol=1e-6)
    with pytest.raises(InputError, match="no scenes"):
        merge_gaussians([])


def room(rng, normal):
    """A floor, a table above it, walls and clutter; `normal` is up, the floor is 1.5 below zero."""

    def plane(count, height, size, thin):
        means = np.stack([*rng.uniform(-size, size, (2, count)), height(count)], axis=1)
        logs = np.log(np.tile([0.1, 0.1, 0.1], (count, 1)))
        logs[:, thin] = np.log(0.004)
        return means, logs

    parts = [
        plane(1500, lambda n: rng.normal(-1.5, 0.01, n), 4.0, 2),
        plane(300, lambda n: rng.normal(-0.7, 0.01, n), 0.8, 2),
        plane(800, lambda n: rng.uniform(-1.5, 1.5, n), 4.0, 0),
        plane(60, lambda n: rng.uniform(-4, 2, n), 4.0, 2),
    ]
    means, logs = (np.concatenate(each) for each in zip(*parts, strict=True))
    rotation = rotate_upright(normal).T @ rotate_upright([0.0, 0, 1])  # z up -> normal up
    w = 1 + np.trace(rotation)
    quat = np.array([w, *(rotation - rotation.T)[[2, 0, 1], [1, 2, 0]]])
    n = len(means)
    return Gaussians(
        means @ rotation.T, np.tile(quat, (n, 1)), logs, np.full(n, 2.0), np.zeros((n, 1, 3))
    )


def test_ground_is_found_from_an_up_that_is_15_degrees_off(rng):
    normal = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])
    g = room(rng, normal).translate(FAR)
    side = np.cross(normal, [1.0, 0, 0])
    tilted = normal + np.tan(np.radians(15)) * side / np.linalg.norm(side)
    found, level = find_ground(g, tilted)
    assert np.degrees(np.arccos(min(1.0, found @ normal))) <= GROUND_DEGREES
    assert abs(level - found @ FAR + 1.5) <= GROUND_LEVEL
    np.testing.assert_allclose(rotate_upright(found) @ found, [0, -1, 0], atol=1e-12)
    with pytest.raises(InputError, match="no ground"):
        find_ground(g[:2], normal)


@pytest.mark.parametrize("up", [[0, -1, 0], [0, 1, 0], [1, 2, 3], [0, 0, 1]])
def test_upright_turns_a_direction_to_minus_y(up):
    turn = rotate_upright(up)
    np.testing.assert_allclose(turn @ up / np.linalg.norm(up), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) > 0
