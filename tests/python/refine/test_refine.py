"""Derivatives of single colours, and the pose of a photograph from its colours."""

import dataclasses

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.refine.pixel_rows import (
    SCENE_BLOCKS,
    PixelRows,
    compute_square,
    estimate_covariance,
)
from gsut.refine.pose import check_photograph, refine_levels
from gsut.refine.secants import place_lines
from random_scenes import (
    fisheye,
    gaussians_in_view,
    pinhole,
    random_pose,
    relative_error,
    small_camera,
    subtract_poses,
)

BACKGROUND = (0.2, 0.4, 0.1)


def jacobian(g, camera, pose, pixels):
    return pytest.importorskip("gsut_scalar_baseline").color_jacobian(
        g, _core.RenderJob(camera, pose, background=BACKGROUND, sh_degree=g.sh_degree), pixels
    )


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("lens", [fisheye, pinhole])
def test_sum_of_the_jacobian_is_the_gradient_to_pose_rays_and_lens(rng, lens, degree):
    camera = lens(48, 40)
    pose = random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 300, sh_degree=degree)
    rays, valid = camera.rays()
    weights = rng.normal(size=(camera.height, camera.width, 3)) * valid[:, :, None]
    exact = gsut.render(g, camera, pose, background=BACKGROUND, dtype="float64")
    expected = gsut.render_backward(exact, weights, with_lens=True)
    fast = gsut.render(g, camera, pose, background=BACKGROUND)
    of_tiles = gsut.render_backward(fast, weights, with_lens=True)

    pixels = rng.permutation(np.flatnonzero(valid)).astype(np.uint32)
    colors, by_center, by_ray = jacobian(g, camera, pose, pixels)
    np.testing.assert_array_equal(colors, fast.image.reshape(-1, 3)[pixels])
    chosen, d = weights.reshape(-1, 3)[pixels], rays.reshape(-1, 3)[pixels]
    of_center = np.einsum("ic,icj->j", chosen, by_center)
    of_rays = np.einsum("ic,icj->ij", chosen, by_ray)
    # camera_from_world <- exp(v, w) camera_from_world: the centre moves by -R^T v, and the rays
    # turn by -w about it.
    found = np.concatenate([-pose[:3, :3] @ of_center, -np.cross(d, of_rays).sum(axis=0)])
    for of_all in (expected, of_tiles):
        assert relative_error(found, of_all.pose) < tolerances.REFINE_POSE_GRADIENT
        error = relative_error(of_rays, of_all.rays.reshape(-1, 3)[pixels])
        assert error < tolerances.REFINE_RAY_GRADIENT
        found_lens = of_rays.ravel() @ rays_by_lens(camera)[pixels].reshape(-1, len(camera.params))
        size = np.maximum(1e-2, np.abs(camera.params))
        error = relative_error(found_lens * size, of_all.lens * size)
        assert error < tolerances.REFINE_LENS_GRADIENT


def rays_by_lens(camera):
    """(H W, 3, params) by central differences."""
    sides = []
    for sign in (1, -1):
        columns = []
        for k, value in enumerate(camera.params):
            params = np.array(camera.params)
            step = 1e-6 * max(1e-2, abs(value))
            params[k] += sign * step
            lens = gsut.Camera(camera.model, params, camera.width, camera.height)
            columns.append(lens.rays()[0].reshape(-1, 3) / (2 * step))
        sides.append(np.stack(columns, axis=-1))
    return sides[0] - sides[1]


def made_scene(rng, camera):
    """Gaussians all around a camera 1 to 6 units away, and its pose."""
    pose = random_pose(rng)
    return gaussians_in_view(rng, camera, pose, 400, opacity=1.0), pose


def pose_errors(found, expected):
    """Degrees, and world units between the centres."""
    turn = found[:3, :3] @ expected[:3, :3].T
    sine = np.linalg.norm(turn - turn.T) / np.sqrt(8)
    centers = [-p[:3, :3].T @ p[:3, 3] for p in (found, expected)]
    return np.degrees(np.arcsin(sine)), np.linalg.norm(centers[0] - centers[1])


def disturbed(rng, pose, degrees, distance):
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    turn *= np.radians(degrees) / np.linalg.norm(turn)
    shift *= distance / np.linalg.norm(shift)
    return gsut.exp_pose(np.concatenate([shift, turn])) @ pose


