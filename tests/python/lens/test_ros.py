"""Lenses from and to the fields of ROS' CameraInfo."""

from types import SimpleNamespace

import numpy as np
import pytest

import gsut
from gsut.lens.files._camera_info import _MODELS
from lens_cases import examples

HELD = [
    camera
    for model, (_, count) in _MODELS.items()
    for camera in examples(model)
    if len(camera.params) <= 4 + count
]


def test_every_lens_of_a_message_has_examples():
    assert {camera.model for camera in HELD} == set(_MODELS)


@pytest.mark.parametrize("camera", HELD, ids=lambda c: f"{c.model}-{c.width}")
@pytest.mark.parametrize("make", [dict, lambda **fields: SimpleNamespace(**fields)])
def test_lens_comes_back_from_its_message(camera, make):
    info = gsut.lens.info_from_camera(camera)
    found = gsut.lens.camera_from_info(make(**info))
    assert (found.width, found.height) == (camera.width, camera.height)
    points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.1, 1.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(found.project(points)[0], camera.project(points)[0])


def test_message_of_ros_1_and_rectified_pictures_are_read():
    message = {"width": 64, "height": 48, "distortion_model": "plumb_bob", "D": [0.1, 0, 0, 0, 0],
               "K": [50, 0, 31.5, 0, 50, 23.5, 0, 0, 1],
               "P": [40, 0, 31.5, 0, 0, 40, 23.5, 0, 0, 0, 1, 0]}  # fmt: skip
    assert list(gsut.lens.camera_from_info(message).params) == [50, 50, 32, 24, 0.1, 0, 0, 0, 0]
    rectified = gsut.lens.camera_from_info(message, rectified=True)
    assert rectified.model == "pinhole" and list(rectified.params) == [40, 40, 32, 24]


def test_lens_that_no_message_holds_is_refused():
    with pytest.raises(gsut.InputError, match=r"not mei; .*convert_camera"):
        gsut.lens.info_from_camera(examples("mei")[0])


def test_message_of_a_part_of_the_picture_is_refused():
    info = gsut.lens.info_from_camera(examples("opencv5")[0])
    with pytest.raises(gsut.InputError, match="'roi'"):
        gsut.lens.camera_from_info(info | {"roi": {"x_offset": 8, "y_offset": 0}})
    with pytest.raises(gsut.InputError, match="K is all zero"):
        gsut.lens.camera_from_info(info | {"k": [0.0] * 9})
