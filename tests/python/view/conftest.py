"""The small scene that the pages of these tests show: six photographs, the fourth turned."""

import dataclasses

import pytest

import small_run
from random_scenes import fisheye, gaussians_in_view, rng_of


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    scene = small_run.scene_from_arrays(tmp_path_factory.mktemp("page"))
    views = list(scene.views)
    views[3] = dataclasses.replace(views[3], turns=1)
    return scene.replace(views=views)


@pytest.fixture(scope="session")
def gaussians(scene):
    return gaussians_in_view(rng_of("view"), fisheye(), scene.views[0].camera_from_world, 300)
