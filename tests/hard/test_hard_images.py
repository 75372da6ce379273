"""Hard cases 16 and 20: equal depths; images of one pixel, of odd sizes, of nothing."""

import numpy as np
import pytest
from precision_paths import FIELDS, blob, every_path, joined, run_every_path

import gsut
import tolerances
from random_scenes import (
    fisheye,
    gaussians_in_view,
    list_isas,
    no_gaussians,
    pinhole,
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


def test_camera_without_a_single_ray_gives_zeros(rng):
    # A lens trusted to 1e-6 degrees has no pixel centre inside its domain.
    camera = fisheye(32).with_valid_field_angle(1e-8)
    assert not camera.rays()[1].any()
    for outcome in run_every_path(blob(), camera, np.eye(4), random_weights(rng, camera)):
        assert np.all(outcome.result.image == 0) and np.all(outcome.gradients.pose == 0)


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


def test_equal_depths_keep_the_order_of_indices_in_every_path(rng):
    # Groups at exactly equal distances, interleaved: 64 Gaussians each, over a chunk's border.
    camera = pinhole(40)
    layers = 5
    g = gaussians_in_view(rng, camera, np.eye(4), 64 * layers, sh_degree=0, opacity=0.0)
    for layer in range(layers):
        g.means[layer::layers] = (0.0, 0.0, 2.0 + 0.25 * layer)
    g.log_scales[:] = rng.uniform(np.log(0.1), np.log(0.5), g.log_scales.shape)
    # The order shows: reversed, it is another image.
    image, turned = gsut.render(g, camera, np.eye(4)).image, g[::-1].copy()
    for path in every_path():
        gsut.machine.set_isa("" if path == "float64" else path)
        dtype = "float64" if path == "float64" else "float32"
        other = gsut.render(turned, camera, np.eye(4), dtype=dtype).image
        assert np.abs(other - image).max() > 0.05


def test_twenty_thousand_gaussians_on_one_spot_stay_exact(rng):
    # One tile's list is long, all others are empty; the order is by distance throughout.
    camera = pinhole(33)
    n = 20_000
    means = np.zeros((n, 3), np.float32)
    means[:, 2] = rng.permutation(np.linspace(2.0, 3.0, n))
    g = gsut.Gaussians(
        means, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), np.log(0.02)),
        np.full(n, -5.0), rng.normal(size=(n, 1, 3)),
    )  # fmt: skip
    opacity = 1 / (1 + np.exp(5.0))
    layers = int(np.ceil(np.log(1e-4) / np.log1p(-opacity)))
    truth = gsut.render(g, camera, np.eye(4), dtype="float64")
    assert truth.alpha.max() > 0.9998
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        result = gsut.render(g, camera, np.eye(4))
        assert np.abs(result.image - truth.image).max() < tolerances.HARD_LAYERS_IMAGE
        found = gsut.render_backward(result, np.ones((33, 33, 3)))
        # The middle pixels see the nearest ones only, until the stop.
        touched = np.sort(means[found.touched, 2])
        assert len(touched) >= layers * 0.9
        assert np.isfinite(found.gaussians.means).all()
