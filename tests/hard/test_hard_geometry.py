"""Hard cases 3, 4, 5, 9, 15, 18: where Gaussian and camera stand to each other."""

import numpy as np
import pytest
from precision_paths import FIELDS, blob, errors_of, joined, run_every_path

import gsut
import tolerances
from random_scenes import fisheye, gaussians_in_view, pinhole, random_pose, random_weights

LENSES = {
    "pinhole": pinhole(40),
    "fisheye 190": fisheye(48, degrees=190),
    "fisheye 270": fisheye(80, degrees=270),
    "fisheye 350": fisheye(112, degrees=350),
}


def around_the_camera(rng, count):
    """Gaussians from inside the camera's position outwards, many of them enclosing it."""
    g = gaussians_in_view(rng, LENSES["fisheye 350"], np.eye(4), count, sh_degree=1)
    direction = g.means / np.linalg.norm(g.means, axis=1, keepdims=True)
    distance = 10 ** rng.uniform(-3, 0.5, (count, 1))
    g.means = (direction * distance).astype(np.float32)
    g.log_scales = np.log(10 ** rng.uniform(-2, 1, (count, 3))).astype(np.float32)
    g.opacity_logits -= 2
    return g


@pytest.mark.parametrize("lens", LENSES)
def test_gaussians_around_the_camera_float_matches_double(rng, lens):
    # One at a time: where the camera lies inside, alpha jumps to 0 where the nearest point passes
    # behind the ray's origin, and a pixel on that line may fall on either side.
    camera, weights = LENSES[lens], random_weights(rng, LENSES[lens])
    g = around_the_camera(rng, 30)
    ran = enclosing = 0
    for i in range(len(g)):
        outcomes = run_every_path(g[i : i + 1], camera, np.eye(4), weights)
        found = errors_of(outcomes, weights)
        assert found.alpha < tolerances.HARD_ALPHA, (i, found)
        assert found.flips <= tolerances.HARD_JUMPS_AN_IMAGE, (i, found)
        assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, (i, found)
        enclosing += (outcomes[0].result.alpha[camera.rays()[1]] > 0).mean() > 0.4
        ran += 1
    assert ran == 30
    assert enclosing >= 5


@pytest.mark.parametrize("lens", LENSES)
def test_gaussian_centred_on_the_camera_gives_nothing_and_no_nan(rng, lens):
    camera = LENSES[lens]
    pose = np.eye(4)
    pose[:3, 3] = (1.0, -2.0, 0.5)
    center = -pose[:3, 3]
    weights = random_weights(rng, camera)
    other = blob(mean=center + np.array([0.1, 0.2, 1.5]))
    alone = run_every_path(other, camera, pose, weights)
    both = run_every_path(joined(blob(mean=center), other), camera, pose, weights)
    ran = 0
    for one, two in zip(alone, both, strict=True):
        assert np.array_equal(one.result.image, two.result.image)
        assert np.array_equal(one.gradients.pose, two.gradients.pose)
        for name in FIELDS:
            rows = getattr(two.gradients.gaussians, name)
            assert np.all(rows[0] == 0)
            assert np.array_equal(rows[1:], getattr(one.gradients.gaussians, name))
        ran += 1
    assert ran == 1 + len(gsut.machine.available_isas())


@pytest.mark.parametrize("lens", LENSES)
def test_gaussians_crossing_the_camera_plane_float_matches_double(rng, lens):
    camera = LENSES[lens]
    g = gaussians_in_view(rng, LENSES["fisheye 350"], np.eye(4), 80, sh_degree=1, opacity=-1.0)
    g.means[:, 2] = 0.1 * rng.normal(size=80)  # centres within a tenth of the plane z = 0
    g.log_scales[:] = np.log(rng.uniform(0.05, 0.6, (80, 3)))
    weights = random_weights(rng, camera)
    found = errors_of(run_every_path(g, camera, np.eye(4), weights), weights)
    assert found.image < tolerances.HARD_IMAGE, found
    assert found.depth < tolerances.HARD_DEPTH, found
    assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, found


