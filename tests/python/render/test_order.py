"""Orders and responses of the double reference, by second implementations and closed forms."""

import dataclasses

import numpy as np
import pytest

import gsut
import ray_model
import tolerances
from gsut import InputError
from random_scenes import (
    fisheye,
    gaussians_in_view,
    hold_to_differences,
    open_rule,
    pinhole,
    random_pose,
    random_weights,
)

pytestmark = pytest.mark.quick

FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))
RESPONSES = ("maximum", "extinction", "density")
WHITE = 0.5 * np.sqrt(4 * np.pi)  # the first harmonic of colour 1
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def overlapping(rng, camera, response, count=25, **options):
    """Large Gaussians in one another, whose order differs from pixel to pixel."""
    pose = random_pose(rng)
    shape = {"distances": (2.0, 3.0), "sizes": (0.1, 0.3), "opacity": 0.5, **options}
    g = gaussians_in_view(rng, camera, pose, count, **shape).to_dtype(np.float64)
    return dataclasses.replace(g, response=response), pose


def make_rule(order, base=None):
    rule = base or gsut.BlendRule()
    rule.order = order
    return rule


def render(g, camera, pose, **options):
    return gsut.render(g, camera, pose, dtype="float64", **options)


def place(means, scales, colors, opacity=0.9, turns=None, response="extinction"):
    """Gaussians at given places with given scales and colours, seen along z from the origin."""
    n = len(means)
    sh = ((np.asarray(colors, np.float64) - 0.5) * np.sqrt(4 * np.pi)).reshape(n, 1, 3)
    quats = np.tile([1.0, 0, 0, 0], (n, 1)) if turns is None else np.asarray(turns, np.float64)
    logits = np.broadcast_to(np.log(opacity) - np.log1p(-np.asarray(opacity)), n).astype(float)
    scales = np.broadcast_to(np.asarray(scales, np.float64), (n, 3))
    means = np.asarray(means, np.float64)
    return gsut.Gaussians(means, quats, np.log(scales), logits, sh, response=response)


@pytest.mark.parametrize("order", ["distance", "z", "ray"])
@pytest.mark.parametrize("response", RESPONSES)
def test_render_double_every_order_and_response_matches_a_second_implementation(
    rng, order, response
):
    camera = fisheye(20, degrees=200.0)  # Gaussians at 100 degrees from the axis
    g, pose = overlapping(rng, camera, response, count=60)
    found = render(g, camera, pose, order=order, background=(0.2, 0.5, 0.9))
    expected = ray_model.render(g, camera, pose, make_rule(order), (0.2, 0.5, 0.9))
    for name, values in zip(("image", "alpha", "depth"), expected, strict=True):
        assert np.abs(getattr(found, name) - values).max() < tolerances.RENDER_DOUBLE
    other = render(g, camera, pose, order="z" if order == "distance" else "distance")
    assert np.abs(found.image - other.image).max() > 0.01  # the order matters here


@pytest.mark.parametrize("response", RESPONSES)
def test_render_backward_along_the_ray_matches_central_differences(rng, response):
    # The order is that of the unmoved ray at both ends: steps are far smaller than the gaps.
    camera = fisheye(12)
    g, pose = overlapping(rng, camera, response, count=6, sizes=(0.05, 0.1), aspect=0.3)
    checked = hold_to_differences(
        g, camera, pose, random_weights(rng, camera), tolerances.RENDER_DIFFERENCES,
        blend=make_rule("ray", open_rule()), background=(0.2, 0.5, 0.9),
    )  # fmt: skip
    assert checked == 6 * (3 + 4 + 3 + 1 + 12)


def test_render_rolling_shutter_along_the_ray_orders_each_line_by_its_own_pose(rng):
    # A picket fence that the camera passes by more than its distance while it is read out: from
    # the middle pose, the pickets of the first and the last lines are in the wrong order.
    x = np.linspace(-2.0, 2.0, 9)
    means = [(a, 0, 2 + 0.3 * (i % 2)) for i, a in enumerate(x)]
    g = place(means, (0.15, 2.0, 0.1), [RED, BLUE] * 4 + [RED], response="maximum")
    camera, shutter = pinhole(12, 10, focal=6.0), gsut.Shutter("top_to_bottom")
    start, end = np.eye(4), np.eye(4)
    start[0, 3], end[0, 3] = 4.0, -4.0
    found = render(g, camera, (start, end), shutter=shutter, order="ray")
    by_distance = render(g, camera, (start, end), shutter=shutter)
    assert np.abs(found.image - by_distance.image).max() > 0.1
    motion = gsut.CameraMotion(start, end, shutter)
    for line, t in enumerate(shutter.line_times(12, 10)):
        image = render(g, camera, motion.at(t), order="ray").image
        assert np.abs(found.image[line] - image[line]).max() < tolerances.RENDER_DOUBLE
    assert line == 9


