"""Tests the fine-tune that makes viewers, which splat by EWA, show what gsut shows."""

import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.training.tuning import tune_for_viewers
from random_scenes import assert_same
from rendered_dataset import truth, write_dataset
from tolerances import VIEWERS_GAIN_DB

STEPS = 25


@pytest.fixture
def thin(rng):
    """Blobs a tenth as large as elsewhere: what a screen widens by 0.3 pixels shows."""
    g = truth(rng, 300)
    g.log_scales -= np.float32(2.3)
    return g


@pytest.fixture
def scene(tmp_path, rng):
    return gsut.load_dataset(write_dataset(tmp_path / "data", rng))


def test_tuned_scene_looks_in_viewers_more_like_itself(scene, thin):
    before = thin.copy()
    seen = []
    found = tune_for_viewers(scene, thin, STEPS, on_step=lambda step, loss: seen.append(step))
    assert seen == list(range(1, STEPS + 1))
    assert len(found.gaussians) == len(thin)
    assert found.psnr_after >= found.psnr_before + VIEWERS_GAIN_DB
    assert_same(thin, before)  # the trained scene stays


def test_same_seed_gives_the_same_bits_on_any_number_of_threads(scene, thin):
    threads, found = gsut.num_threads(), []
    for number in (1, 3):
        gsut.set_num_threads(number)
        found.append(tune_for_viewers(scene, thin, 2).gaussians)
    gsut.set_num_threads(threads)
    assert_same(*found)


def test_nothing_to_do_is_refused(scene, thin):
    with pytest.raises(InputError, match="at least 1"):
        tune_for_viewers(scene, thin, 0)
