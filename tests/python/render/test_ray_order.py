"""The vector kernels' order along each pixel's ray against the double reference."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError
from random_scenes import (
    fisheye,
    gaussians_in_view,
    pinhole,
    random_pose,
    relative_error,
    small_camera,
)

RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
BACKGROUND = (0.3, 0.1, 0.6)


def overlap(rng, camera, pose, count=200, **options):
    """Large Gaussians in one another, whose order differs from pixel to pixel."""
    shape = {"distances": (2.0, 3.0), "sizes": (0.03, 0.3), "opacity": 0.5, **options}
    return gaussians_in_view(rng, camera, pose, count, **shape)


def move(rng, pose):
    return pose, gsut.exp_pose(0.05 * rng.normal(size=6)) @ pose


def place(means, scales, colors, opacity, turns=None):
    n = len(means)
    sh = ((np.asarray(colors, np.float64) - 0.5) * np.sqrt(4 * np.pi)).reshape(n, 1, 3)
    quats = np.tile([1.0, 0, 0, 0], (n, 1)) if turns is None else turns
    opacity = np.broadcast_to(opacity, n)
    scales = np.broadcast_to(np.asarray(scales, np.float64), (n, 3))
    logits = np.log(opacity) - np.log1p(-opacity)
    return gsut.Gaussians(means, quats, np.log(scales), logits, sh)


def make_rule(parity=None):
    rule = gsut.BlendRule(parity or "")
    rule.order = "ray"
    return rule


def hold_to_double(g, camera, pose, flips, **options):
    """Checks every instruction set; returns how many were."""
    truth = gsut.render(g, camera, pose, dtype="float64", **options)
    sets = gsut.machine.available_isas()
    for isa in sets:
        gsut.machine.set_isa(isa)
        found = gsut.render(g, camera, pose, **options)
        off = np.maximum(
            np.abs(found.image - truth.image).max(axis=2), np.abs(found.alpha - truth.alpha)
        )
        same = off < tolerances.RENDER_FLIP
        assert same.mean() >= 1 - flips, (isa, same.mean())
        for name in ("image", "depth", "distortion"):
            found_values, true_values = getattr(found, name)[same], getattr(truth, name)[same]
            rms = np.sqrt(np.mean(np.square(found_values - true_values)))
            assert rms < tolerances.RENDER_IMAGE_RMS, (isa, name, rms)
    return truth, len(sets)


@pytest.mark.parametrize("parity", [None, "gsplat"])
@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
@pytest.mark.parametrize("response", ["maximum", "extinction"])
def test_ray_order_every_isa_matches_double(rng, response, shutter, parity):
    camera, pose = fisheye(32, degrees=200.0), random_pose(rng)
    g = dataclasses.replace(overlap(rng, camera, pose), response=response)
    pose = pose if shutter is None else move(rng, pose)
    options = {"shutter": shutter, "background": BACKGROUND}
    flips = tolerances.RAY_ORDER_FLIPS
    truth, ran = hold_to_double(g, camera, pose, flips, blend=make_rule(parity), **options)
    assert ran == len(gsut.machine.available_isas())
    other = gsut.render(g, camera, pose, parity=parity, **options)
    assert np.abs(other.image - truth.image).max() > 0.05  # the order matters here


@pytest.mark.parametrize("model", ["orthographic", "cahvore"])
def test_ray_order_of_rays_without_one_origin_matches_double(rng, model):
    camera, pose = small_camera(model, 0, 24), random_pose(rng)
    g = overlap(rng, camera, pose)
    _, valid = camera.rays()
    starts = camera.origins()[valid][rng.integers(int(valid.sum()), size=len(g))]
    if camera.is_parallel:
        starts[:, 2] = 0
    g.means = (g.means + starts @ pose[:3, :3]).astype(np.float32)
    _, ran = hold_to_double(g, camera, pose, tolerances.RAY_ORDER_FLIPS, order="ray")
    assert ran == len(gsut.machine.available_isas())


def make_hard_cases():
    """Scenes in which no order of centres is right, or that make many Gaussians wait."""
    angles = np.radians([0, 120, 240])
    ring = np.stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.full(3, 3.0)], axis=1)
    tilt = np.array([[np.cos(a / 2), 0, np.sin(a / 2), 0] for a in (np.pi / 4, -np.pi / 4)])
    lean = np.array([[np.cos(a / 2), 0, 0, np.sin(a / 2)] for a in angles + np.pi / 2])
    turns = np.stack(
        [lean[:, 0], -0.17 * lean[:, 3], 0.17 * lean[:, 0], lean[:, 3]], axis=1
    )  # about their own second axis, so that one end is nearer
    rng = np.random.default_rng(5)
    lamp = np.concatenate([[(0, 0, 3.0)], rng.normal((0, 0, 3), 0.05, (20, 3))])
    # The eye is inside all of them: none may be blended before the last is read.
    around = rng.normal((0, 0, 1), 0.5, (80, 3))
    layers = np.stack([*np.zeros((2, 3000)), np.linspace(1, 9, 3000)], axis=1)
    return {
        "surfels that cross": place([(0, 0, 3)] * 2, (1, 1, 1e-4), [RED, BLUE], 0.9, tilt),
        "needles in a circle": place(ring, (0.8, 0.05, 0.05), np.eye(3), 0.9, turns),
        "fog around a lamp": place(
            lamp, np.array([[1.5] * 3] + [[0.01] * 3] * 20), [RED] + [BLUE] * 20,
            [0.5] + [0.99] * 20,
        ),
        "the eye within eighty": place(
            around, rng.uniform(0.6, 1.5, (80, 3)), [RED, BLUE] * 40, 0.05
        ),
        "its mean behind the eye": place(
            [(0, 0, -0.5), (0, 0, 1)], [[2.0, 0.1, 2], [0.3] * 3], [RED, BLUE], 0.9,
            [(0.9, 0.2, 0.1, 0.3), (1, 0, 0, 0)],
        ),
        "three thousand layers": place(layers, (3, 3, 2e-4), [RED, BLUE] * 1500, 3e-3),
    }  # fmt: skip


def test_ray_order_of_hard_cases_matches_double():
    cases, ran = make_hard_cases(), 0
    for name, g in cases.items():
        camera = pinhole(9, focal=9.0) if len(g) < 1000 else pinhole(2, focal=40.0)
        rule = make_rule()
        rule.alpha_min = 1e-3
        truth, sets = hold_to_double(g, camera, np.eye(4), tolerances.RAY_ORDER_FLIPS, blend=rule)
        assert truth.alpha.max() > 0.2, name
        ran += sets
    assert ran == 6 * len(gsut.machine.available_isas())


@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
def test_ray_order_has_the_same_bits_on_1_and_8_threads(rng, shutter):
    camera, pose = fisheye(70), random_pose(rng)
    g = overlap(rng, camera, pose, count=2500)
    pose = pose if shutter is None else move(rng, pose)
    seen = set()
    for threads in (1, 8):
        gsut.set_num_threads(threads)
        found = gsut.render(g, camera, pose, shutter=shutter, order="ray")
        bits = found.image.tobytes() + found.depth.tobytes()
        slopes = gsut.render_backward(found, found.image)
        seen.add(bits + slopes.gaussians.means.tobytes() + slopes.pose.tobytes())
    assert len(seen) == 1


def test_ray_order_of_tiles_left_out_shows_the_background(rng):
    camera, pose = fisheye(40), random_pose(rng)
    g = overlap(rng, camera, pose)
    whole = gsut.render(g, camera, pose, order="ray").image
    tiles = np.ones((3, 3), np.uint8)
    tiles[1, 1] = 0
    job = gsut._core.RenderJob(camera, pose, rule=make_rule(), tiles=tiles)
    image = np.zeros_like(whole)
    gsut._core.Renderer().render(g, job, image)
    assert not image[16:32, 16:32].any() and whole[16:32, 16:32].any()
    image[16:32, 16:32] = whole[16:32, 16:32]
    assert image.tobytes() == whole.tobytes()


def add_twins(slopes):
    return np.concatenate([slopes[:1] + slopes[-1:], slopes[1:-1]])


@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
@pytest.mark.parametrize("parity", [None, "gsplat"])
@pytest.mark.parametrize("kind", ["maximum", "extinction", "triangle"])
def test_ray_order_backward_every_isa_matches_double(rng, kind, parity, shutter):
    camera, pose = fisheye(32, degrees=200.0), random_pose(rng)
    primitive = kind in gsut.Gaussians.PRIMITIVES
    changed = {"primitive": kind} if primitive else {"response": kind}
    g = dataclasses.replace(overlap(rng, camera, pose), **changed)
    pose = pose if shutter is None else move(rng, pose)
    # Two at one place: either may be in front, and the sum of their gradients counts.
    g = g[np.append(np.arange(len(g)), 0)]
    options = {"blend": make_rule(parity), "background": BACKGROUND, "shutter": shutter}
    exact = gsut.render(g, camera, pose, dtype="float64", **options)
    dimage, (dalpha, ddepth, dspread) = rng.normal(size=(32, 32, 3)), rng.normal(size=(3, 32, 32))
    drawn = {}
    for isa in gsut.machine.available_isas():
        gsut.machine.set_isa(isa)
        drawn[isa] = gsut.render(g, camera, pose, **options)
    off = [np.abs(image.image - exact.image).max(axis=2) for image in drawn.values()]
    flips = np.max(off, axis=0) > tolerances.RENDER_FLIP
    assert flips.mean() < tolerances.RAY_ORDER_FLIPS
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


@pytest.mark.parametrize(
    "use",
    [
        lambda g, image: gsut.rendering.measure_depth(image, "median"),
        lambda g, image: gsut.render(
            g, image.camera, np.eye(4), order="ray", features=g.means.astype(np.float32)
        ),
    ],
    ids=["depth", "features"],
)
def test_ray_order_in_float32_says_what_it_has_not(rng, use):
    camera = pinhole(8)
    g = overlap(rng, camera, np.eye(4), count=3)
    image = gsut.render(g, camera, np.eye(4), order="ray")
    with pytest.raises(InputError, match=r"order \"ray\".*distance"):
        use(g, image)
