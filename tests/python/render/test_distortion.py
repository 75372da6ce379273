"""How far apart a pixel's Gaussians lie, and its gradients: double reference, then the kernels."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from random_scenes import (
    central_differences,
    gaussians_in_view,
    list_isas,
    open_rule,
    pinhole,
    relative_error,
)
from surface_scenes import CAMERAS, put_camera

FIELDS = ("means", "quats", "log_scales", "opacity_logits")


def scene_of(rng, kind, count):
    camera, motion, pose = put_camera(rng, kind)
    return camera, gaussians_in_view(rng, camera, pose, count, opacity=1.0), motion


@pytest.mark.parametrize("kind", CAMERAS)
def test_gradient_of_the_distortion_equals_central_differences_in_double(rng, kind):
    camera, g, motion = scene_of(rng, kind, 8)
    g = g.to_dtype(np.float64)
    rule = open_rule()

    def render(gaussians):
        return gsut.render(gaussians, camera, motion, blend=rule, dtype="float64")

    seen = render(g)
    # Pixels that stay well away from the least alpha that counts.
    to = rng.normal(size=seen.alpha.shape) * (np.abs(seen.alpha - 1e-3) > 2e-4)
    assert np.count_nonzero(seen.distortion * to) > 20
    nothing = np.zeros_like(seen.image)
    found = gsut.render_backward(seen, nothing, ddistortion=to).gaussians
    for name in FIELDS:
        numeric = central_differences(lambda: np.sum(to * render(g).distortion), getattr(g, name))
        assert relative_error(getattr(found, name), numeric) < tolerances.RENDER_DIFFERENCES, name


@pytest.mark.parametrize("kind", CAMERAS)
def test_distortion_of_the_kernels_equals_the_double_reference(rng, kind):
    camera, g, motion = scene_of(rng, kind, 60)
    rule = open_rule()
    truth = gsut.render(g, camera, motion, blend=rule, dtype="float64")
    to = rng.normal(size=truth.alpha.shape) * (np.abs(truth.alpha - 1e-3) > 2e-4)
    rest = rng.normal(size=truth.image.shape), rng.normal(size=to.shape), rng.normal(size=to.shape)
    exact = gsut.render_backward(truth, *rest, ddistortion=to, with_lens=True)
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        try:
            seen = gsut.render(g, camera, motion, blend=rule)
            found = gsut.render_backward(seen, *rest, ddistortion=to, with_lens=True)
        finally:
            gsut.machine.set_isa("")
        counts = np.abs(truth.alpha - 1e-3) > 2e-4
        error = relative_error(seen.distortion[counts], truth.distortion[counts])
        assert error < tolerances.DISTORTION, (isa, error)
        for name in FIELDS:
            error = relative_error(getattr(found.gaussians, name), getattr(exact.gaussians, name))
            assert error < tolerances.RENDER_GRADIENT, (isa, name, error)
        assert relative_error(found.pose, exact.pose) < tolerances.RENDER_GRADIENT, isa
        if found.lens is not None and exact.lens is not None and kind != "moving pupil":
            assert relative_error(found.rays, exact.rays) < tolerances.RENDER_GRADIENT, isa


def test_distortion_keeps_its_digits_where_a_thin_surface_lies_far_away():
    # Two sheets a thousandth of their distance apart: their squares differ in the seventh digit.
    camera = pinhole(16)
    depths = np.array([1000.0, 1001.0])
    g = gsut.Gaussians(
        np.stack([0 * depths, 0 * depths, depths], 1), np.tile([1.0, 0, 0, 0], (2, 1)),
        np.log(np.tile([500.0, 500, 1e-2], (2, 1))), np.zeros(2), np.zeros((2, 1, 3)),
    )  # fmt: skip
    truth = gsut.render(g, camera, np.eye(4), dtype="float64")
    found = gsut.render(g.to_dtype(np.float32), camera, np.eye(4))
    assert truth.distortion[8, 8] == pytest.approx(1 / 6, rel=1e-2)  # weights 1/2 and 1/4
    assert relative_error(found.distortion, truth.distortion) < tolerances.DISTORTION_FAR


def test_shortest_axes_face_the_camera_and_their_gradients_equal_differences(rng):
    _, g, pose = scene_of(rng, "pinhole", 30)
    center = -pose[:3, :3].T @ pose[:3, 3]
    g = g.to_dtype(np.float64)
    to = rng.normal(size=(30, 1, 3))

    def colors(gaussians):
        sh = np.empty((30, 1, 3))
        _core.facing_axes(gaussians, list(center), sh)
        return sh

    axes = colors(g)[:, 0] * 2 * 0.28209479177387814
    assert np.allclose(np.linalg.norm(axes, axis=1), 1)
    assert np.all(np.sum(axes * (g.means - center), 1) <= 0)
    found = g.make_zeros()
    _core.facing_axes_backward(g, list(center), to, found, 3.0)
    numeric = central_differences(lambda: np.sum(to * colors(g)), g.quats)
    assert relative_error(found.quats, numeric) < tolerances.RENDER_DIFFERENCES
    scales = np.exp(g.log_scales)
    shortest = scales == scales.min(axis=1, keepdims=True)
    assert relative_error(found.log_scales, 3 / 30 * scales * shortest) < tolerances.SURFACE_EXACT
