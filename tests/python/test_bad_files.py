"""Files that no parser expects: each ends in one sentence of ours that names it, and soon."""

import pickle
import re
import time

import numpy as np
import pytest

import gsut
from gsut import CalibrationError
from lens_cases import FOREIGN_FILES
from tolerances import SECONDS_TO_REFUSE

DEEP = "[" * 100_000
DIGITS = "9" * 5000
NINES = "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)
)
BOMB = f"a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n{NINES}"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("deep.json", DEEP),
        ("digits.json", f'{{"camera_model": {DIGITS}}}'),
        ("float.yaml", "camera_matrix: !!float x\n"),
        ("bomb.yaml", f"{BOMB}camera_matrix: {{data: *j}}\nimage_width: 9\nimage_height: 9\n"),
        ("deep.xml", "<a>" * 50_000),
        ("words.txt", "1 PINHOLE wide high 1 2 3 4\n"),
        ("cut.bin", "\x01"),
    ],
)
def test_lens_file_that_cannot_be_understood(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    started = time.process_time()
    with pytest.raises(CalibrationError, match=name):
        gsut.load_camera(path)
    assert time.process_time() - started < SECONDS_TO_REFUSE


FISHEYE = ("kannala_brandt", [90, 91.25, 64, 48, 0.25, 0, 0, 0])
BARREL = ("opencv5", [90, 91.25, 64, 48, 0.25, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("name", "lens", "changes", "said"),
    [
        ("a.lens.json", FISHEYE, {0.25: 1e300}, "'params': .*k1 is 1e"),
        ("a.yaml", FISHEYE, {91.25: 1300}, "line 6, key 'camera_matrix': .*fx is 90 and fy"),
        ("a.yaml", FISHEYE, {0.25: 1e300}, "'distortion_coefficients': .*k1 is"),
        ("a.json", BARREL, {0.25: 1e300}, "line .*'distortion_coefficients': .*k1 is"),
        ("camchain.yaml", FISHEYE, {91.25: 1300}, "line .*'intrinsics': .*fx is 90 and fy"),
        ("camchain.yaml", FISHEYE, {0.25: 1e300}, "line .*'distortion_coeffs': .*k1 is"),
        ("transforms.json", FISHEYE, {0.25: 1e300}, "line .*'k1': .*k1 is"),
        ("aria.json", None, {0.25: 1e300}, "line .*'params': .*k1 is"),
        ("matlab.json", None, {0.25: 1e300}, "line .*'RadialDistortion': .*k1 is"),
        ("camera_models.json", None, {0.25: 1e300}, "line .*'k1': .*k1 is"),
        ("camera_models.json", None, {90 / 128: 9}, "line .*'focal_x': .*fx is"),
        ("calibration.xml", None, {0.25: 1e300}, "key 'k1': .*k1 is"),
        ("a.cameramodel", BARREL, {0.25: 1e300}, "line .*'intrinsics': .*k1 is"),
        ("calib_results.txt", None, {63.625: 1e8}, "key 'center': .*cx is"),
        ("cameras.txt", FISHEYE, {0.25: 1e300}, r"line 3 \(camera 1\): .*k1 is"),
    ],
)
def test_lens_that_none_can_be_is_refused_by_key_in_every_format(
    name, lens, changes, said, tmp_path
):
    path, changed = tmp_path / name, 0
    if lens is None:
        path.write_text(FOREIGN_FILES[name])
    else:
        gsut.save_camera(gsut.Camera(*lens, 128, 96), path)

    def change(match):
        nonlocal changed
        value = changes.get(float(match[0]))
        changed += value is not None
        return match[0] if value is None else str(value)

    path.write_text(re.sub(r"-?\d+\.\d+(e[-+]\d+)?", change, path.read_text()))
    assert changed == 1
    with pytest.raises(CalibrationError, match=rf"{name}, .*{said}"):
        gsut.load_camera(path)


@pytest.mark.parametrize(
    ("model", "params", "said"),
    [
        ("kannala_brandt", [90, 91, 64, 48, 1e300, 0, 0, 0], r"k1 is 1e\+300; with it all pixels"),
        ("kannala_brandt", [90, 91, 64, 48, -1e5, 0, 0, 0], "k1 is -100000; with it no pixel has"),
        ("pinhole", [1300, 100, 64, 48], "fx is 1300 and fy is 100; they differ by a factor of 13"),
        ("pinhole", [100, 100, 64, 1e8], r"cy is 1e\+08; with it all pixels look in one"),
        ("pinhole", [-3, 3, 64, 48], "fx is -3; it must be positive"),
        ("pinhole", [1e-3, 1e-3, 64, 48], "fx is 0.001 pixels; it does not go with"),
    ],
)
def test_camera_of_numbers_that_no_lens_has_is_refused_by_name(model, params, said):
    with pytest.raises(gsut.InputError, match=f"^{model}: .*{said}"):
        gsut.Camera(model, params, 128, 96)
    with pytest.raises(gsut.InputError, match="valid_field_angle is 1e-09; with it"):
        gsut.Camera("pinhole", [100, 100, 64.2, 48], 128, 96, valid_field_angle=1e-9)
    with pytest.raises(gsut.InputError, match="extrinsics must be finite"):
        gsut.Camera("pinhole", [9, 9, 3, 3], 6, 6, extrinsics=[0, 0, 0, 0, 0, np.inf])
    anamorphic = gsut.Camera("pinhole", [200, 100, 64, 48], 128, 96)
    assert pickle.loads(pickle.dumps(anamorphic)) == anamorphic


@pytest.mark.parametrize("width", [5.7, 0, -3, 2**31, float("nan"), "640", None, True])
def test_camera_of_no_whole_number_of_pixels_is_refused(width):
    with pytest.raises(gsut.InputError, match="whole numbers of pixels from 1 to 65536, found"):
        gsut.Camera("pinhole", [10, 10, 3, 3], width, 6)
    with pytest.raises(gsut.InputError, match="whole numbers of pixels from 1 to 65536, found"):
        gsut.Camera("pinhole", [10, 10, 3, 3], 6, 6).resize(width, 6)
