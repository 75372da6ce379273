"""Hard cases 3, 4, 5, 9, 15, 18: where Gaussian and camera stand to each other."""

import numpy as np
import pytest
from precision_paths import FIELDS, blob, joined, run_every_path

import gsut
import tolerances
from random_scenes import (
    fisheye,
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


def test_mirrored_hit_behind_the_camera_has_no_response_and_no_gradient(rng):
    # A narrow Gaussian behind a 190-degree fisheye: its line meets every mirrored ray.
    camera = LENSES["fisheye 190"]
    weights = random_weights(rng, camera)
    for _ in range(50):
        angle, azimuth = rng.uniform(np.radians(125), np.pi), rng.uniform(0, 2 * np.pi)
        direction = 2 * np.array(
            [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
        )
        g = blob(mean=direction, scale=rng.uniform(0.01, 0.15, 3), quat=rng.normal(size=4))
        for outcome in run_every_path(g, camera, np.eye(4), weights):
            assert np.all(outcome.result.alpha == 0) and np.all(outcome.result.depth == 0)
            for name in FIELDS:
                assert np.all(getattr(outcome.gradients.gaussians, name) == 0)
            assert np.all(outcome.gradients.pose == 0)


def test_field_beyond_180_degrees_is_ordered_by_distance_and_never_culled_by_z(rng):
    camera = LENSES["fisheye 270"]
    weights = random_weights(rng, camera)
    for degrees in (92.0, 100.0, 120.0, 130.0):
        angle = np.radians(degrees)
        for azimuth in np.radians([0, 70, 200]):
            direction = np.array(
                [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
            )
            # By z the far one would come first: its z is more negative.
            near = blob(mean=2 * direction, scale=0.3, color=(1, 0, 0))
            far = blob(mean=4 * direction, scale=0.6, color=(0, 0, 1))
            assert far.means[0, 2] < near.means[0, 2] < 0
            pixel, valid = camera.project(direction[None])
            assert valid[0]
            column, row = np.floor(pixel[0]).astype(int)
            outcomes = run_every_path(joined(far, near), camera, np.eye(4), weights)
            for outcome in outcomes:
                red, _, blue = outcome.result.image[row, column]
                assert red == pytest.approx(0.6, abs=0.02)
                assert blue == pytest.approx(0.24, abs=0.02)


def test_gaussian_on_the_axis_ahead_and_behind_is_a_round_spot(rng):
    # Exactly at theta = 0 and, through a 350-degree lens, 2 degrees from theta = 180.
    camera = fisheye(113, degrees=350)  # an odd size: the axis hits a pixel's centre
    weights = random_weights(rng, camera)
    for offset in (0.0, 1e-30, 1e-12, 1e-6, 1e-3):
        g = blob(mean=(offset, -offset, 2.0), scale=0.2)
        outcomes = run_every_path(g, camera, np.eye(4), weights)
        for outcome in outcomes:
            alpha = outcome.result.alpha
            assert alpha[56, 56] == pytest.approx(0.6, abs=1e-3)
            if offset < 1e-6:
                for turned in (alpha.T, alpha[::-1], alpha[:, ::-1]):
                    assert np.abs(alpha - turned).max() < tolerances.HARD_ALPHA
    behind = blob(mean=(0.0, 0.0, -2.0), scale=0.5)
    rim = gsut.render(behind, camera, np.eye(4)).alpha
    assert rim.max() > 0.55 and (rim > 0.1).sum() > 300  # a ring along the circle