@pytest.mark.parametrize("factor", [1.0, 10.0, 1e3, 1e6])
def test_gaussian_larger_than_the_field_of_view_fills_the_image(rng, factor):
    # Far outside: the wall is flat and covers every ray that can meet it.
    ran = 0
    for camera in (LENSES["pinhole"], LENSES["fisheye 190"]):
        g = blob(mean=(0.0, 0.0, 5.0), scale=(50 * factor, 50 * factor, 0.05), opacity=0.7)
        outcomes = run_every_path(g, camera, np.eye(4), random_weights(rng, camera))
        rays, valid = camera.rays()
        ahead = valid & (rays[..., 2] > 0.2)
        for outcome in outcomes:
            # Over a wall, alpha is the opacity times exp of minus half (x / scale)^2 at the wall.
            where = 5 * rays[..., :2] / rays[..., 2:]
            d2 = np.sum(where**2, axis=2) / (50 * factor) ** 2
            expected = 0.7 * np.exp(-0.5 * d2)
            error = np.abs(outcome.result.alpha - expected)[ahead].max()
            assert error < tolerances.HARD_WALL, (outcome.path, factor, error)
            ran += 1
        assert ahead.sum() > 1000
    assert ran == 2 * (1 + len(gsut.machine.available_isas()))


def test_mirrored_hit_behind_the_camera_has_no_response_and_no_gradient(rng):
    # A narrow Gaussian behind a 190-degree fisheye: its line meets every mirrored ray.
    camera = LENSES["fisheye 190"]
    weights = random_weights(rng, camera)
    ran = 0
    for _ in range(50):
        angle, azimuth = rng.uniform(np.radians(125), np.pi), rng.uniform(0, 2 * np.pi)
        direction = 2 * np.array(
            [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
        )
        g = blob(mean=direction, scale=rng.uniform(0.01, 0.15, 3), quat=rng.normal(size=4))
        for outcome in run_every_path(g, camera, np.eye(4), weights):
            assert np.all(outcome.result.alpha == 0) and np.all(outcome.result.depth == 0)
            for name in FIELDS:
                assert np.all(getattr(outcome.gradients.gaussians, name) == 0)
            assert np.all(outcome.gradients.pose == 0)
            ran += 1
    assert ran == 50 * (1 + len(gsut.machine.available_isas()))


def test_field_beyond_180_degrees_is_ordered_by_distance_and_never_culled_by_z(rng):
    camera = LENSES["fisheye 270"]
    weights = random_weights(rng, camera)
    ran = 0
    for degrees in (92.0, 100.0, 120.0, 130.0):
        angle = np.radians(degrees)
        for azimuth in np.radians([0, 70, 200]):
            direction = np.array(
                [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
            )
            # By z the far one would come first: its z is more negative.
            near = blob(mean=2 * direction, scale=0.3, color=(1, 0, 0))
            far = blob(mean=4 * direction, scale=0.6, color=(0, 0, 1))
            assert far.means[0, 2] < near.means[0, 2] < 0
            pixel, valid = camera.project(direction[None])
            assert valid[0]
            column, row = np.floor(pixel[0]).astype(int)
            outcomes = run_every_path(joined(far, near), camera, np.eye(4), weights)
            for outcome in outcomes:
                red, _, blue = outcome.result.image[row, column]
                assert red == pytest.approx(0.6, abs=0.02)
                assert blue == pytest.approx(0.24, abs=0.02)
                ran += 1
            found = errors_of(outcomes, weights)
            assert found.image < tolerances.HARD_IMAGE, found
            assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, found
    assert ran == 12 * (1 + len(gsut.machine.available_isas()))


def test_gaussian_on_the_axis_ahead_and_behind_is_a_round_spot(rng):
    # Exactly at theta = 0 and, through a 350-degree lens, 2 degrees from theta = 180.
    camera = fisheye(113, degrees=350)  # an odd size: the axis hits a pixel's centre
    weights = random_weights(rng, camera)
    ran = 0
    for offset in (0.0, 1e-30, 1e-12, 1e-6, 1e-3):
        g = blob(mean=(offset, -offset, 2.0), scale=0.2)
        outcomes = run_every_path(g, camera, np.eye(4), weights)
        for outcome in outcomes:
            alpha = outcome.result.alpha
            assert alpha[56, 56] == pytest.approx(0.6, abs=1e-3)
            if offset < 1e-6:
                for turned in (alpha.T, alpha[::-1], alpha[:, ::-1]):
                    assert np.abs(alpha - turned).max() < tolerances.HARD_ALPHA
            ran += 1
        found = errors_of(outcomes, weights)
        assert found.image < tolerances.HARD_IMAGE, (offset, found)
        assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, (offset, found)
    behind = blob(mean=(0.0, 0.0, -2.0), scale=0.5)
    outcomes = run_every_path(behind, camera, np.eye(4), weights)
    rim = outcomes[0].result.alpha
    assert rim.max() > 0.55 and (rim > 0.1).sum() > 300  # a ring along the circle
    found = errors_of(outcomes, weights)
    assert found.image < tolerances.HARD_IMAGE, found
    assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, found
    assert ran == 5 * (1 + len(gsut.machine.available_isas()))


def test_gaussians_at_the_edge_of_the_domain_are_cut_by_the_mask_only(rng):
    # Centres inside, on and outside the largest angle: the part inside shows as in double.
    ran = 0
    for degrees in (120.0, 190.0, 270.0):
        camera = fisheye(80, degrees=degrees)
        assert (~camera.rays()[1]).sum() > 500
        for offset in np.radians([-20.0, -3.0, 0.0, 1e-4, 3.0, 10.0]):
            angle = min(np.radians(degrees) / 2 + offset, np.pi - 0.1)
            azimuth = rng.uniform(0, 2 * np.pi, 12)
            directions = np.stack(
                [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth),
                 np.full(12, np.cos(angle))], axis=1,
            )  # fmt: skip
            g = joined(
                *(blob(rng.uniform(1.5, 2.5) * d, rng.uniform(0.05, 0.4, 3),
                       quat=rng.normal(size=4)) for d in directions)
            )  # fmt: skip
            weights = random_weights(rng, camera)
            outcomes = run_every_path(g, camera, np.eye(4), weights)
            found = errors_of(outcomes, weights)
            assert found.image < tolerances.HARD_IMAGE, (degrees, offset, found)
            assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, found
            if np.degrees(offset) < 1:
                assert (outcomes[0].result.alpha > 0.3).sum() > 20
            ran += 1
    assert ran == 18


def test_needles_across_many_tiles_are_missed_by_none(rng):
    # Thin and long, at all angles, from one tile to far outside: alpha of each pixel as in double.
    ran = 0
    for camera in (pinhole(100), fisheye(100, degrees=190)):
        for aspect in (30.0, 100.0, 300.0):
            for _ in range(3):
                pose = random_pose(rng)
                g = gaussians_in_view(rng, camera, pose, 25, sh_degree=0, sizes=(0.01, 0.03))
                length = rng.uniform(0.2, 2.0, 25)
                g.log_scales[:] = np.log(length / aspect)[:, None]
                g.log_scales[:, 0] = np.log(length)
                weights = random_weights(rng, camera)
                found = errors_of(run_every_path(g, camera, pose, weights), weights)
                assert found.alpha < tolerances.HARD_NEEDLE, (aspect, found)
                assert found.flips < tolerances.HARD_JUMPS_AN_IMAGE, (aspect, found)
                assert max(found.gradients, found.pose) < tolerances.HARD_NEEDLE_GRADIENT, found
                ran += 1
    assert ran == 18


@pytest.mark.parametrize("offset", [1e3, 1e5, 1e6, 1e7])
def test_scene_far_from_the_origin_is_as_exact_as_its_coordinates(rng, offset):
    # Means are stored in float: at 1e6 they lie on a grid of 1/16. What is stored is rendered to
    # full accuracy, since differences to the camera are formed exactly.
    camera, pose = fisheye(64), random_pose(rng)
    where = offset * np.array([1.0, -0.7, 0.4])
    g = gaussians_in_view(rng, camera, pose, 80, sizes=(0.05, 0.2))
    g.means = (g.means.astype(np.float64) + where).astype(np.float32)
    pose = pose.copy()
    pose[:3, 3] -= pose[:3, :3] @ where
    weights = random_weights(rng, camera)
    outcomes = run_every_path(g, camera, pose, weights)
    assert (outcomes[0].result.alpha > 0.2).mean() > 0.3
    found = errors_of(outcomes, weights)
    assert found.image < tolerances.HARD_IMAGE, found
    assert found.depth < tolerances.HARD_DEPTH, found
    assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, found


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e4, 1e6])
def test_scene_of_any_size_is_rendered_alike(rng, scale):
    camera, pose = fisheye(64), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 80)
    reference = gsut.render(g, camera, pose, dtype="float64")
    g.means = (scale * g.means.astype(np.float64)).astype(np.float32)
    g.log_scales = (g.log_scales.astype(np.float64) + np.log(scale)).astype(np.float32)
    pose = pose.copy()
    pose[:3, 3] *= scale
    weights = random_weights(rng, camera)
    outcomes = run_every_path(g, camera, pose, weights)
    found = errors_of(outcomes, weights)
    assert found.image < tolerances.HARD_IMAGE, found
    assert found.depth < tolerances.HARD_DEPTH, found
    assert max(found.gradients, found.pose) < tolerances.HARD_GRADIENT, found
    # Parameters rounded to float after scaling: not the same scene to the last digit.
    assert np.abs(outcomes[0].result.image - reference.image).max() < tolerances.HARD_IMAGE