@pytest.mark.parametrize("lens", [fisheye, pinhole])
@pytest.mark.parametrize(
    ("degrees", "distance", "gain", "bias"), [(0.5, 0.06, 1.0, 0.0), (2.0, 0.1, 0.8, 0.05)]
)
def test_disturbed_pose_comes_back(rng, lens, degrees, distance, gain, bias):
    camera = lens(96, 80)
    g, pose = made_scene(rng, camera)
    image = gain * gsut.render(g, camera, pose, background=BACKGROUND).image + bias
    start = disturbed(rng, pose, degrees, distance)
    found = gsut.poses.refine_pose(g, camera, start, image, background=BACKGROUND)
    angle, shift = pose_errors(found.camera_from_world, pose)
    print(f"{camera.model}: {angle:.2e} degrees, {shift:.2e} units, rms {found.rms:.1e}")
    assert angle < tolerances.REFINED_DEGREES
    assert shift < tolerances.REFINED_UNITS
    assert found.converged
    np.testing.assert_allclose([found.gain, found.bias], [gain, bias], atol=1e-4)
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    np.testing.assert_allclose(found.covariance, found.covariance.T)


# Blocks of 6 pixels hold 0.852 (0.726 in two directions) of the variance that a box of 3 spreads.
@pytest.mark.parametrize(("blur", "expected"), [(0, 6.0), (3, 6.0 / 0.726)])
def test_covariance_is_that_of_the_noise(rng, blur, expected):
    """Errors over many noisy photographs, in units of the covariance: chi-square of 6.

    Of independent noise, and of noise that neighbouring pixels share (as independent: 54).
    """
    camera = fisheye(96)
    g, pose = made_scene(rng, camera)
    clean = gsut.render(g, camera, pose).image
    scores = []
    for _ in range(20):
        noise = rng.normal(0, 0.02, clean.shape).astype(np.float32)
        image = clean + (cv2.blur(noise, (blur, blur)) if blur else noise)
        found = gsut.poses.refine_pose(g, camera, pose, image, levels=1)
        error = subtract_poses(found.camera_from_world, pose)
        scores.append(error @ np.linalg.solve(found.covariance, error))
    print(f"blur {blur}: {np.mean(scores):.2f}")
    assert abs(np.mean(scores) - expected) < tolerances.REFINED_CHI_SQUARE


def test_pose_among_gaussians_narrower_than_a_pixel_errs_as_its_covariance_says():
    """Derivatives of colours are too sure there: 3.2 a freedom."""
    rng = np.random.default_rng(0)
    camera = fisheye(96)
    pose = random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 6000, sizes=(0.001, 0.02), opacity=1.0)
    clean = gsut.render(g, camera, pose).image
    scores = []
    for _ in range(6):
        image = clean + rng.normal(0, 0.02, clean.shape).astype(np.float32)
        start = disturbed(rng, pose, 0.2, 0.01)
        found = gsut.poses.refine_pose(g, camera, start, image)
        error = subtract_poses(found.camera_from_world, pose)
        scores.append(error @ np.linalg.solve(found.covariance, error) / 6)
    print(np.round(scores, 2))
    assert np.median(scores) < tolerances.REFINED_NARROW_CHI_SQUARE


