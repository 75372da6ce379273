"""Gradients to lenses and rays: central differences, gsplat's vectors, float against double."""

import numpy as np
import pytest

import gsut
import tolerances
from random_scenes import (
    central_differences,
    gaussians_in_view,
    loss_of,
    open_rule,
    random_pose,
    relative_error,
    small_camera,
)

# One of each kind: radial, rational, prisms, two spheres, polynomials, moving pupil, parallel rays.
LENSES = (
    *("pinhole", "opencv12", "kannala_brandt", "fisheye624", "double_sphere", "mei"),
    *("cahvor", "cahvore", "orthographic", "stereographic"),
)
STEP = 1e-5  # of central differences, relative to a parameter's size


def scene(rng, camera, count=60):
    pose = random_pose(rng)
    return gaussians_in_view(rng, camera, pose, count), pose


def inner_weights(rng, camera):
    """Weights on pixels that have a ray for all nearby lenses: valid with all their neighbours."""
    _, valid = camera.rays()
    inner = valid.copy()
    for axis in (0, 1):
        for shift in (-2, 2):
            inner &= np.roll(valid, shift, axis)
    shape = (camera.height, camera.width)
    return [
        rng.normal(size=(*shape, *tail)) * inner.reshape(*shape, *[1] * len(tail))
        for tail in ((3,), (), ())
    ]


@pytest.mark.parametrize("model", LENSES)
def test_lens_gradient_double_equals_central_differences(rng, model):
    camera = small_camera(model, width=24)
    g, pose = scene(rng, camera)
    weights = inner_weights(rng, camera)
    if model == "cahvore":
        weights[2][:] = 0  # how its rays' starts slide along them is not differentiated
    rule = open_rule()

    def loss(lens):
        return loss_of(gsut.render(g, lens, pose, blend=rule, dtype="float64"), weights)

    result = gsut.render(g, camera, pose, blend=rule, dtype="float64")
    found = gsut.render_backward(result, *weights, with_lens=True)
    assert found.lens.shape == (len(camera.params),)
    expected, steps = np.zeros(len(camera.params)), np.zeros(len(camera.params))
    for k, value in enumerate(camera.params):
        if found.lens[k] == 0.0:
            continue  # a number that counts or switches
        step = STEP * max(1e-2, abs(value))
        sides = []
        for sign in (1, -1):
            params = list(camera.params)
            params[k] += sign * step
            sides.append(loss(gsut.Camera(model, params, camera.width, camera.height)))
        expected[k] = (sides[0] - sides[1]) / (2 * step)
        steps[k] = max(1e-2, abs(value))
    assert (expected != 0).sum() >= 4
    # Parameters have units of their own: compared as changes of the loss by relative changes.
    assert relative_error(found.lens * steps, expected * steps) < tolerances.LENS_OF_IMAGE_GRADIENT


@pytest.mark.parametrize("model", LENSES)
def test_lens_gradient_float_equals_double(rng, model):
    camera = small_camera(model)
    g, pose = scene(rng, camera, 200)
    weights = inner_weights(rng, camera)
    exact = gsut.render(g, camera, pose, dtype="float64")
    expected = gsut.render_backward(exact, *weights, with_lens=True)
    result = gsut.render(g, camera, pose)
    found = gsut.render_backward(result, *weights, with_lens=True)
    size = np.maximum(1e-2, np.abs(camera.params))
    assert np.abs(expected.lens).max() > 0
    error = relative_error(found.lens * size, expected.lens * size)
    assert error < tolerances.LENS_OF_IMAGE_FLOAT
    rays, valid = camera.rays()
    assert relative_error(found.rays, expected.rays) < tolerances.RAYS_FLOAT
    across = np.abs((found.rays * rays).sum(axis=2))[valid]
    assert across.max() < 1e-6 * np.abs(found.rays).max()
    assert np.all(found.rays[~valid] == 0)


def test_lens_gradient_is_left_out_unless_asked_for(rng):
    camera = small_camera("kannala_brandt")
    g, pose = scene(rng, camera)
    weights = np.ones((camera.height, camera.width, 3))
    for dtype in ("float32", "float64"):
        result = gsut.render(g, camera, pose, dtype=dtype)
        plain = gsut.render_backward(result, weights)
        assert plain.lens is None and plain.rays is None
        asked = gsut.render_backward(result, weights, with_lens=True)
        assert np.array_equal(asked.gaussians.means, plain.gaussians.means)
        assert np.array_equal(asked.pose, plain.pose)


def test_lens_gradient_with_a_rolling_shutter_equals_central_differences(rng):
    camera = small_camera("opencv12", width=24)
    g, pose = scene(rng, camera)
    end = gsut.exp_pose(rng.normal(0, 0.02, 6)) @ pose
    weights, rule = inner_weights(rng, camera), open_rule()

    def render(lens):
        return gsut.render(
            g, lens, (pose, end), shutter="top_to_bottom", blend=rule, dtype="float64"
        )

    found = gsut.render_backward(render(camera), *weights, with_lens=True)
    ran, params = 0, np.array(camera.params)
    for k in range(4):
        (expected,) = central_differences(
            lambda: loss_of(render(camera.with_params(params)), weights),
            params, [k], STEP * camera.params[k],
        )  # fmt: skip
        tolerance = tolerances.LENS_OF_IMAGE_GRADIENT * np.abs(found.lens[:4]).max()
        assert abs(found.lens[k] - expected) < tolerance
        ran += 1
    assert ran == 4
