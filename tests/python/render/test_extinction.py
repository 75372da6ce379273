"""The vector kernels' extinction against the double reference, on every instruction set."""

import dataclasses

import numpy as np
import pytest

import flips
import gsut
import tolerances
from gsut import InputError, _core
from random_scenes import (
    fisheye,
    gaussians_in_view,
    pinhole,
    random_pose,
    random_weights,
    relative_error,
)

FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))


def make_scene(rng, camera, pose, count=150, **options):
    g = gaussians_in_view(rng, camera, pose, count, sizes=(0.01, 0.3), opacity=0.5, **options)
    return dataclasses.replace(g, response="extinction")


def move(rng, pose):
    """A pair of poses some hundredths apart."""
    return pose, gsut.exp_pose(0.05 * rng.normal(size=6)) @ pose


@pytest.mark.parametrize("parity", [None, "gsplat", "3dgrut"])
@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
def test_extinction_every_isa_matches_double(rng, shutter, parity):
    camera, pose = fisheye(48), random_pose(rng)
    g = make_scene(rng, camera, pose)
    # From nearly nothing to more than float's alpha tells from 1.
    g.opacity_logits[:6] = (-5.5, -5.0, 8.0, 12.0, 30.0, 80.0)
    if shutter is not None:
        pose = move(rng, pose)
    options = {"shutter": shutter, "parity": parity, "background": (0.3, 0.1, 0.6)}
    expected = gsut.render(g, camera, pose, dtype="float64", **options)
    maximum = gsut.render(g, camera, pose, dtype="float64", response="maximum", **options)
    assert np.abs(expected.image - maximum.image).max() > 0.1
    bounds = (tolerances.RENDER_GRADIENT, tolerances.RENDER_POSE_GRADIENT)
    weights = random_weights(rng, camera)
    flips.assert_isas_match(g, camera, pose, expected, weights, FIELDS, bounds, **options)


def test_extinction_misses_no_gaussian_that_double_sees(rng):
    # Its cut-off lies farther out than the maximum's: bounds must follow.
    camera, pose = fisheye(64), random_pose(rng)
    g = make_scene(rng, camera, pose, count=300)
    g.opacity_logits[:] = 4.6
    rule = gsut.BlendRule()
    rule.transmittance_min = 0.0
    expected = gsut.render(g, camera, pose, dtype="float64", blend=rule)
    found = gsut.render(g, camera, pose, blend=rule)
    assert np.abs(found.alpha - expected.alpha).max() < 2 / 255
    flipped, _ = flips.flipped(found, expected)
    assert flipped.mean() < tolerances.EXTINCTION_FLIPS


@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
def test_extinction_same_bits_on_1_and_8_threads(rng, shutter):
    camera, pose = fisheye(70), random_pose(rng)
    g = make_scene(rng, camera, pose, count=2500, sh_degree=1)
    pose = pose if shutter is None else move(rng, pose)
    weights, seen = random_weights(rng, camera), []
    for threads in (1, 8):
        gsut.set_num_threads(threads)
        result = gsut.render(g, camera, pose, shutter=shutter)
        slopes = gsut.render_backward(result, *weights).gaussians
        seen.append((result.image.tobytes(), slopes.means.tobytes()))
    assert seen[0] == seen[1]


def test_extinction_features_are_blended_by_the_weights_of_the_image(rng):
    camera, pose = fisheye(32), random_pose(rng)
    g = make_scene(rng, camera, pose, sh_degree=0)
    g.sh[:] = np.abs(g.sh)
    colors = 0.5 + gsut.gaussians.SH_C0 * g.sh[:, 0]
    found = gsut.render(g, camera, pose, features=colors)
    assert np.abs(found.features - found.image).max() < tolerances.RENDER_CLOSED_FORM
    dfeatures = rng.normal(size=found.image.shape)
    slopes = gsut.render_backward(found, np.zeros_like(found.image), dfeatures=dfeatures)
    plain = gsut.render_backward(gsut.render(g, camera, pose), dfeatures)
    for field in ("means", "quats", "log_scales", "opacity_logits"):
        error = relative_error(getattr(slopes.gaussians, field), getattr(plain.gaussians, field))
        assert error < tolerances.RENDER_GRADIENT, (field, error)


def test_extinction_derivatives_of_colors_are_refused(rng):
    baseline = pytest.importorskip("gsut_scalar_baseline")
    camera, pose = pinhole(12), random_pose(rng)
    g = make_scene(rng, camera, pose, count=4, sh_degree=0, distances=(2.0, 3.0))
    pixels = np.arange(144, dtype=np.uint32)
    with pytest.raises(InputError, match="and for Gaussians by their maximum"):
        baseline.color_jacobian(g, _core.RenderJob(camera, pose), pixels)
