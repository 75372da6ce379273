"""Where the data have few points, the photographs give some: on what they show."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.data import Scene, scene_from_arrays
from gsut.data.scene import interpolate_poses
from gsut.lens import Camera
from gsut.training.first.plane_sweep import find_points_by_sweep
from gsut.training.first.seeding import choose_first_gaussians

LENSES = {
    "pinhole": Camera("pinhole", [70.0, 70.0, 48.0, 32.0], 96, 64),
    "kannala_brandt": Camera("kannala_brandt", [38.0, 38.0, 40.0, 40.0, 0, 0, 0, 0], 80, 80),
}
CENTERS = np.array([[x, y, 0.0] for x in (-0.6, 0.0, 0.6) for y in (-0.3, 0.3)])
WALL = 3.0  # distance along z
READOUT = 0.12  # that a camera moves to the right while it reads a picture


def wall_scene(camera: Camera, *, rolling: bool = False, plain: bool = False) -> Scene:
    """Views of a wall with a pattern, without points; the camera moves while lines are read."""
    rays, valid = camera.rays()
    line = (np.arange(camera.height) + 0.5) / camera.height - 0.5
    moved = np.zeros((camera.height, 1, 3))
    moved[:, 0, 0] = READOUT * line if rolling else 0.0
    waves = np.random.default_rng(0).uniform(-9, 9, (30, 2))
    phases = np.arange(30.0)
    images = []
    for center in CENTERS:
        starts = center + moved
        with np.errstate(invalid="ignore", divide="ignore"):
            x, y, _ = np.moveaxis(starts + rays * WALL / rays[..., 2:], -1, 0)
        pattern = np.sin(np.stack([x, y], -1) @ waves.T + phases).sum(-1) / 12
        shown = valid & (rays[..., 2] > 0.3) & (not plain)
        grey = np.where(shown, np.clip(0.5 + 0.5 * pattern, 0, 1), 0.5)
        images.append(np.rint(255 * np.repeat(grey[..., None], 3, -1)).astype(np.uint8))
    poses = np.tile(np.eye(4), (len(CENTERS), 1, 1))
    poses[:, :3, 3] = -CENTERS
    scene = scene_from_arrays(images, camera, poses, test_every=0)
    if not rolling:
        return scene
    begun, ended = np.eye(4), np.eye(4)
    begun[0, 3], ended[0, 3] = READOUT / 2, -READOUT / 2
    shutter = gsut.Shutter("top_to_bottom")
    views = [
        dataclasses.replace(
            view, shutter=shutter, camera_from_world_start=begun @ view.camera_from_world,
            camera_from_world_end=ended @ view.camera_from_world,
        )
        for view in scene.views
    ]  # fmt: skip
    return scene.replace(views=views)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("rolling", [False, True])
def test_swept_points_of_a_wall_lie_on_it(lens: str, rolling: bool) -> None:
    found = find_points_by_sweep(wall_scene(LENSES[lens], rolling=rolling), 500, 0)
    assert found is not None
    points, colors = found
    assert points.shape == colors.shape == (500, 3) and colors.dtype == np.uint8
    off = np.abs(points[:, 2] - WALL) / WALL
    assert np.median(off) < tol.SWEPT_MEDIAN and np.mean(off > tol.SWEPT_FAR) < tol.SWEPT_SHARE


@pytest.mark.parametrize("lens", LENSES)
def test_swept_points_that_only_chance_shows_are_left_out(lens: str) -> None:
    scene, camera = wall_scene(LENSES[lens]), LENSES[lens]
    images = [scene.image(view) for view in range(len(CENTERS))]
    noise = np.random.default_rng(5).uniform(0, 255, images[0].shape[:2]).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    grey = np.clip(128 + 50 * (soft - soft.mean()) / soft.std(), 0, 255).astype(np.uint8)
    images[1] = np.repeat(grey[..., None], 3, -1)  # of something else
    poses = scene.poses(range(len(CENTERS)))
    found = find_points_by_sweep(scene_from_arrays(images, camera, poses, test_every=0), 500, 0)
    assert found is not None and len(found[0]) == 500
    off = np.abs(found[0][:, 2] - WALL) / WALL
    assert np.mean(off > tol.SWEPT_FAR) < tol.SWEPT_BY_CHANCE


def test_swept_points_of_few_views_lie_between_the_distances_of_given_points() -> None:
    scene = wall_scene(LENSES["pinhole"])
    given = np.random.default_rng(0).uniform([-1, -1, 2.8], [1, 1, 3.2], (200, 3))
    colors = np.full(given.shape, 128, np.uint8)
    found = find_points_by_sweep(scene.replace(points=given, point_colors=colors), 500, 0)
    assert found is not None
    off = np.abs(found[0][:, 2] - WALL) / WALL
    assert np.median(off) < tol.SWEPT_MEDIAN and np.mean(off > tol.SWEPT_FAR) < tol.SWEPT_BY_CHANCE


def test_swept_points_of_three_views_that_hardly_agree_are_taken_all_the_same() -> None:
    scene = wall_scene(LENSES["pinhole"]).replace(train_indices=[0, 1, 2])
    found = find_points_by_sweep(scene, 500, 0)
    assert found is not None and len(found[0]) >= 100


def test_swept_points_are_the_same_on_any_number_of_threads() -> None:
    scene, before = wall_scene(LENSES["pinhole"]), gsut.num_threads()
    try:
        found = []
        for threads in (1, 2):
            gsut.set_num_threads(threads)
            found.append(find_points_by_sweep(scene, 300, 1))
        assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))
    finally:
        gsut.set_num_threads(before)


def test_first_gaussians_of_photographs_without_texture_are_random() -> None:
    scene = wall_scene(LENSES["pinhole"], plain=True)
    assert find_points_by_sweep(scene, 500, 0) is None
    options = gsut.TrainOptions(max_gaussians=2000).resolve()
    gaussians, notes = choose_first_gaussians(scene, options)
    assert len(gaussians) == 2000 and not notes


def test_first_gaussians_add_swept_ones_where_points_are_few_and_nothing_else_is_asked() -> None:
    scene = wall_scene(LENSES["pinhole"])
    points = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (50, 3))
    known = scene.replace(points=points, point_colors=np.full((50, 3), 128, np.uint8))
    counts = [
        (scene, {}, 800, 1),
        (known, {}, 450, 1),  # 40 % of the most, less eight times the points, beside these
        (known, {"init": "points"}, 50, 0),
        (known, {"max_gaussians": 1000}, 50, 0),
        (scene, {"init_count": 70}, 70, 1),
        (known, {"init_count": 30}, 30, 0),
        (scene, {"init": "random", "init_count": 90}, 90, 0),
    ]
    for of, given, count, said in counts:
        options = gsut.TrainOptions(**{"max_gaussians": 2000, **given}).resolve()
        gaussians, notes = choose_first_gaussians(of, options)
        assert (len(gaussians), len(notes)) == (count, said), given


def test_poses_of_no_lines_are_an_empty_array():
    """A rolling view of which nothing is sure has no pixels to trace."""
    motion = gsut.CameraMotion(np.eye(4), np.eye(4), gsut.Shutter("top_to_bottom"))
    assert interpolate_poses(motion, np.zeros(0)).shape == (0, 4, 4)
