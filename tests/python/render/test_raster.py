"""The double reference renderer: a second implementation, finite differences, identities, rules."""

import dataclasses

import numpy as np
import pytest

import gsut
import ray_model
import tolerances
from gsut import InputError
from random_scenes import (
    blob,
    central_differences,
    every_lens,
    fisheye,
    gaussians_in_view,
    hold_to_differences,
    joined,
    loss_of,
    open_rule,
    pinhole,
    random_pose,
    random_weights,
    relative_error,
    rng_of,
)

pytestmark = pytest.mark.quick

LENSES = dict(every_lens(width=24))
BACKGROUND = (0.2, 0.5, 0.9)
FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))


def double_render(g, camera, pose, **options):
    return gsut.render(g, camera, pose, dtype="float64", **options)


def scene(rng, camera, count=40, sh_degree=3, **options):
    pose = random_pose(rng)
    return gaussians_in_view(
        rng, camera, pose, count, sh_degree=sh_degree, **options
    ).to_dtype(np.float64), pose  # fmt: skip


@pytest.mark.parametrize("parity", ["", "gsplat", "3dgrut"])
@pytest.mark.parametrize("lens", LENSES)
def test_render_double_every_lens_and_rule_matches_a_second_implementation(rng, lens, parity):
    camera = LENSES[lens]
    g, pose = scene(rng, camera, count=60, opacity=1.0)
    rule = gsut.BlendRule(parity)
    found = double_render(g, camera, pose, blend=rule, background=BACKGROUND)
    image, alpha, depth = ray_model.render(g, camera, pose, rule, BACKGROUND)
    assert (alpha > 0.2).mean() > 0.1  # the scene is seen
    assert np.abs(found.image - image).max() < tolerances.RENDER_DOUBLE
    assert np.abs(found.alpha - alpha).max() < tolerances.RENDER_DOUBLE
    assert np.abs(found.depth - depth).max() < tolerances.RENDER_DOUBLE


# So small over their distance that the plane through the camera, behind which nothing is drawn,
# cuts off less than 1e-16 of any.
FAR_ENOUGH = {"sizes": (0.02, 0.05), "aspect": 0.3}


@pytest.mark.parametrize("degree", range(4))
def test_render_backward_every_parameter_and_pose_match_central_differences(degree):
    checked = 0
    for lens, camera in LENSES.items():
        rng = rng_of(f"{lens} {degree}")
        g, pose = scene(rng, camera, count=8, sh_degree=degree, **FAR_ENOUGH)
        checked += hold_to_differences(
            g, camera, pose, random_weights(rng, camera), tolerances.RENDER_DIFFERENCES,
            entries=rng, blend=open_rule(), background=BACKGROUND,
        )  # fmt: skip
    assert checked == len(LENSES) * (24 + 32 + 24 + 8 + min(32, 24 * (degree + 1) ** 2))


def test_render_backward_with_the_cutoff_differs_from_differences_only_by_its_jumps(rng):
    # With alpha_min 1/255 pixels jump by 0.004 as they cross the cut: differences must disagree, or
    # the test above would prove nothing about the cut-offs it lowers.
    camera = pinhole(32)
    g, pose = scene(rng, camera, count=20, sh_degree=0)
    weights = random_weights(rng, camera)
    found = gsut.render_backward(double_render(g, camera, pose), *weights).gaussians.means
    moved = g.copy()
    slopes = central_differences(
        lambda: loss_of(double_render(moved, camera, pose), weights), moved.means, range(60), 1e-4
    )
    assert 1e-3 < relative_error(slopes, found.ravel()) < 1.0


def test_render_backward_omitted_alpha_and_depth_stand_for_zeros(rng):
    camera = pinhole(24)
    g, pose = scene(rng, camera)
    dimage, dalpha, ddepth = random_weights(rng, camera)
    for dtype in ("float32", "float64"):
        result = gsut.render(g, camera, pose, dtype=dtype)
        short = gsut.render_backward(result, dimage)
        full = gsut.render_backward(result, dimage, 0 * dalpha, 0 * ddepth)
        assert relative_error(short.pose, full.pose) < tolerances.RENDER_SAME_SUMS
        for field in FIELDS:
            error = relative_error(getattr(short.gaussians, field), getattr(full.gaussians, field))
            assert error < tolerances.RENDER_SAME_SUMS


