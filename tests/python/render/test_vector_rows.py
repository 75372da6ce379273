"""Rows of Gaussians that fill no whole vector: nothing beyond them is written, or matters."""

import numpy as np
import pytest

from gsut import _core
from gsut.gaussians import Gaussians
from random_scenes import fisheye, list_isas, random_gaussians

FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
SIZE, SPARE = 32, 40
SENTINEL = np.float32(123.25)
UNSEEN_LOGIT = -30.0


def gradients_of(gaussians, spare):
    """The image, and gradients with `spare` rows after them that hold SENTINEL."""
    camera = fisheye(SIZE)
    rows = {
        name: np.full((len(gaussians) + spare, *getattr(gaussians, name).shape[1:]), SENTINEL)
        for name in FIELDS
    }
    gradients = Gaussians(*(rows[name][: len(gaussians)] for name in FIELDS))
    image = np.zeros((SIZE, SIZE, 3), np.float32)
    dimage = np.random.default_rng(3).normal(size=image.shape).astype(np.float32)
    renderer = _core.Renderer()
    renderer.render(gaussians, _core.RenderJob(camera, np.eye(4)), image)
    touched = np.zeros(len(gaussians), np.uint8)
    renderer.backward(dimage, gradients, touched)
    assert touched.any()
    return image, rows


@pytest.mark.parametrize("isa", list_isas())
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_render_rows_of_no_whole_vector_have_the_bits_of_more(rng, isa, degree):
    _core.set_isa(isa)
    everything = random_gaussians(rng, 64).to_dtype(np.float32)
    everything = Gaussians(
        *(getattr(everything, name) for name in FIELDS[:-1]),
        rng.normal(size=(64, (degree + 1) ** 2, 3)).astype(np.float32),
    )
    for count in (3, 15, 17, 24):
        few, more = everything[:count].copy(), everything.copy()
        more.opacity_logits[count:] = UNSEEN_LOGIT
        image, rows = gradients_of(few, SPARE)
        expected_image, expected = gradients_of(more, 0)
        np.testing.assert_array_equal(image, expected_image)
        for name in FIELDS:
            np.testing.assert_array_equal(rows[name][:count], expected[name][:count])
            assert (rows[name][count:] == SENTINEL).all()
            assert (expected[name][count:] == 0).all()
