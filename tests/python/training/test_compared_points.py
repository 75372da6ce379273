"""Where the data have few points, the photographs give some: on what they show."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.data import scene_from_arrays
from gsut.data.scene import interpolate_poses
from gsut.surface.stereo import find_points_by_stereo, measure_coverage
from gsut.training.first.seeding import choose_first_gaussians
from wall_scenes import CENTERS, LENSES, WALL, wall_scene


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("rolling", [False, True])
def test_compared_points_of_a_wall_lie_on_it(lens: str, rolling: bool) -> None:
    found = find_points_by_stereo(wall_scene(LENSES[lens], rolling=rolling), 500, 0)
    assert found is not None
    points, colors = found
    assert points.shape == colors.shape == (500, 3) and colors.dtype == np.uint8
    off = np.abs(points[:, 2] - WALL) / WALL
    assert np.median(off) < tol.FOUND_MEDIAN and np.mean(off > tol.FOUND_FAR) < tol.FOUND_SHARE


@pytest.mark.parametrize("lens", LENSES)
def test_compared_points_that_only_chance_shows_are_left_out(lens: str) -> None:
    scene, camera = wall_scene(LENSES[lens]), LENSES[lens]
    images = [scene.image(view) for view in range(len(CENTERS))]
    noise = np.random.default_rng(5).uniform(0, 255, images[0].shape[:2]).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    grey = np.clip(128 + 50 * (soft - soft.mean()) / soft.std(), 0, 255).astype(np.uint8)
    images[1] = np.repeat(grey[..., None], 3, -1)  # of something else
    poses = scene.poses(range(len(CENTERS)))
    found = find_points_by_stereo(scene_from_arrays(images, camera, poses, test_every=0), 500, 0)
    assert found is not None and len(found[0]) == 500
    off = np.abs(found[0][:, 2] - WALL) / WALL
    assert np.mean(off > tol.FOUND_FAR) < tol.FOUND_BY_CHANCE


def test_compared_points_of_few_views_lie_between_the_distances_of_given_points() -> None:
    scene = wall_scene(LENSES["pinhole"])
    given = np.random.default_rng(0).uniform([-1, -1, 2.8], [1, 1, 3.2], (200, 3))
    colors = np.full(given.shape, 128, np.uint8)
    found = find_points_by_stereo(scene.replace(points=given, point_colors=colors), 500, 0)
    assert found is not None
    off = np.abs(found[0][:, 2] - WALL) / WALL
    assert np.median(off) < tol.FOUND_MEDIAN and np.mean(off > tol.FOUND_FAR) < tol.FOUND_BY_CHANCE


def test_compared_points_of_three_views_that_hardly_agree_are_taken_all_the_same() -> None:
    scene = wall_scene(LENSES["pinhole"]).replace(train_indices=[0, 1, 2])
    found = find_points_by_stereo(scene, 500, 0)
    assert found is not None and len(found[0]) >= 100


def test_compared_points_are_the_same_on_any_number_of_threads() -> None:
    scene, before = wall_scene(LENSES["pinhole"]), gsut.num_threads()
    try:
        found = []
        for threads in (1, 2):
            gsut.set_num_threads(threads)
            found.append(find_points_by_stereo(scene, 300, 1))
        assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))
    finally:
        gsut.set_num_threads(before)


def test_first_gaussians_of_photographs_without_texture_are_random() -> None:
    scene = wall_scene(LENSES["pinhole"], plain=True)
    assert find_points_by_stereo(scene, 500, 0) is None
    options = gsut.TrainOptions(max_gaussians=2000)
    gaussians, notes = choose_first_gaussians(scene, options)
    assert len(gaussians) == 2000 and not notes


def test_first_gaussians_add_compared_points_where_points_cover_little_unless_asked() -> None:
    scene = wall_scene(LENSES["pinhole"])
    rng = np.random.default_rng(0)
    known, wide = (
        scene.replace(points=points, point_colors=np.full(points.shape, 128, np.uint8))
        for points in (
            rng.uniform([-1, -1, 2], [1, 1, 4], (50, 3)),
            rng.uniform([-3, -2, 2.9], [3, 2, 3.1], (3000, 3)),
        )
    )
    counts = [
        (scene, {}, 800, 1),
        (known, {}, 750, 1),  # 40 % of the most, less twice the points, beside these
        (wide, {"max_gaussians": 20_000}, 3000, 0),  # which cover the photographs
        (known, {"init": "points"}, 50, 0),
        (known, {"max_gaussians": 250}, 50, 0),
        (scene, {"init": "random", "max_gaussians": 90}, 90, 0),
    ]
    for of, given, count, said in counts:
        options = gsut.TrainOptions(**{"max_gaussians": 2000, **given})
        gaussians, notes = choose_first_gaussians(of, options)
        assert (len(gaussians), len(notes)) == (count, said), given


@pytest.mark.parametrize("rolling", [False, True])
def test_coverage_is_the_share_of_unmasked_cells_with_a_point(rolling: bool) -> None:
    scene = wall_scene(LENSES["pinhole"], rolling=rolling).replace(train_indices=[0])
    height, width = scene.mask(0).shape  # 64, 96: cells of 4.8 pixels, 13 x 20
    camera, view = scene.camera(0), scene.views[0]
    assert measure_coverage(scene) == 0
    row, column = np.mgrid[0:13, 0:10].reshape(2, -1) + 0.5  # one in each on the left half
    pixels = np.stack([column * width / 20, row * height / 13], -1)
    rays = camera.unproject(pixels)[0]
    points = rays * WALL / rays[:, 2:] + view.camera_center
    seen = scene.replace(points=points, point_colors=np.zeros(points.shape, np.uint8))
    assert measure_coverage(seen) == pytest.approx(0.5)
    valid = np.zeros((height, width), bool)
    valid[:, : width // 2] = True
    half = dataclasses.replace(view, valid=valid, image_path=Path("half"))
    assert measure_coverage(seen.replace(views=[half])) == 1


def test_poses_of_no_lines_are_an_empty_array():
    """A rolling view of which nothing is sure has no pixels to trace."""
    motion = gsut.CameraMotion(np.eye(4), np.eye(4), gsut.Shutter("top_to_bottom"))
    assert interpolate_poses(motion, np.zeros(0)).shape == (0, 4, 4)
