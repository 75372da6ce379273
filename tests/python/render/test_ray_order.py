"""The vector kernels' order along each pixel's ray against the double reference."""

import dataclasses

import numpy as np
import pytest
import test_order
from test_order import BLUE, RED

import gsut
import tolerances
from random_scenes import (
    fisheye,
    gaussians_in_view,
    list_isas,
    pinhole,
    random_pose,
    relative_error,
    small_camera,
)

BACKGROUND = (0.3, 0.1, 0.6)


def overlap(rng, camera, pose, count=200, **options):
    """Large Gaussians in one another, whose order differs from pixel to pixel."""
    shape = {"distances": (2.0, 3.0), "sizes": (0.03, 0.3), "opacity": 0.5, **options}
    return gaussians_in_view(rng, camera, pose, count, **shape)


def move(rng, pose):
    return pose, gsut.exp_pose(0.05 * rng.normal(size=6)) @ pose


def place(*args):
    """Gaussians at given places, by the largest response along the ray."""
    return test_order.place(*args, response="maximum")


def make_rule(parity=None):
    rule = gsut.BlendRule(parity or "")
    rule.order = "ray"
    return rule


def hold_to_double(g, camera, pose, **options):
    """Checks every instruction set; the double render, each set's, and pixels that flipped."""
    truth = gsut.render(g, camera, pose, dtype="float64", **options)
    drawn, flips = {}, np.zeros(truth.alpha.shape, bool)
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        drawn[isa] = found = gsut.render(g, camera, pose, **options)
        off = np.maximum(
            np.abs(found.image - truth.image).max(axis=2), np.abs(found.alpha - truth.alpha)
        )
        same = off < tolerances.RENDER_FLIP
        assert same.mean() >= 1 - tolerances.RAY_ORDER_FLIPS, (isa, same.mean())
        for name in ("image", "depth", "distortion"):
            found_values, true_values = getattr(found, name)[same], getattr(truth, name)[same]
            rms = np.sqrt(np.mean(np.square(found_values - true_values)))
            assert rms < tolerances.RENDER_IMAGE_RMS, (isa, name, rms)
        flips |= ~same
    return truth, drawn, flips


@pytest.mark.parametrize("model", ["orthographic", "cahvore"])
def test_ray_order_of_rays_without_one_origin_matches_double(rng, model):
    camera, pose = small_camera(model, 0, 24), random_pose(rng)
    g = overlap(rng, camera, pose)
    hold_to_double(g, camera, pose, order="ray")


def make_hard_cases():
    """Scenes in which no order of centres is right, or that make many Gaussians wait."""
    shared = test_order.make_hard_cases()
    names = "surfels that cross", "needles in a circle", "fog around a lamp"
    # The eye is inside all of them: none may be blended before the last is read.
    rng = np.random.default_rng(5)
    around, sizes = rng.normal((0, 0, 1), 0.5, (80, 3)), rng.uniform(0.6, 1.5, (80, 3))
    layers = np.stack([*np.zeros((2, 3000)), np.linspace(1, 9, 3000)], axis=1)
    return {
        **{name: dataclasses.replace(shared[name], response="maximum") for name in names},
        "the eye within eighty": place(around, sizes, [RED, BLUE] * 40, 0.05),
        "its mean behind the eye": place(
            [(0, 0, -0.5), (0, 0, 1)], [[2.0, 0.1, 2], [0.3] * 3], [RED, BLUE], 0.9,
            [(0.9, 0.2, 0.1, 0.3), (1, 0, 0, 0)],
        ),
        "three thousand layers": place(layers, (3, 3, 2e-4), [RED, BLUE] * 1500, 3e-3),
    }  # fmt: skip


def test_ray_order_of_hard_cases_matches_double():
    for name, g in make_hard_cases().items():
        camera = pinhole(9, focal=9.0) if len(g) < 1000 else pinhole(2, focal=40.0)
        rule = make_rule()
        rule.alpha_min = 1e-3
        truth, _, _ = hold_to_double(g, camera, np.eye(4), blend=rule)
        assert truth.alpha.max() > 0.2, name


def add_twins(slopes):
    return np.concatenate([slopes[:1] + slopes[-1:], slopes[1:-1]])


@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
@pytest.mark.parametrize("parity", [None, "gsplat"])
@pytest.mark.parametrize("kind", ["maximum", "extinction", "triangle"])
def test_ray_order_every_isa_matches_double_there_and_back(rng, kind, parity, shutter):
    camera, pose = fisheye(32, degrees=200.0), random_pose(rng)
    primitive = kind in gsut.Gaussians.PRIMITIVES
    changed = {"primitive": kind} if primitive else {"response": kind}
    g = dataclasses.replace(overlap(rng, camera, pose), **changed)
    pose = pose if shutter is None else move(rng, pose)
    # Two at one place: either may be in front, and the sum of their gradients counts.
    g = g[np.append(np.arange(len(g)), 0)]
    options = {"blend": make_rule(parity), "background": BACKGROUND, "shutter": shutter}
    exact, drawn, flips = hold_to_double(g, camera, pose, **options)
    other = gsut.render(g, camera, pose, **{**options, "blend": gsut.BlendRule(parity or "")})
    assert np.abs(other.image - exact.image).max() > 0.05  # the order matters here
    dimage, (dalpha, ddepth, dspread) = rng.normal(size=(32, 32, 3)), rng.normal(size=(3, 32, 32))
    for each in (dimage, dalpha, ddepth, dspread):
        each[flips] = 0.0
    # With the gradients to depths, and without.
    of_depth = {} if parity is None else {"ddepth": ddepth, "ddistortion": dspread}
    truth = gsut.render_backward(exact, dimage, dalpha, **of_depth)
    for isa, image in drawn.items():
        gsut.machine.set_isa(isa)
        found = gsut.render_backward(image, dimage, dalpha, **of_depth)
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            sums = (add_twins(getattr(each.gaussians, name)) for each in (found, truth))
            error = relative_error(*sums)
            assert error < tolerances.RENDER_GRADIENT, (isa, name, error)
        assert relative_error(found.pose, truth.pose) < tolerances.RENDER_POSE_GRADIENT, isa