@pytest.mark.parametrize("response", RESPONSES)
def test_integral_of_overlapping_gaussians_matches_trapezoids_extrapolated(rng, response):
    camera = fisheye(6)
    g, pose = overlapping(rng, camera, response, count=12, aspect=0.3, distances=(0.3, 3.0))
    found = render(g, camera, pose, order="integral")
    color, alpha, depth = ray_model.integrate(g, camera, pose, gsut.BlendRule(), 1024)
    valid = camera.rays()[1]
    assert (found.alpha[valid] > 0.5).mean() > 0.1
    assert np.abs(found.image[valid] - color).max() < tolerances.INTEGRAL_TRAPEZOID
    assert np.abs(found.alpha[valid] - alpha).max() < tolerances.INTEGRAL_TRAPEZOID
    assert np.abs(found.depth[valid] - depth).max() < tolerances.INTEGRAL_TRAPEZOID


def test_integral_of_two_gaussians_matches_the_closed_forms():
    camera = pinhole(1, focal=1.0)
    depth = -np.log(1 - 0.9)
    # At one place and of one size their depths add up, and the colours mix in that proportion.
    together = place([(0, 0, 3)] * 2, 0.2, [RED, BLUE], opacity=[0.9, 0.6])
    a, b = depth, -np.log(1 - 0.6)
    expected = (a * np.array(RED) + b * np.array(BLUE)) / (a + b) * (1 - np.exp(-a - b))
    found = render(together, camera, np.eye(4), order="integral").image[0, 0]
    assert np.abs(found - expected).max() < tolerances.RENDER_DOUBLE
    # Apart they are blended, the nearer first; from within one, half of it is seen.
    apart = place([(0, 0, 5), (0, 0, 2)], 0.1, [RED, BLUE])
    found = render(apart, camera, np.eye(4), order="integral")
    expected = 0.9 * np.array(BLUE) + 0.1 * 0.9 * np.array(RED)
    assert np.abs(found.image[0, 0] - expected).max() < tolerances.RENDER_DOUBLE
    # Before its middle a dense Gaussian hides what is behind it: it looks nearer than its mean.
    assert 0.9 * 1.8 + 0.09 * 4.8 < found.depth[0, 0] < 0.9 * 2 + 0.09 * 5
    inside = place([(0, 0, 1e-9)], 0.5, [RED])
    found = render(inside, camera, np.eye(4), order="integral").alpha[0, 0]
    assert found == pytest.approx(1 - np.exp(-depth / 2), abs=tolerances.INTEGRAL_INSIDE)
    # A mean behind the camera, its flank in front: P(-1) of it is ahead.
    behind = place([(0, 0, -0.5)], 0.5, [RED])
    found = render(behind, camera, np.eye(4), order="integral").alpha[0, 0]
    assert found == pytest.approx(1 - np.exp(-0.15865525393145707 * depth), abs=1e-12)
    assert render(behind, camera, np.eye(4)).alpha[0, 0] == 0.0


def make_hard_cases():
    """Scenes in which no order of centres is right, or that strain the quadrature."""
    angles = np.radians([0, 120, 240])
    ring = np.stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.full(3, 3.0)], axis=1)
    # Needles around a ring, each with its end towards the eye over the next one's far end.
    turns = [
        gsut.gaussians.quaternion_from_rotation(
            np.array([[-np.sin(a), np.cos(a), 0], [np.cos(a), np.sin(a), 0], [0, 0, -1.0]]).T
            @ np.array([[0.94, 0, 0.34], [0, 1, 0], [-0.34, 0, 0.94]])
        )
        for a in angles
    ]  # fmt: skip
    tilt = np.cos(np.pi / 8), 0.0, np.sin(np.pi / 8), 0.0
    back = np.cos(np.pi / 8), 0.0, -np.sin(np.pi / 8), 0.0
    rng = np.random.default_rng(5)
    lamp = np.concatenate([[(0, 0, 3.0)], rng.normal((0, 0, 3), 0.05, (20, 3))])
    layers = np.stack([*np.zeros((2, 10_000)), np.linspace(1, 9, 10_000)], axis=1)
    return {
        "surfels that cross": place(
            [(0, 0, 3)] * 2, (1.0, 1.0, 1e-4), [RED, BLUE], turns=[tilt, back]
        ),
        "needles in a circle": place(ring, (0.8, 0.05, 0.05), np.eye(3), turns=turns),
        "fog around a lamp": place(
            lamp, np.array([[1.5] * 3] + [[0.01] * 3] * 20), [RED] + [BLUE] * 20,
            opacity=[0.5] + [0.99] * 20,
        ),
        "shells in shells": place([(0, 0, 3)] * 6, np.geomspace(1e-3, 2, 6)[:, None],
                                  [RED, BLUE] * 3, opacity=0.4),
        "a needle end-on": place([(0, 0, 3)], (0.02, 0.02, 2.0), [RED], response="density"),
        "ten thousand layers": place(layers, (3.0, 3.0, 2e-4), [RED, BLUE] * 5000, opacity=3e-4),
    }  # fmt: skip


