"""Python threads may share what they render: the same bits as one after the other."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import gsut
from random_scenes import fisheye, gaussians_in_view

THREADS, CALLS = 8, 24


@pytest.fixture
def scene(rng):
    camera = fisheye(width=160)
    return gaussians_in_view(rng, camera, np.eye(4), 800, sh_degree=1), camera


def in_threads(function, items):
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))


def assert_same(found, expected):
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_one_render_gives_each_thread_its_gradients(scene, rng):
    rendered = gsut.render(*scene, np.eye(4))
    weights = [rng.normal(size=rendered.image.shape).astype(np.float32) for _ in range(CALLS)]

    def gradients(dimage):
        found = gsut.render_backward(rendered, dimage)
        return np.concatenate([found.gaussians.means.ravel(), found.pose.astype(np.float32)])

    assert_same(in_threads(gradients, weights), [gradients(dimage) for dimage in weights])


def test_threads_render_the_same_gaussians_each_from_its_place(scene):
    places = [np.eye(4) for _ in range(CALLS)]
    for number, place in enumerate(places):
        place[0, 3] = 0.05 * number

    def image(place):
        return gsut.render(*scene, place).image

    assert_same(in_threads(image, places), [image(place) for place in places])
