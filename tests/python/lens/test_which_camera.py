"""Of several lenses none is taken silently, nor one for a camera that a file has not."""

import cv2
import numpy as np
import pytest

import gsut
from gsut.data.rigs import read_mounts
from lens_cases import FOREIGN_FILES

FOREIGN_NAMED = ("aria.json", "calibration.xml", "camera_models.json")

SENSOR = (
    '<sensor id="{0}" label="{1}" type="frame"><resolution width="160" height="120"/><calibration '
    'type="frame" class="adjusted"><resolution width="160" height="120"/><f>{2}</f></calibration>'
    "</sensor>"
)


@pytest.fixture
def camera():
    return gsut.Camera("opencv5", [130, 130, 80, 60, -0.1, 0.01, 0, 0, 0], 160, 120)


def write_lens(camera, path):
    if path.name in FOREIGN_FILES:
        path.write_text(FOREIGN_FILES[path.name])
    else:
        gsut.save_camera(camera, path)


@pytest.mark.parametrize(
    "name",
    ["a.cameramodel", "a.lens.json", "a.yaml", "a.json", "matlab.json", "transforms.json"],
)
def test_camera_id_of_a_file_without_names_is_refused(camera, tmp_path, name):
    write_lens(camera, tmp_path / name)
    assert gsut.load_camera(tmp_path / name).width > 0
    with pytest.raises(gsut.InputError, match=r"has no camera right; it holds one lens"):
        gsut.load_camera(tmp_path / name, "right")


@pytest.mark.parametrize("name", ["camchain.yaml", "a.txt", "a.bin", *FOREIGN_NAMED])
def test_camera_id_that_a_file_has_not_is_refused(camera, tmp_path, name):
    write_lens(camera, tmp_path / name)
    with pytest.raises(gsut.InputError, match=r"has no (camera|sensor) right"):
        gsut.load_camera(tmp_path / name, "right")


def write_chunks(path, *chunks):
    body = "".join(
        f'<chunk enabled="{on}"><sensors>{"".join(sensors)}</sensors></chunk>'
        for on, *sensors in chunks
    )
    path.write_text(f'<?xml version="1.0"?><document version="2.0.0">{body}</document>')
    return path


def test_disabled_chunk_is_passed_over(tmp_path):
    path = write_chunks(
        tmp_path / "c.xml",
        ("false", SENSOR.format(0, "a", 150)), ("true", SENSOR.format(0, "a", 130)),
    )  # fmt: skip
    assert gsut.load_camera(path).params[0] == 130


def test_sensors_of_one_number_in_two_chunks_are_not_taken_for_each_other(tmp_path):
    path = write_chunks(
        tmp_path / "c.xml",
        ("true", SENSOR.format(0, "a", 150)), ("true", SENSOR.format(0, "b", 130)),
    )  # fmt: skip
    with pytest.raises(gsut.InputError, match="holds 2 sensors"):
        gsut.load_camera(path)
    with pytest.raises(gsut.InputError, match="2 sensors are called 0"):
        gsut.load_camera(path, 0)
    assert gsut.load_camera(path, "b").params[0] == 130


def test_spherical_sensor_without_calibration_is_equirectangular(tmp_path):
    sensor = '<sensor id="0" label="360" type="spherical"><resolution width="64" height="32"/>'
    lens = gsut.load_camera(write_chunks(tmp_path / "c.xml", ("true", sensor + "</sensor>")))
    assert (lens.model, lens.width, lens.height) == ("equirectangular", 64, 32)


def test_xml_of_opencv_is_read_as_its_yaml(tmp_path):
    lenses = []
    for name in ("a.yml", "a.xml"):
        file = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        file.write("image_width", 160)
        file.write("image_height", 120)
        file.write("camera_matrix", np.array([[130.0, 0, 79.5], [0, 131, 59.5], [0, 0, 1]]))
        file.write("distortion_coefficients", np.array([[-0.1, 0.01, 1e-4, -2e-4, 0.003]]))
        file.release()
        lenses.append(gsut.load_camera(tmp_path / name))
    text = (tmp_path / "a.xml").read_text()
    text = text.replace("<image_width>160</image_width>", "<image_size>160 120</image_size>")
    text = text.replace("distortion_coefficients", "dist_coeff")
    (tmp_path / "c.xml").write_bytes(text.encode("utf-16"))
    lenses.append(gsut.load_camera(tmp_path / "c.xml"))
    assert lenses[0] == lenses[1] == lenses[2] and lenses[0].model == "opencv5"
    (tmp_path / "b.xml").write_text("<opencv_storage><image_width>")
    with pytest.raises(gsut.CalibrationError, match="not XML"):
        gsut.load_camera(tmp_path / "b.xml")


YAML = (
    "image_width: 160\nimage_height: 120\ndistortion_model: plumb_bob\n"
    "camera_matrix: {rows: 3, cols: 3, data: [130, 0, 80, 0, 130, 60, 0, 0, 1]}\n"
)


@pytest.mark.parametrize(
    ("more", "word"),
    [
        ("roi: {x_offset: 40, y_offset: 30, height: 60, width: 80}\n", "roi"),
        ("binning_x: 2\nbinning_y: 2\n", "binning"),
    ],
)
def test_lens_of_a_part_of_the_picture_is_refused(tmp_path, more, word):
    (tmp_path / "lens.yaml").write_text(YAML + more)
    with pytest.raises(gsut.CalibrationError, match=word):
        gsut.load_camera(tmp_path / "lens.yaml")
    zero = "roi: {x_offset: 0, y_offset: 0, height: 0, width: 0}\nbinning_x: 0\nbinning_y: 1\n"
    (tmp_path / "lens.yaml").write_text(YAML + zero)
    assert gsut.load_camera(tmp_path / "lens.yaml").width == 160


def test_stereo_file_is_not_taken_for_its_first_camera(tmp_path):
    matrix = "{rows: 3, cols: 3, data: [130, 0, 80, 0, 130, 60, 0, 0, 1]}"
    (tmp_path / "stereo.yml").write_text(
        f"image_width: 160\nimage_height: 120\nM1: {matrix}\nM2: {matrix}\n"
    )
    with pytest.raises(gsut.CalibrationError, match="second camera"):
        gsut.load_camera(tmp_path / "stereo.yml")


@pytest.mark.parametrize("head", ["", "%YAML:1.0\n\n"])
def test_pose_of_a_camera_on_the_imu_is_read_either_way(camera, tmp_path, head):
    gsut.save_camera(camera, tmp_path / "camchain.yaml")
    lens = (tmp_path / "camchain.yaml").read_text()
    pose = np.array([[0, -1, 0, 0.05], [1, 0, 0, -0.02], [0, 0, 1, 0.1], [0, 0, 0, 1.0]])
    found = []
    for key, value in (("T_imu_cam", pose), ("T_cam_imu", np.linalg.inv(pose))):
        (tmp_path / "camchain.yaml").write_text(f"{head}{lens}  {key}: {value.tolist()}\n")
        found.append(read_mounts(tmp_path / "camchain.yaml", ["cam0"])["cam0"].from_body)
    np.testing.assert_allclose(found[0], np.linalg.inv(pose), atol=1e-12)
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)