def test_integral_of_hard_cases_shares_out_all_light_that_is_lost():
    # What all Gaussians show together is 1 - T, which needs no quadrature.
    cases, camera = make_hard_cases(), pinhole(3, focal=6.0)
    for name, g in cases.items():
        where = camera if len(g) < 1000 else pinhole(1)
        white = dataclasses.replace(g, sh=np.full_like(g.sh, WHITE))
        found = render(white, where, np.eye(4), order="integral")
        assert found.alpha.max() > 0.2, name
        error = np.abs(found.image - found.alpha[..., None]).max()
        assert error < tolerances.INTEGRAL_SUM, (name, error)
    # So many thin layers of alpha 3e-4 are the closed form of what follows one another.
    one_by_one = 1 - (1 - 3e-4) ** 10_000
    assert found.alpha[0, 0] == pytest.approx(one_by_one, abs=tolerances.INTEGRAL_SUM)


def test_only_the_integral_stays_when_two_gaussians_pass_each_other():
    # Along the ray, red passes through blue by 2e-9 of its size: an order swaps, matter does not.
    camera = pinhole(1, focal=1.0)
    images = {}
    for order in ("distance", "ray", "integral"):
        for shift in (-1e-9, 1e-9):
            g = place([(0, 0, 3 + shift), (0, 0, 3)], 0.2, [RED, BLUE])
            rule = make_rule(order)
            images[order, shift > 0] = render(g, camera, np.eye(4), blend=rule).image[0, 0]
    jumps = {
        order: np.abs(images[order, True] - images[order, False]).max()
        for order in ("ray", "integral")
    }
    assert jumps["ray"] == pytest.approx(0.81, abs=1e-6)
    assert jumps["integral"] < tolerances.INTEGRAL_CONTINUITY


def test_crossing_surfels_along_the_ray_show_the_nearer_half_of_each():
    g = make_hard_cases()["surfels that cross"]
    camera = pinhole(9, 1, focal=9.0)
    found = render(g, camera, np.eye(4), order="ray").image[0]
    truth = render(g, camera, np.eye(4), order="integral").image[0]
    assert np.abs(found - truth)[[0, 1, 2, 3, 5, 6, 7, 8]].max() < 0.01
    assert (found[0, 0] > 0.5) != (found[8, 0] > 0.5)
    by_distance = render(g, camera, np.eye(4)).image[0]
    assert np.abs(by_distance - truth).max() > 0.3


def test_extinction_of_coincident_copies_is_exactly_one_gaussian(rng):
    # 1 - (1 - o)^G of n copies with 1 - (1 - o)^(1/n) each: the rule that relocation rests on.
    camera = fisheye(16)
    g, pose = overlapping(rng, camera, "extinction", count=1)
    copies = g[np.zeros(3, int)]
    opacity = 1 / (1 + np.exp(-g.opacity_logits[0]))
    part = 1 - (1 - opacity) ** (1 / 3)
    copies.opacity_logits[:] = np.log(part) - np.log1p(-part)
    one, three = (render(each, camera, pose, blend=open_rule()) for each in (g, copies))
    assert one.alpha.max() > 0.3
    assert np.abs(one.image - three.image).max() < tolerances.RENDER_DOUBLE


def test_render_backward_of_the_integral_names_orders_with_a_gradient(rng):
    g, pose = overlapping(rng, pinhole(8), "maximum", count=3)
    result = render(g, pinhole(8), pose, order="integral")
    with pytest.raises(InputError, match=r"no gradient.*distance, z, ray"):
        gsut.render_backward(result, result.image)
