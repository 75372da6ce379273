"""Whether the parts of a photograph lie where a render shows them."""

import cv2
import numpy as np
import pytest

import tolerances
from gsut.refine.agreement import measure_agreement


@pytest.fixture
def picture():
    """Smooth texture of 120 x 160 pixels."""
    noise = np.random.default_rng(3).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    return cv2.resize(noise, (160, 120), interpolation=cv2.INTER_CUBIC)


@pytest.fixture
def everywhere():
    return np.ones((120, 160), bool)


def test_agreement_of_a_picture_in_another_light_is_whole(picture, everywhere):
    light = np.linspace(0.4, 1.0, 160)[None, :, None] * [1.0, 0.8, 0.6]
    other = np.round(picture * light).astype(np.uint8)
    assert measure_agreement(other, picture, everywhere) > tolerances.AGREEMENT_OF_LIGHT


def test_agreement_of_a_picture_three_pixels_off_is_nothing(picture, everywhere):
    other = np.roll(picture, 3, axis=1)
    assert measure_agreement(other, picture, everywhere) < tolerances.AGREEMENT_BY_CHANCE


def test_agreement_of_a_mirrored_picture_is_chance(picture, everywhere):
    other = np.ascontiguousarray(picture[:, ::-1])
    assert measure_agreement(other, picture, everywhere) < tolerances.AGREEMENT_BY_CHANCE


def test_agreement_counts_only_what_the_mask_leaves(picture, everywhere):
    other = picture.copy()
    other[:, 80:] = other[:, 80:][:, ::-1]
    half = everywhere & (np.arange(160) < 80)[None]
    assert measure_agreement(other, picture, half) == 1.0
    assert measure_agreement(other, picture, everywhere) < tolerances.AGREEMENT_OF_HALF


def test_agreement_of_a_picture_without_texture_is_zero(picture, everywhere):
    flat = np.full_like(picture, 90)
    assert measure_agreement(flat, picture, everywhere) == 0.0
    assert measure_agreement(picture, flat, everywhere) < tolerances.AGREEMENT_BY_CHANCE
    assert measure_agreement(picture, picture, ~everywhere) == 0.0
