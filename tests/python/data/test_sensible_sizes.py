"""Large photographs are decoded and kept small; below the limit nothing changes."""

import dataclasses

import cv2
import numpy as np
import pytest
from PIL import Image

import gsut
import tolerances as tol
from gsut.data.images import decode_image
from gsut.training.first import describe_resizing, prepare_scene

SIZE = 80, 60


@pytest.fixture
def dataset(tmp_path):
    """Three smooth JPEGs of 80 x 60, one with an EXIF orientation, with a lens and poses."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    for i in range(3):
        smooth = 127 + 100 * np.sin(x / 9 + i) * np.cos(y / 11)
        pixels = np.repeat(smooth.astype(np.uint8)[:, :, None], 3, axis=2)
        exif = Image.Exif()
        exif[0x0112] = 6 if i == 1 else 1
        Image.fromarray(pixels).save(tmp_path / f"{i}.jpg", exif=exif, quality=97)
    gsut.save_camera(
        gsut.Camera("pinhole", [60.0, 60.0, 40.0, 30.0], *SIZE), tmp_path / "lens.yaml"
    )
    lines = [f"{i}.jpg {0.1 * i} 0 0 0 0 0 1" for i in range(3)]
    (tmp_path / "poses.txt").write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.mark.parametrize(("part", "size"), [(1, (60, 80)), (2, (30, 40)), (8, (8, 10))])
def test_jpeg_is_decoded_at_a_part_of_its_size_as_stored(dataset, part, size):
    for i in range(3):
        pixels, valid = decode_image(dataset / f"{i}.jpg", part)
        assert pixels.shape == (*size, 3) and valid is None
    png = dataset / "a.png"
    cv2.imwrite(str(png), np.zeros((20, 30, 4), np.uint8))
    assert decode_image(png, part)[0].shape == (20, 30, 3)


def test_photographs_above_the_limit_are_used_smaller_and_said_so(dataset):
    scene = gsut.load_dataset(dataset)
    options = gsut.TrainOptions(max_side=36)
    prepared = prepare_scene(scene, options)
    (camera,) = prepared.cameras
    assert (camera.width, camera.height) == (36, 27)
    assert prepared.notes[-1] == describe_resizing(scene, options)
    assert "photographs of 80 x 60 are used at 36 x 27" in prepared.notes[-1]
    by_areas = scene.scale_images(0.45)
    for i in range(3):
        differs = np.abs(prepared.image(i).astype(int) - by_areas.image(i))
        assert differs.max() <= tol.REDUCED_DECODING_LEVELS
        assert prepared.mask(i).all()


def test_photographs_within_the_limit_keep_their_bits(dataset):
    scene = gsut.load_dataset(dataset)
    assert prepare_scene(scene, gsut.TrainOptions()) is scene
    assert prepare_scene(scene, gsut.TrainOptions(max_side=80)) is scene
    assert prepare_scene(scene, gsut.TrainOptions(max_side=0)) is scene
    half = prepare_scene(scene, gsut.TrainOptions(scale=0.5, max_side=10))
    np.testing.assert_array_equal(half.image(0), scene.scale_images(0.5).image(0))


def test_half_levels_of_a_limited_scene_come_from_its_own_pictures(dataset):
    scene = prepare_scene(gsut.load_dataset(dataset), gsut.TrainOptions(max_side=40))
    level = scene.scale_images(0.5, keep_larger=True)
    expected = cv2.resize(scene.image(1), (20, 15), interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(level.image(1), expected)
    assert dataclasses.replace(scene).decodes_small
