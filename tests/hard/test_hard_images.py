"""Hard cases 16 and 20: equal depths; images of one pixel, of odd sizes, of nothing."""

import numpy as np
import pytest
from precision_paths import FIELDS, run_every_path

import gsut
from random_scenes import (
    blob,
    fisheye,
    gaussians_in_view,
    joined,
    no_gaussians,
    random_pose,
    random_weights,
)


def test_nothing_to_draw_gives_the_background_and_gradient_zero(rng):
    camera = fisheye(50)
    _, valid = camera.rays()
    background = np.array([0.1, 0.6, 0.9])
    behind = blob((0.0, 0.0, -5.0), 0.1)
    transparent = blob(opacity=1e-4)
    for g in (no_gaussians(), behind, transparent, joined(behind, transparent)):
        outcomes = run_every_path(
            g, camera, np.eye(4), random_weights(rng, camera), background=background
        )
        for outcome in outcomes:
            assert outcome.result.image[valid] == pytest.approx(
                np.tile(background, (valid.sum(), 1))
            )
            assert np.all(outcome.result.image[~valid] == 0)
            assert np.all(outcome.result.alpha == 0) and np.all(outcome.result.depth == 0)
            for name in FIELDS:
                assert np.all(getattr(outcome.gradients.gaussians, name) == 0)
            assert np.all(outcome.gradients.pose == 0)


@pytest.mark.parametrize(
    "camera",
    [
        fisheye(48, degrees=120),
        gsut.Camera("opencv4", [40, 40, 40, 40, -0.3, 0, 0, 0], 80, 80, valid_field_angle=0.6),
    ],
    ids=lambda camera: camera.model,
)
def test_pixels_without_a_ray_take_no_part_in_gradients(rng, camera):
    # Whatever the loss says about them.
    pose = random_pose(rng)
    _, valid = camera.rays()
    assert 100 < (~valid).sum() < valid.size - 500
    g = gaussians_in_view(rng, camera, pose, 50)
    weights = random_weights(rng, camera)
    spoiled = [w.copy() for w in weights]
    for w in spoiled:
        w[~valid] = 1e6
    clean = run_every_path(g, camera, pose, weights)
    found = run_every_path(g, camera, pose, spoiled)
    for one, other in zip(clean, found, strict=True):
        assert np.array_equal(one.gradients.pose, other.gradients.pose)
        for name in FIELDS:
            assert np.array_equal(
                getattr(one.gradients.gaussians, name), getattr(other.gradients.gaussians, name)
            )
