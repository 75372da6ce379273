"""Files that no parser expects: each ends in one sentence of ours that names it, and soon."""

import json
import time

import cv2
import numpy as np
import pytest

import gsut
from gsut import CalibrationError, DatasetError
from tolerances import SECONDS_TO_REFUSE

DEEP = "[" * 100_000
DIGITS = "9" * 5000
LENS = {"camera_model": "OPENCV_FISHEYE", "fl_x": 90, "fl_y": 90, "cx": 50, "cy": 40, "w": 100,
        "h": 80, "k1": 0.01}  # fmt: skip
NINES = "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)
)
BOMB = f"a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n{NINES}"
IDENTITY = np.eye(4).tolist()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("deep.json", DEEP),
        ("deep.yaml", DEEP[:20_000]),
        ("digits.json", f'{{"camera_model": {DIGITS}}}'),
        ("digits.yaml", f"image_width: {DIGITS}\nimage_height: 1\ncamera_matrix: [1]\n"),
        ("float.yaml", "camera_matrix: !!float x\n"),
        ("bomb.yaml", f"{BOMB}camera_matrix: {{data: *j}}\nimage_width: 9\nimage_height: 9\n"),
        ("list.json", '{"fl_x": {"a": []}, "camera_model": [], "w": {}}'),
        ("deep.xml", "<a>" * 50_000),
        ("words.txt", "1 PINHOLE wide high 1 2 3 4\n"),
        ("cut.bin", "\x01"),
        ("model.cameramodel", "{" * 50_000),
    ],
)
def test_lens_file_that_cannot_be_understood(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    started = time.process_time()
    with pytest.raises(CalibrationError, match=name):
        gsut.load_camera(path)
    assert time.process_time() - started < SECONDS_TO_REFUSE


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"k1": 1e300}, "all pixels look in one direction"),
        ({"fl_x": 5956, "fl_y": 449}, r"fx = 5956 and fy = 449 differ by a factor of 13.3"),
        ({"fl_x": 1e9, "fl_y": 1e9}, r"fx = 1e\+09 pixels does not go with an image 100 x 80"),
        ({"fl_x": 1e-9, "fl_y": 1e-9}, "does not go with an image"),
        ({"cx": 1e9}, "cx is 1e\\+09"),
        ({"w": 1 << 31}, "from 1 to 65536, found 2147483648"),
        ({"k1": -1e5, "cx": -500}, "no pixel has a ray"),
    ],
)
def test_lens_that_none_can_be_is_refused_by_name(tmp_path, changes, said):
    path = tmp_path / "lens.json"
    path.write_text(json.dumps(LENS | changes))
    with pytest.raises(CalibrationError, match=rf"lens.json.*{said}"):
        gsut.load_camera(path)


@pytest.mark.parametrize("width", [5.7, 0, -3, 2**31, float("nan"), "640", None])
def test_camera_of_no_whole_number_of_pixels_is_refused(width):
    with pytest.raises(gsut.InputError, match="whole numbers of pixels from 1 to 65536, found"):
        gsut.Camera("pinhole", [10, 10, 3, 3], width, 6)


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (DEEP, "cannot be understood"),
        (f"[{DIGITS}]", "cannot be understood"),
        ("[7]", "transforms.json"),
        ('[{"file_path": ""}]', "transforms.json"),
        ('[{"file_path": "a.png", "transform_matrix": [[1e300]]}]', "the pose has shape"),
        (json.dumps([{"file_path": "a.png", "transform_matrix": 4 * [[1e300] * 4]}]), "holds 1e"),
        (json.dumps([{"file_path": ["a.png"], "transform_matrix": IDENTITY}]), "file_path"),
        (json.dumps([{"file_path": "a.png", "transform_matrix": "x"}]), "not a matrix of numbers"),
    ],
)
def test_dataset_that_cannot_be_understood(tmp_path, frames, said):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((80, 100, 3), np.uint8))
    values = json.dumps(LENS)[:-1]
    (tmp_path / "transforms.json").write_text(f'{values}, "frames": {frames}}}')
    with pytest.raises(DatasetError, match=str(tmp_path)) as caught:
        gsut.load_dataset(tmp_path)
    assert said in str(caught.value)
