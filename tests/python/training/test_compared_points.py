"""Where the data have few points, the photographs give some: on what they show."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.data import Scene, scene_from_arrays
from gsut.data.scene import interpolate_poses
from gsut.surface.stereo import find_points_by_stereo
from gsut.training.first.plane_sweep import find_points_by_sweep
from gsut.training.first.seeding import choose_first_gaussians
from wall_scenes import CENTERS, LENSES, WALL, wall_scene


@dataclasses.dataclass(frozen=True)
class Finder:
    """A way to find points by comparing photographs, and how far these may be off."""

    find: Callable[[Scene, int, int], tuple[np.ndarray, np.ndarray] | None]
    median: float
    far: float
    share: float
    by_chance: float


FINDERS = {
    "sweep": Finder(
        find_points_by_sweep, tol.SWEPT_MEDIAN, tol.SWEPT_FAR, tol.SWEPT_SHARE, tol.SWEPT_BY_CHANCE
    ),
    "stereo": Finder(
        find_points_by_stereo, tol.FOUND_MEDIAN, tol.FOUND_FAR, tol.FOUND_SHARE, tol.FOUND_BY_CHANCE
    ),
}


@pytest.fixture(params=FINDERS)
def finder(request) -> Finder:
    return FINDERS[request.param]


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("rolling", [False, True])
def test_compared_points_of_a_wall_lie_on_it(finder: Finder, lens: str, rolling: bool) -> None:
    found = finder.find(wall_scene(LENSES[lens], rolling=rolling), 500, 0)
    assert found is not None
    points, colors = found
    assert points.shape == colors.shape == (500, 3) and colors.dtype == np.uint8
    off = np.abs(points[:, 2] - WALL) / WALL
    assert np.median(off) < finder.median and np.mean(off > finder.far) < finder.share


@pytest.mark.parametrize("lens", LENSES)
def test_compared_points_that_only_chance_shows_are_left_out(finder: Finder, lens: str) -> None:
    scene, camera = wall_scene(LENSES[lens]), LENSES[lens]
    images = [scene.image(view) for view in range(len(CENTERS))]
    noise = np.random.default_rng(5).uniform(0, 255, images[0].shape[:2]).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    grey = np.clip(128 + 50 * (soft - soft.mean()) / soft.std(), 0, 255).astype(np.uint8)
    images[1] = np.repeat(grey[..., None], 3, -1)  # of something else
    poses = scene.poses(range(len(CENTERS)))
    found = finder.find(scene_from_arrays(images, camera, poses, test_every=0), 500, 0)
    assert found is not None and len(found[0]) == 500
    off = np.abs(found[0][:, 2] - WALL) / WALL
    assert np.mean(off > finder.far) < finder.by_chance


def test_compared_points_of_few_views_lie_between_the_distances_of_given_points(
    finder: Finder,
) -> None:
    scene = wall_scene(LENSES["pinhole"])
    given = np.random.default_rng(0).uniform([-1, -1, 2.8], [1, 1, 3.2], (200, 3))
    colors = np.full(given.shape, 128, np.uint8)
    found = finder.find(scene.replace(points=given, point_colors=colors), 500, 0)
    assert found is not None
    off = np.abs(found[0][:, 2] - WALL) / WALL
    assert np.median(off) < finder.median and np.mean(off > finder.far) < finder.by_chance


def test_compared_points_of_three_views_that_hardly_agree_are_taken_all_the_same(
    finder: Finder,
) -> None:
    scene = wall_scene(LENSES["pinhole"]).replace(train_indices=[0, 1, 2])
    found = finder.find(scene, 500, 0)
    assert found is not None and len(found[0]) >= 100


def test_compared_points_are_the_same_on_any_number_of_threads(finder: Finder) -> None:
    scene, before = wall_scene(LENSES["pinhole"]), gsut.num_threads()
    try:
        found = []
        for threads in (1, 2):
            gsut.set_num_threads(threads)
            found.append(finder.find(scene, 300, 1))
        assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))
    finally:
        gsut.set_num_threads(before)


@pytest.mark.parametrize(
    ("finder", "init"), [("sweep", "auto"), ("stereo", "stereo")], indirect=["finder"]
)
def test_first_gaussians_of_photographs_without_texture_are_random(
    finder: Finder, init: str
) -> None:
    scene = wall_scene(LENSES["pinhole"], plain=True)
    assert finder.find(scene, 500, 0) is None
    options = gsut.TrainOptions(max_gaussians=2000, init=init).resolve()
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


def test_first_gaussians_by_stereo_lie_beside_the_points() -> None:
    scene = wall_scene(LENSES["pinhole"])
    points = np.random.default_rng(0).uniform([-3, -2, 2.9], [3, 2, 3.1], (50, 3))
    known = scene.replace(points=points, point_colors=np.full(points.shape, 128, np.uint8))
    counts = [  # 40 % of the most
        (scene, {}, 800, 1),
        (known, {}, 850, 1),
        (scene, {"init_count": 70}, 70, 1),
    ]
    for of, given, count, said in counts:
        options = gsut.TrainOptions(max_gaussians=2000, init="stereo", **given).resolve()
        gaussians, notes = choose_first_gaussians(of, options)
        assert (len(gaussians), len(notes)) == (count, said), given
