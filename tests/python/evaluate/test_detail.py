"""How much of a photograph's detail a render shows: degradations of known kind."""

import cv2
import numpy as np
import pytest

from gsut.evaluate.detail import is_beside, measure_detail, measure_details
from gsut.judge.checks.training import GOOD, POOR, SHIFT_GAIN
from gsut.metrics import psnr


@pytest.fixture(scope="module")
def photograph():
    """Lines and patches of all sizes below a plain sky."""
    rng = np.random.default_rng(3)
    image = np.full((300, 400, 3), 150, np.uint8)
    for _ in range(375):
        x, y, w, h = (*rng.integers((0, 100), (380, 280)), *rng.integers(4, 40, 2))
        shade = tuple(int(value) for value in rng.integers(0, 255, 3))
        cv2.rectangle(image, (int(x), int(y)), (int(x + w), int(y + h)), shade, -1)
    return image


ALL = np.ones((300, 400), bool)


def measure(photograph, image):
    return measure_detail(photograph, np.clip(image, 0, 1).astype(np.float32), ALL)


def test_detail_falls_with_blur_and_shift_not_with_brightness_or_fog(photograph):
    true = photograph / np.float32(255)
    blurred = [measure(photograph, cv2.GaussianBlur(true, (0, 0), s)) for s in (0.7, 1.5, 3, 6)]
    shifted = [measure(photograph, np.roll(true, d, axis=1)) for d in (1, 2, 4)]
    fog = cv2.resize(np.random.default_rng(4).normal(0, 0.15, (4, 5)).astype("f4"), (400, 300))
    print("blur", blurred, "shift", shifted)
    assert measure(photograph, true) == 1.0
    assert blurred == sorted(blurred, reverse=True) and shifted == sorted(shifted, reverse=True)
    assert blurred[0] > GOOD and blurred[-1] < POOR and shifted[-1] < POOR
    soft = psnr(cv2.GaussianBlur(true, (0, 0), 1.5), true)
    for changed in (1.2 * true, 0.2 + 0.7 * (true + fog[..., None])):
        assert psnr(np.clip(changed, 0, 1), true) < soft
        assert measure(photograph, changed) > GOOD


def test_detail_counts_what_the_mask_keeps_and_pictures_without_any(photograph):
    half = photograph / np.float32(255)
    half[:, 200:] = 0.5
    left = np.broadcast_to(np.arange(400) < 200, ALL.shape)
    assert measure_detail(photograph, half, left) == 1.0
    assert measure_detail(photograph, half, ALL) < GOOD
    plain = np.full_like(photograph, 90)
    assert measure_detail(plain, plain / np.float32(255), ALL) == 1.0
    assert measure_detail(plain[:3, :3], plain[:3, :3] / np.float32(255), ALL[:3, :3]) == 1.0


def test_detail_of_a_small_picture_falls_with_a_blur_of_the_same_share(photograph):
    small = cv2.resize(photograph, (128, 96), interpolation=cv2.INTER_AREA)
    true, mask = small / np.float32(255), np.ones((96, 128), bool)
    found = [measure_detail(small, cv2.GaussianBlur(true, (0, 0), s), mask) for s in (0.5, 1.5)]
    assert found[0] > GOOD and found[1] < POOR


def test_shift_brings_back_detail_of_a_turned_camera_and_none_of_a_blurred_or_spoilt_picture(
    photograph,
):
    true = photograph / np.float32(255)
    found = {}
    for name, image in {
        "shifted": np.roll(true, (3, -5), axis=(0, 1)),
        "blurred": cv2.GaussianBlur(true, (0, 0), 3),
        "half of it gone": np.where(ALL[..., None] & (np.arange(400)[:, None] < 200), true, 0.5),
        "right": true,
    }.items():
        image = image.astype(np.float32)
        plain, shifted, *_ = measure_details(photograph, image, ALL)
        assert plain == measure(photograph, image), name
        found[name] = shifted - plain
    print(found)
    assert found.pop("shifted") > GOOD - POOR
    assert max(found.values()) < SHIFT_GAIN
    assert measure_details(photograph[:3, :3], true[:3, :3], ALL[:3, :3])[:2] == (1.0, 1.0)


def test_detail_under_a_veil_is_lost_and_of_a_darker_picture_is_not(photograph):
    true = photograph / np.float32(255)
    assert measure(photograph, 0.5 * true + 0.5 * true.mean()) < POOR
    assert measure(photograph, 0.5 * true) > GOOD


def test_wrong_patch_is_found_where_somebody_is_fog_and_nowhere_else(photograph):
    true = photograph / np.float32(255)
    ghost = true.copy()
    ghost[150:250, 175:225] = 0.2 * ghost[150:250, 175:225] + 0.4
    plain, _, where, outside = measure_details(photograph, ghost, ALL)
    assert outside > plain
    share = where.mean()
    area = 100 * 50 / ALL.size
    assert 0.5 * area < share < 2 * area
    for image in (true, cv2.GaussianBlur(true, (0, 0), 3)):
        assert not measure_details(photograph, image, ALL)[2].any()


@pytest.mark.parametrize(
    ("rows", "columns", "beside"),
    [((8, 12), (9, 11), True), ((8, 12), (11, 14), True), ((0, 3), (0, 16), False)],
)
def test_patch_is_beside_what_lies_in_it_or_within_a_cell(rows, columns, beside):
    patch, moved = np.zeros((600, 800), bool), np.zeros((12, 16), bool)
    patch[300:500, 350:520] = True
    moved[slice(*rows), slice(*columns)] = True
    assert is_beside(patch, moved) == beside
    assert not is_beside(patch & False, moved) and not is_beside(patch, None)
