"""The doctor says what share of the pictures masks leave out, and which masks seem wrong."""

import cv2
import numpy as np
import pytest

import gsut
import small_datasets
from gsut.check.masks import check_masks


@pytest.mark.parametrize(
    ("inside", "outside", "words", "severity"),
    [
        (0, 255, "leave out 25 % of the pixels", "info"),
        (255, 255, "leave nothing out", "warning"),
        (255, 0, "leave out 75 % of the pixels, with more detail", "warning"),
    ],
)
def test_share_of_masks_is_stated(tmp_path, inside, outside, words, severity):
    folder = small_datasets.write_colmap_text(tmp_path)
    size = small_datasets.HEIGHT, small_datasets.WIDTH
    for path in sorted((folder / "images").rglob("*.png")):
        noise = np.random.default_rng(1).integers(0, 256, (*size, 3), np.uint8)
        noise[: size[0] // 2, : size[1] // 2] = 90  # a plain quarter
        cv2.imwrite(str(path), noise)
        mask = np.full(size, outside, np.uint8)
        mask[: size[0] // 2, : size[1] // 2] = inside
        file = folder / "masks" / path.relative_to(folder / "images").with_suffix(".png")
        file.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(file), mask)
    (found,) = check_masks(gsut.load_dataset(folder))
    assert words in found.what and found.severity == severity
    assert bool(found.advice) == (severity == "warning")


def test_dataset_without_masks_has_no_such_finding(tmp_path):
    folder = small_datasets.write_colmap_text(tmp_path)
    assert list(check_masks(gsut.load_dataset(folder))) == []
