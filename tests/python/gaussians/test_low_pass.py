"""The 3D low-pass filter: derivatives, light, radii through the lens, zooming out, training."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError
from random_scenes import (
    central_differences,
    every_lens,
    fisheye,
    gaussians_in_view,
    loss_of,
    pinhole,
    random_pose,
    random_weights,
    relative_error,
    rng_of,
)
from rendered_dataset import write_dataset


def small_scene(rng, camera, pose, count=60):
    g = gaussians_in_view(rng, camera, pose, count, sizes=(1e-3, 0.05), opacity=1.0)
    return g.to_dtype(np.float64)


def blank(g):
    return gsut.Gaussians(*(np.zeros_like(getattr(g, f.name)) for f in dataclasses.fields(g)))


def test_low_pass_scales_and_opacities_follow_the_definition(rng):
    g = small_scene(rng, pinhole(), np.eye(4))
    radii = 10 ** rng.uniform(-4, 0, len(g))
    found = gsut.loop.apply_low_pass(g, radii)
    before, after = np.exp(g.log_scales), np.sqrt(np.exp(2 * g.log_scales) + radii[:, None] ** 2)
    assert np.abs(np.exp(found.log_scales) / after - 1).max() < tolerances.LOW_PASS_DOUBLE

    def shadow(s):
        return np.sqrt(
            (s[:, 0] * s[:, 1]) ** 2 + (s[:, 1] * s[:, 2]) ** 2 + (s[:, 2] * s[:, 0]) ** 2
        )

    opacity = 1 / (1 + np.exp(-g.opacity_logits)) * shadow(before) / shadow(after)
    filtered = 1 / (1 + np.exp(-found.opacity_logits))
    assert np.abs(filtered / opacity - 1).max() < tolerances.LOW_PASS_DOUBLE
    assert np.array_equal(gsut.loop.apply_low_pass(g, np.zeros(len(g))).log_scales, g.log_scales)


@pytest.mark.parametrize("parameter", ["log_scales", "opacity_logits", "means"])
def test_low_pass_backward_through_the_renderer_matches_central_differences(rng, parameter):
    camera, pose = fisheye(24), random_pose(rng)
    g = small_scene(rng, camera, pose, 20)
    radii = gsut.loop.find_filter_radii(g.means, [camera], pose[None], 0.5)
    weights = random_weights(rng, camera)

    def loss():
        return loss_of(
            gsut.render(gsut.loop.apply_low_pass(g, radii), camera, pose, dtype="float64"), weights
        )

    result = gsut.render(gsut.loop.apply_low_pass(g, radii), camera, pose, dtype="float64")
    slopes = gsut.render_backward(result, *weights).gaussians
    gsut.loop.apply_low_pass_backward(g, radii, slopes)
    found = getattr(slopes, parameter).ravel()
    expected = central_differences(loss, getattr(g, parameter), step=1e-6).ravel()
    assert len(expected) == found.size >= 20
    # A pixel on a cut-off jumps: few may.
    off = np.abs(found - expected) > tolerances.LOW_PASS_GRADIENT * np.abs(expected).max()
    assert off.mean() < 0.05
    assert relative_error(found[~off], expected[~off]) < tolerances.LOW_PASS_GRADIENT


def test_low_pass_float_and_its_backward_match_double(rng):
    g = small_scene(rng, pinhole(), np.eye(4), 500)
    g.opacity_logits += rng.normal(0, 10, 500)
    radii = 10 ** rng.uniform(-5, 1, len(g))
    slopes = gsut.Gaussians(
        *(rng.normal(size=getattr(g, f.name).shape) for f in dataclasses.fields(g))
    )
    single, single_slopes = g.to_dtype(np.float32), slopes.to_dtype(np.float32)
    gsut.loop.apply_low_pass_backward(g, radii, slopes)
    gsut.loop.apply_low_pass_backward(single, radii, single_slopes)
    exact, found = gsut.loop.apply_low_pass(g, radii), gsut.loop.apply_low_pass(single, radii)
    for name in ("log_scales", "opacity_logits"):
        assert relative_error(getattr(found, name), getattr(exact, name)) < (
            tolerances.LOW_PASS_FLOAT
        )
        assert relative_error(getattr(single_slopes, name), getattr(slopes, name)) < (
            tolerances.LOW_PASS_FLOAT
        )


def test_low_pass_extreme_values_stay_finite():
    ran = 0
    for scale in (-80.0, -20.0, 0.0, 20.0):
        for logit in (-80.0, 0.0, 20.0, 80.0):
            for radius in (1e-12, 1e-3, 1.0, 1e6):
                g = gsut.Gaussians(
                    np.zeros((1, 3), np.float32), [[1.0, 0, 0, 0]], [[scale, 0.0, -scale]], [logit],
                    np.zeros((1, 1, 3)),
                )  # fmt: skip
                slopes = blank(g)
                slopes.log_scales[:] = slopes.opacity_logits[:] = 1
                gsut.loop.apply_low_pass_backward(g, np.array([radius]), slopes)
                found = gsut.loop.apply_low_pass(g, np.array([radius]))
                for array in (found.log_scales, found.opacity_logits, slopes.log_scales):
                    assert np.isfinite(array).all(), (scale, logit, radius)
                ran += 1
    assert ran == 64


def test_filter_radii_are_a_pixel_at_the_nearest_camera_through_every_lens():
    ran = 0
    for name, camera in every_lens(48):
        rays, valid = camera.rays()
        directions = rays[valid][rng_of(name).integers(int(valid.sum()), size=50)]
        radii = gsut.loop.find_filter_radii(2 * directions, [camera], np.eye(4)[None], 1.0)
        # A pixel covers the solid angle that four neighbouring rays span; here by differences.
        pixels, _ = camera.project(directions)
        step = 0.001
        area = np.zeros(50)
        ok = np.ones(50, bool)
        edges = []
        for du, dv in ((step, 0), (-step, 0), (0, step), (0, -step)):
            moved, inside = camera.unproject(pixels + np.array([du, dv]))
            edges.append(moved)
            ok &= inside
        across = np.cross(edges[0] - edges[1], edges[2] - edges[3]) / (4 * step**2)
        area = np.linalg.norm(across, axis=1)
        assert ok.sum() > 30, name
        error = np.abs(radii[ok] / (2 * np.sqrt(area[ok])) - 1).max()
        assert error < tolerances.LOW_PASS_RADIUS, (name, error)
        ran += 1
    assert ran == len(every_lens(48))
    # Two cameras: the nearer counts; a point behind both takes the largest radius.
    camera, far = pinhole(), np.eye(4)
    far[2, 3] = 3.0
    points = np.array([[0, 0, 1.0], [0, 0, 2.0], [0, 0, -9.0]])
    radii = gsut.loop.find_filter_radii(points, [camera, camera], np.array([np.eye(4), far]), 0.3)
    assert radii == pytest.approx([0.3 / 48, 0.6 / 48, 0.6 / 48])


def psnr(image, truth):
    return -10 * np.log10(np.mean((np.clip(image, 0, 1) - np.clip(truth, 0, 1)) ** 2))


def zoomed_out(g, camera, pose, factor):
    """PSNR without and with the filter of the small image, against supersampled truth."""
    large = gsut.render(g, camera, pose).image
    height, width = camera.height // factor, camera.width // factor
    truth = large.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    small = camera.resize(width, height)
    plain = gsut.render(g, small, pose).image
    radii = gsut.loop.find_filter_radii(g.means, [small], pose[None], 0.3)
    filtered = gsut.render(gsut.loop.apply_low_pass(g, radii), small, pose).image
    return psnr(plain, truth), psnr(filtered, truth)


def test_zooming_out_of_a_trained_scene_the_filter_answers_aliasing(tmp_path, rng):
    camera = pinhole(96)
    data = write_dataset(tmp_path / "data", rng, camera=camera)
    scene = gsut.load_dataset(data)
    options = gsut.TrainOptions(steps=150, max_gaussians=3000, sh_degree=0, seed=1)
    trained = gsut.train(scene, options, progress=False).gaussians
    pose = scene.views[scene.test_indices[0]].camera_from_world
    gains = []
    for factor in (4, 8, 16):
        plain, filtered = zoomed_out(trained, scene.cameras[0].resize(96, 96), pose, factor)
        print(f"1/{factor}: {plain:.2f} dB without, {filtered:.2f} dB with the filter")
        gains.append(filtered - plain)
    assert min(gains) > 0
    assert gains[-1] > tolerances.LOW_PASS_GAIN_DB


def test_training_with_the_filter_saves_what_it_renders(tmp_path, rng):
    data = write_dataset(tmp_path / "data", rng)
    scene = gsut.load_dataset(data)
    options = gsut.TrainOptions(steps=60, max_gaussians=800, sh_degree=0, seed=1, low_pass=0.3)
    result = gsut.train(scene, options, out=tmp_path / "run", progress=False)
    saved = gsut.formats.load_ply(tmp_path / "run" / "scene.ply")
    assert np.array_equal(saved.log_scales, result.gaussians.log_scales)
    # No Gaussian is thinner than a third of a pixel of the camera that sees it best.
    views = [scene.views[i] for i in scene.train_indices]
    radii = gsut.loop.find_filter_radii(
        saved.means, [scene.cameras[v.camera_index] for v in views],
        np.array([v.camera_from_world for v in views]), 0.3,
    )  # fmt: skip
    assert np.mean(np.exp(saved.log_scales.min(axis=1)) > 0.9 * radii) > 0.99
    plain = gsut.train(scene, dataclasses.replace(options, low_pass=0.0), progress=False)
    assert result.metrics["psnr"] > plain.metrics["psnr"] - 1.0
    assert result.metrics["psnr"] > 18


@pytest.mark.parametrize("pixels", [0.0, -1.0, np.nan, np.inf])
def test_low_pass_bad_arguments_are_refused(pixels):
    with pytest.raises(InputError, match="low_pass"):
        gsut.loop.find_filter_radii(np.zeros((1, 3)), [pinhole()], np.eye(4)[None], pixels)
    g = gsut.Gaussians(
        np.zeros((1, 3)), [[1.0, 0, 0, 0]], np.zeros((1, 3)), [0.0], np.zeros((1, 1, 3))
    )
    with pytest.raises(InputError, match="radii"):
        gsut.loop.apply_low_pass(g, np.array([-1.0]))
    with pytest.raises(InputError, match="camera_from_world"):
        gsut.loop.find_filter_radii(np.zeros((1, 3)), [pinhole()], np.eye(4), 0.3)