@pytest.mark.parametrize("scale", [1e-3, 0.25, 1e4])
def test_render_scaled_scene_keeps_the_image_and_scales_the_depth(rng, scale):
    camera = fisheye(32)
    g, pose = scene(rng, camera)
    scaled, pose_scaled = g.copy(), pose.copy()
    scaled.means *= scale
    scaled.log_scales += np.log(scale)
    pose_scaled[:3, 3] *= scale
    before = double_render(g, camera, pose, background=BACKGROUND)
    after = double_render(scaled, camera, pose_scaled, background=BACKGROUND)
    assert np.abs(after.image - before.image).max() < tolerances.RENDER_IDENTITY
    assert np.abs(after.alpha - before.alpha).max() < tolerances.RENDER_IDENTITY
    assert np.abs(after.depth / scale - before.depth).max() < tolerances.RENDER_IDENTITY


def test_render_backward_scaling_the_scene_leaves_a_loss_of_the_image_alone(rng):
    # Euler: sum of mean . dL/dmean + sum of dL/dlog_scale + t . dL/dt = 0, t the translation.
    for camera in LENSES.values():
        g, pose = scene(rng, camera)
        dimage, dalpha, _ = random_weights(rng, camera)
        found = gsut.render_backward(double_render(g, camera, pose), dimage, dalpha)
        parts = [
            np.sum(g.means * found.gaussians.means),
            np.sum(found.gaussians.log_scales),
            pose[:3, 3] @ found.pose[:3],
        ]
        assert abs(sum(parts)) < tolerances.RENDER_SAME_SUMS * max(map(abs, parts))


def test_render_world_and_camera_moved_together_change_nothing(rng):
    # Degree 0: harmonics are tied to the world's axes.
    camera = fisheye(32)
    g, pose = scene(rng, camera, sh_degree=0)
    world = random_pose(rng)
    moved = g.copy()
    moved.means = g.means @ world[:3, :3].T + world[:3, 3]
    turn = world[:3, :3]
    # Quaternion of the turn, multiplied from the left.
    w = 0.5 * np.sqrt(1 + np.trace(turn))
    skew = turn - turn.T
    v = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * w)
    gw, gv = g.quats[:, :1], g.quats[:, 1:]
    moved.quats = np.hstack(
        [w * gw - (gv @ v)[:, None], w * gv + gw * v + np.cross(np.tile(v, (len(g), 1)), gv)]
    )
    before = double_render(g, camera, pose)
    after = double_render(moved, camera, pose @ np.linalg.inv(world))
    for name in ("image", "alpha", "depth"):
        assert np.abs(getattr(after, name) - getattr(before, name)).max() < (
            tolerances.RENDER_IDENTITY
        )
    # The same for gradients: to the pose, the sum over the Gaussians of moving them all.
    dimage, dalpha, ddepth = random_weights(rng, camera)
    found = gsut.render_backward(before, dimage, dalpha, ddepth)
    by_means = pose[:3, :3] @ found.gaussians.means.sum(axis=0)
    assert relative_error(found.pose[:3], by_means) < tolerances.RENDER_SAME_SUMS


def test_render_white_gaussians_show_alpha_and_the_background_share(rng):
    camera = fisheye(32)
    g, pose = scene(rng, camera, sh_degree=0)
    g.sh[:] = 0.5 * np.sqrt(4 * np.pi)  # colour 1
    for dtype, bound in (
        ("float64", tolerances.RENDER_SAME_SUMS),
        ("float32", tolerances.RENDER_FLOAT_ROUNDING),
    ):
        result = gsut.render(g, camera, pose, background=BACKGROUND, dtype=dtype)
        _, valid = camera.rays()
        expected = result.alpha[..., None] + (1.0 - result.alpha[..., None]) * BACKGROUND
        assert np.abs(result.image - expected)[valid].max() < bound
        assert np.all(result.image[~valid] == 0) and np.all(result.alpha[~valid] == 0)
        assert (~valid).sum() > 100


def one_gaussian(depth=2.0, **options):
    return blob((0, 0, depth), **options)


AXIS = gsut.Camera("pinhole", [10.0, 10.0, 0.5, 0.5], 1, 1)  # one pixel, its ray the axis


