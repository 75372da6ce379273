"""The hard cases in the WebAssembly core: the bits of native code without vectors."""

import numpy as np
import pytest
from test_hard_matrix import CASES

from core_in_node import draw_in_node, draw_natively, hold_scalar


@pytest.fixture
def scalar():
    yield from hold_scalar()


@pytest.mark.filterwarnings("ignore:of [0-9]+ Gaussians:RuntimeWarning")  # case 11 plants them
def test_core_hard_cases_have_the_bits_of_native_scalar(tmp_path, scalar, rng):
    jobs = []
    for build, _ in CASES.values():
        for scene in build(rng):
            if scene.options or not len(scene.gaussians):
                continue
            jobs.append((scene.gaussians, scene.camera, scene.pose, scene.pose, "global"))
    assert len(jobs) >= 50
    for number, (job, image) in enumerate(zip(jobs, draw_in_node(tmp_path, jobs), strict=True)):
        np.testing.assert_array_equal(image, draw_natively(*job), err_msg=str(number))
