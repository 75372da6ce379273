"""Where photographs show a sky without points, first Gaussians lie far away."""

from __future__ import annotations

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.data import scene_from_arrays
from gsut.lens import Camera
from gsut.training.first.seeding import choose_first_gaussians
from gsut.training.first.sky import find_sky

CAMERA = Camera("pinhole", [60.0, 60.0, 60.0, 40.0], 120, 80)
CENTERS = np.array([[x, 0.0, z] for x in (-3.0, -1.0, 1.0, 3.0) for z in (0.0, 1.0)])


def sky_colors(directions: np.ndarray) -> np.ndarray:
    """Clouds some 30 degrees wide: (..., 3) in [0, 1]."""
    x, y, _ = np.moveaxis(directions, -1, 0)
    return np.stack(
        [0.5 + 0.4 * np.sin(12 * x), 0.6 + 0.3 * np.cos(10 * y + 5 * x), 0.8 + 0 * x], -1
    )


def ground_scene(sky: str, seed: int = 0) -> gsut.Scene:
    """Views over ground with points, of another shade in each; above a sky, a wall, or points."""
    rng = np.random.default_rng(seed)
    points = np.stack([rng.uniform(-6, 6, 400), np.full(400, 1.5), rng.uniform(4, 12, 400)], 1)
    if sky == "points":
        wall = [rng.uniform(-30, 30, 4000), rng.uniform(-25, 1, 4000), np.full(4000, 12)]
        points = np.concatenate([points, np.stack(wall, 1)])
    rays = CAMERA.rays()[0]
    above = sky_colors(rays) if sky == "clouds" else np.full(rays.shape, 0.7)
    images = []
    for center, shade in zip(CENTERS, rng.random(len(CENTERS)), strict=True):
        at = center + rays * (13.0 - center[2]) / rays[..., 2:]
        shown = at[..., 1:2] < 0.6 if sky == "wall" else rays[..., 1:2] < 0  # the wall's foot
        images.append(np.rint(255 * np.where(shown, above, shade)).astype(np.uint8))
    poses = np.tile(np.eye(4), (len(CENTERS), 1, 1))
    poses[:, :3, 3] = -CENTERS
    return scene_from_arrays(images, CAMERA, poses, points=points, test_every=0)


def test_first_sky_of_clouds_lies_far_and_has_their_colors() -> None:
    scene = ground_scene("clouds")
    found = find_sky(scene)
    assert found is not None
    points, colors = found
    directions = points - CENTERS.mean(axis=0)
    away = np.linalg.norm(directions, axis=1)
    assert (directions[:, 1] < 0).all()
    assert away.min() > 9 * np.linalg.norm(scene.points, axis=1).max()
    off = colors / 255 - sky_colors(directions / away[:, None])
    assert np.abs(off).max() < tol.BLURRED_SKY


def test_first_sky_without_clouds_lies_above_and_has_its_color() -> None:
    scene = ground_scene("cloudless")
    found = find_sky(scene)
    assert found is not None
    directions = found[0] - CENTERS.mean(axis=0)
    assert (directions[:, 1] < 0).all() and len(directions) > 100
    assert (np.abs(found[1].astype(int) - round(255 * 0.7)) <= 1).all()


def test_first_sky_of_a_plain_surface_that_moves_before_points_around_it_is_none() -> None:
    # Points on a wall, all around a part of it that is plain, above the cameras.
    scene = ground_scene("points")
    plain = (np.abs(scene.points[:, 0]) < 9) & (scene.points[:, 1] < -1) & (scene.points[:, 1] > -9)
    scene = scene.replace(points=scene.points[~plain], point_colors=scene.point_colors[~plain])
    assert find_sky(scene) is None


@pytest.mark.parametrize("sky", ["wall", "points"])
def test_first_sky_of_plain_wall_or_known_surface_is_none(sky: str) -> None:
    assert find_sky(ground_scene(sky)) is None


def test_first_gaussians_add_sky_within_the_cap_only() -> None:
    scene = ground_scene("clouds")
    found = find_sky(scene)
    assert found is not None
    most = len(scene.points) + len(found[0])
    for cap, count in ((most, most), (most - 1, len(scene.points))):
        options = gsut.TrainOptions(max_gaussians=cap)
        gaussians, notes = choose_first_gaussians(scene, options)
        assert len(gaussians) == count and len(notes) == (count == most)
