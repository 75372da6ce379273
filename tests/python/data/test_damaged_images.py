"""JPEG files damaged inside: decoders fill in what is missing without a word; gsut does not."""

import cv2
import numpy as np
import pytest

from gsut import DatasetError
from gsut.data.images import decode_image


@pytest.fixture
def jpeg(rng):
    """Bytes of a picture with detail everywhere."""
    pixels = cv2.GaussianBlur(rng.integers(0, 256, (600, 800, 3), np.uint8), (0, 0), 1.5)
    return bytearray(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())


def test_jpeg_has_the_pixels_of_opencv_at_every_part_of_its_size(tmp_path, jpeg):
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg)
    flags = {
        1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4,
        8: cv2.IMREAD_REDUCED_COLOR_8,
    }  # fmt: skip
    for part, flag in flags.items():
        pixels, valid = decode_image(path, part)
        np.testing.assert_array_equal(pixels[..., ::-1], cv2.imread(str(path), flag))
        assert valid is None


def test_grey_jpeg_is_repeated(tmp_path, jpeg):
    grey = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(tmp_path / "a.jpg"), grey)
    pixels, _ = decode_image(tmp_path / "a.jpg")
    stored = cv2.imread(str(tmp_path / "a.jpg"), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(pixels, np.repeat(stored[..., None], 3, axis=2))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_jpeg_with_a_hole_of_zeros_is_named(tmp_path, jpeg, share):
    path = tmp_path / "a.jpg"
    at = int(share * len(jpeg))
    jpeg[at : at + 4096] = bytes(4096)  # a page of a disk
    path.write_bytes(jpeg)
    with pytest.raises(DatasetError, match=r"a.jpg: the JPEG file is damaged: .*; copy or export"):
        decode_image(path)


def test_jpeg_padded_by_its_camera_is_read(tmp_path, jpeg):
    path = tmp_path / "a.jpg"
    whole = decode_from(path, jpeg)
    padded = decode_from(path, jpeg[:-2] + bytes(7) + jpeg[-2:])
    np.testing.assert_array_equal(padded, whole)


@pytest.mark.parametrize("flag", [cv2.IMWRITE_JPEG_OPTIMIZE, cv2.IMWRITE_JPEG_QUALITY])
@pytest.mark.parametrize("blank", [b"\0", b"\xff"])
@pytest.mark.parametrize("share", [0.3, 0.97])
def test_jpeg_of_blanks_up_to_an_intact_end_is_named(tmp_path, jpeg, share, blank, flag):
    pixels = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    data = cv2.imencode(".jpg", pixels, [flag, 30 if flag == cv2.IMWRITE_JPEG_QUALITY else 1])[
        1
    ].tobytes()
    kept = int(share * len(data))
    blanked = data[:kept] + blank * (len(data) - kept - 2) + data[-2:]
    with pytest.raises(DatasetError, match=r"a.jpg: the JPEG file is damaged: .*; copy or export"):
        decode_from(tmp_path / "a.jpg", blanked)
    padded = decode_from(tmp_path / "a.jpg", data[:-2] + blank * 5000 + data[-2:])
    np.testing.assert_array_equal(padded, decode_from(tmp_path / "a.jpg", data))


def decode_from(path, data):
    path.write_bytes(data)
    return decode_image(path)[0]
