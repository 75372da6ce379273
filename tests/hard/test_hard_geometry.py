"""Hard cases 3, 4, 5, 9, 15, 18: where Gaussian and camera stand to each other."""

import numpy as np
import pytest
from precision_paths import FIELDS, run_every_path

import tolerances
from random_scenes import (
    blob,
    fisheye,
    joined,
    pinhole,
    random_weights,
)

LENSES = {
    "pinhole": pinhole(40),
    "fisheye 190": fisheye(48, degrees=190),
    "fisheye 270": fisheye(80, degrees=270),
    "fisheye 350": fisheye(112, degrees=350),
}


@pytest.mark.parametrize("lens", LENSES)
def test_gaussian_centred_on_the_camera_gives_nothing_and_no_nan(rng, lens):
    camera = LENSES[lens]
    pose = np.eye(4)
    pose[:3, 3] = (1.0, -2.0, 0.5)
    center = -pose[:3, 3]
    weights = random_weights(rng, camera)
    other = blob(mean=center + np.array([0.1, 0.2, 1.5]))
    alone = run_every_path(other, camera, pose, weights)
    both = run_every_path(joined(blob(mean=center), other), camera, pose, weights)
    for one, two in zip(alone, both, strict=True):
        assert np.array_equal(one.result.image, two.result.image)
        assert np.array_equal(one.gradients.pose, two.gradients.pose)
        for name in FIELDS:
            rows = getattr(two.gradients.gaussians, name)
            assert np.all(rows[0] == 0)
            assert np.array_equal(rows[1:], getattr(one.gradients.gaussians, name))


@pytest.mark.parametrize("factor", [1.0, 10.0, 1e3, 1e6])
def test_gaussian_larger_than_the_field_of_view_fills_the_image(rng, factor):
    # Far outside: the wall is flat and covers every ray that can meet it.
    for camera in (LENSES["pinhole"], LENSES["fisheye 190"]):
        g = blob(mean=(0.0, 0.0, 5.0), scale=(50 * factor, 50 * factor, 0.05), opacity=0.7)
        outcomes = run_every_path(g, camera, np.eye(4), random_weights(rng, camera))
        rays, valid = camera.rays()
        ahead = valid & (rays[..., 2] > 0.2)
        for outcome in outcomes:
            # Over a wall, alpha is the opacity times exp of minus half (x / scale)^2 at the wall.
            where = 5 * rays[..., :2] / rays[..., 2:]
            d2 = np.sum(where**2, axis=2) / (50 * factor) ** 2
            expected = 0.7 * np.exp(-0.5 * d2)
            error = np.abs(outcome.result.alpha - expected)[ahead].max()
            assert error < tolerances.HARD_WALL, (outcome.path, factor, error)
        assert ahead.sum() > 1000