@pytest.mark.parametrize("dtype", ["float32", "float64"])
class TestOneRay:
    """Closed forms on a single pixel that looks along the axis."""

    def test_one_gaussian_gives_opacity_color_and_distance(self, dtype):
        result = gsut.render(one_gaussian(), AXIS, np.eye(4), background=BACKGROUND, dtype=dtype)
        expected = 0.6 * np.array([1.0, 0.5, 0.25]) + 0.4 * np.array(BACKGROUND)
        assert result.image[0, 0] == pytest.approx(expected, rel=tolerances.RENDER_CLOSED_FORM)
        assert result.alpha[0, 0] == pytest.approx(0.6, rel=tolerances.RENDER_CLOSED_FORM)
        assert result.depth[0, 0] == pytest.approx(1.2, rel=tolerances.RENDER_CLOSED_FORM)

    def test_opaque_gaussian_is_clamped_and_has_no_gradient_to_opacity(self, dtype):
        g = one_gaussian(opacity=1 - 1e-6)
        result = gsut.render(g, AXIS, np.eye(4), dtype=dtype)
        assert result.alpha[0, 0] == pytest.approx(0.99, rel=tolerances.RENDER_CLOSED_FORM)
        found = gsut.render_backward(result, np.ones((1, 1, 3)))
        assert found.gaussians.opacity_logits[0] == 0
        assert found.gaussians.sh[0, 0, 0] == pytest.approx(
            0.99 / np.sqrt(4 * np.pi), rel=tolerances.RENDER_CLOSED_FORM
        )

    def test_negative_color_is_clamped_and_has_no_gradient(self, dtype):
        g = one_gaussian(color=(-0.3, 0.5, 0.0))
        result = gsut.render(g, AXIS, np.eye(4), dtype=dtype)
        assert result.image[0, 0] == pytest.approx(
            [0.0, 0.3, 0.0], abs=tolerances.RENDER_CLOSED_FORM
        )
        found = gsut.render_backward(result, np.ones((1, 1, 3)))
        assert found.gaussians.sh[0, 0, 0] == 0
        assert found.gaussians.sh[0, 0, 1] > 0

    def test_alpha_below_the_cutoff_is_skipped(self, dtype):
        for opacity, seen in ((1 / 256, False), (1 / 254, True)):
            g = one_gaussian(opacity=opacity)
            result = gsut.render(g, AXIS, np.eye(4), dtype=dtype)
            assert (result.alpha[0, 0] > 0) == seen
            found = gsut.render_backward(result, np.ones((1, 1, 3)))
            assert (found.gaussians.opacity_logits[0] != 0) == seen

    def test_gaussian_behind_is_not_drawn(self, dtype):
        for depth in (-2.0, -0.5):
            result = gsut.render(one_gaussian(depth=depth), AXIS, np.eye(4), dtype=dtype)
            assert result.alpha[0, 0] == 0
            found = gsut.render_backward(result, np.ones((1, 1, 3)), np.ones((1, 1)))
            assert np.all(found.gaussians.means == 0) and np.all(found.pose == 0)

    def test_own_rule_blends_the_gaussian_that_crosses_the_stop_and_gsplat_does_not(self, dtype):
        # Transmittance 0.01, then 1e-4 at the second (<=, <) and below it at the third.
        layer = [one_gaussian(opacity=1 - 1e-6, depth=d, color=(1, 1, 1)) for d in (1.0, 2.0, 3.0)]
        g = joined(*layer)
        own = gsut.render(g, AXIS, np.eye(4), dtype=dtype).alpha[0, 0]
        gsplat = gsut.render(g, AXIS, np.eye(4), parity="gsplat", dtype=dtype).alpha[0, 0]
        assert own == pytest.approx(1 - 1e-6, abs=1e-4)
        assert own >= 1 - 1.01e-4
        assert gsplat == pytest.approx(0.99, abs=1e-4) or gsplat == pytest.approx(
            0.9999, abs=tolerances.RENDER_CLOSED_FORM
        )

    def test_near_cut_of_the_presets_drops_and_own_rule_keeps(self, dtype):
        g = one_gaussian(depth=0.1, scale=0.01)
        seen = {
            parity: gsut.render(g, AXIS, np.eye(4), parity=parity, dtype=dtype).alpha[0, 0] > 0
            for parity in (None, "gsplat", "3dgrut")
        }
        assert seen == {None: True, "gsplat": True, "3dgrut": False}

    def test_response_min_of_3dgrut_cuts_off_opaque_gaussians(self, dtype):
        # Response exp(-4.5) = 0.0111 at three standard deviations: alpha 0.011 is above 1/255.
        g = one_gaussian(opacity=0.98, scale=0.3)
        g.means[0, 0] = 0.92  # D = 0.92 / 0.3 beside the axis
        assert gsut.render(g, AXIS, np.eye(4), parity="gsplat", dtype=dtype).alpha[0, 0] > 1 / 255
        assert gsut.render(g, AXIS, np.eye(4), parity="3dgrut", dtype=dtype).alpha[0, 0] == 0


# Opacities of 0 and 1.
FINITE_MEANING = {("opacity_logits", np.inf), ("opacity_logits", -np.inf)}


def test_render_reference_value_that_is_not_finite_is_refused_with_its_index():
    ran = 0
    for field in FIELDS:
        for value in (np.nan, np.inf, -np.inf):
            if (field, value) in FINITE_MEANING:
                continue
            g = joined(one_gaussian(), one_gaussian())
            getattr(g, field).flat[-1] = value
            with pytest.raises(InputError, match="Gaussian 1 "):
                double_render(g, AXIS, np.eye(4))
            ran += 1
    assert ran == 3 * len(FIELDS) - len(FINITE_MEANING)