def test_pose_in_a_scene_that_errs_is_off_by_what_its_covariance_says():
    """Slopes alone are far too sure there: 7 a freedom."""
    camera, scores, looseness = fisheye(64), [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        pose = random_pose(rng)
        g = gaussians_in_view(rng, camera, pose, 1500, sizes=(0.02, 0.1), opacity=1.0)
        photograph = check_photograph(camera, gsut.render(g, camera, pose).image, None)
        wrong = g.means + rng.normal(0, 0.1, g.means.shape)
        scene = dataclasses.replace(g, means=wrong.astype(g.means.dtype))
        found = refine_levels(scene, camera, pose, *photograph, (0, 0, 0), True, 1, 20_000, None)
        error = subtract_poses(found.camera_from_world, pose)
        scores.append(compute_square(error, found.estimate_errors(None, SCENE_BLOCKS)))
        looseness.append(np.linalg.eigvals(found.looseness).real.max())
    print(np.round(scores, 2), np.round(looseness, 1))
    assert len(scores) == 8 and min(looseness) > 1.5
    assert np.mean(scores) < tolerances.REFINED_ERRING_CHI_SQUARE


@pytest.mark.parametrize("direction", ["top_to_bottom", "right_to_left"])
def test_lines_of_a_rolling_shutter_get_their_poses_and_motion(rng, direction):
    camera = fisheye(96)
    g, pose = made_scene(rng, camera)
    motion = np.array([0.03, -0.04, 0.02, 0.01, -0.03, 0.02])
    shutter = gsut.Shutter(direction)
    moving = place_lines(pose, motion, shutter)
    image = gsut.render(g, camera, moving).image
    image += rng.normal(0, 0.01, image.shape).astype(np.float32)
    start = disturbed(rng, pose, 0.3, 0.02)
    found = gsut.poses.refine_pose(g, camera, start, image, shutter=shutter)
    still = gsut.poses.refine_pose(g, camera, start, image)
    errors = subtract_poses(found.camera_from_world, pose), found.motion - motion
    squares = [
        error @ np.linalg.solve(covariance, error) / 6
        for error, covariance in zip(
            errors, (found.covariance, found.motion_covariance), strict=True
        )
    ]
    off = subtract_poses(still.camera_from_world, pose)
    print(direction, np.round(squares, 2), np.abs(errors[0]).max(), np.abs(off).max())
    assert found.shutter is shutter and still.motion is None
    assert max(squares) < tolerances.REFINED_ROLLING_CHI_SQUARE
    assert np.abs(errors[0]).max() < 0.2 * np.abs(off).max()


def test_jackknife_covers_errors_that_the_pixels_of_a_block_share(rng):
    """Some blocks tell more than others: residuals by blocks as they are (CR1) would give 10.5."""
    side, block, across, size, runs = 96, 6, 6, 8, 200
    scores = []
    y, x = np.meshgrid(*2 * [30 + block * np.arange(across)], indexing="ij")
    pixels = np.concatenate([(y.ravel() + k) * side + x.ravel() + k for k in range(4)])
    for _ in range(runs):
        strength = np.exp(0.5 * rng.normal(size=(across**2, 1, 1)))
        slopes = rng.normal(size=(across**2, 3, size))
        slopes = np.concatenate(
            [strength * (slopes + 0.3 * rng.normal(size=slopes.shape)) for _ in range(4)]
        )
        shared = rng.normal(size=(across**2, 3))
        noise = np.concatenate([shared + 0.1 * rng.normal(size=shared.shape) for _ in range(4)])
        found = np.linalg.lstsq(slopes.reshape(-1, size), noise.ravel(), rcond=None)[0]
        rows = PixelRows(
            pixels, side, side, slopes @ found - noise, np.ones(len(pixels)),
            slopes[:, :, :6], slopes[:, :, 6:],
        )  # fmt: skip
        covariance = estimate_covariance(rows, slopes)[:6, :6]
        scores.append(found[:6] @ np.linalg.solve(covariance, found[:6]))
    print(f"{np.mean(scores):.2f}")
    assert abs(np.mean(scores) - 6.0) < tolerances.JACKKNIFE_CHI_SQUARE


def test_same_bits_twice_and_masked_pixels_do_not_count(rng):
    camera = fisheye(64)
    g, pose = made_scene(rng, camera)
    image = gsut.render(g, camera, pose).image
    mask = np.ones(image.shape[:2], bool)
    mask[:, :24] = False
    image[:, :24] = rng.uniform(size=(64, 24, 3))
    start = disturbed(rng, pose, 0.5, 0.05)
    found = [gsut.poses.refine_pose(g, camera, start, image, mask) for _ in range(2)]
    np.testing.assert_array_equal(found[0].camera_from_world, found[1].camera_from_world)
    angle, shift = pose_errors(found[0].camera_from_world, pose)
    assert angle < tolerances.REFINED_DEGREES
    assert shift < tolerances.REFINED_UNITS


def test_what_cannot_be_refined_is_refused_in_a_sentence(rng):
    camera = pinhole(32)
    g, pose = made_scene(rng, camera)
    image = np.zeros((32, 32, 3), np.float32)
    motion = gsut.CameraMotion(pose, pose, gsut.Shutter("top_to_bottom"))
    for rolling in (motion, (pose, pose), np.stack([pose, pose])):
        with pytest.raises(gsut.InputError, match="give the shutter as shutter="):
            gsut.poses.refine_pose(g, camera, rolling, image)
    with pytest.raises(gsut.InputError, match="image must have shape"):
        gsut.poses.refine_pose(g, camera, pose, image[:5])
    with pytest.raises(gsut.InputError, match="mask leaves no pixel"):
        gsut.poses.refine_pose(g, camera, pose, image, np.zeros((32, 32), bool))
    moving_pupil = small_camera("cahvore")
    with pytest.raises(gsut.InputError, match="derivatives of colours are for a lens with one"):
        jacobian(g, moving_pupil, pose, np.zeros(1, np.uint32))
    with pytest.raises(gsut.InputError, match="outside the image"):
        jacobian(g, camera, pose, np.full(1, 32 * 32, np.uint32))
    empty = g[:0]
    with pytest.raises(gsut.SolveError, match="does not determine its pose"):
        gsut.poses.refine_pose(empty, camera, pose, image)
