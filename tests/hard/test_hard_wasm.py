"""The hard cases in the WebAssembly core: the bits of native code without vectors."""

import numpy as np
import pytest
from test_hard_matrix import CASES

from core_in_node import draw_in_node, draw_natively, hold_least_isa
from random_scenes import rng_of


@pytest.fixture(scope="module")
def cases():
    """Jobs, and their images by native code without vectors."""
    jobs, rng = [], rng_of("hard")
    for build, _ in CASES.values():
        for scene in build(rng):
            if scene.options or not len(scene.gaussians):
                continue
            jobs.append((scene.gaussians, scene.camera, scene.pose, scene.pose, "global"))
    assert len(jobs) >= 50
    scalar = hold_least_isa()
    next(scalar)
    images = [draw_natively(*job) for job in jobs]
    next(scalar, None)
    return jobs, images


@pytest.mark.filterwarnings("ignore:of [0-9]+ Gaussians:RuntimeWarning")  # case 11 plants them
def test_core_hard_cases_have_the_bits_of_native_scalar(tmp_path, cases):
    jobs, images = cases
    drawn = draw_in_node(tmp_path, jobs)
    for number, (image, native) in enumerate(zip(drawn, images, strict=True)):
        np.testing.assert_array_equal(image, native, err_msg=str(number))
