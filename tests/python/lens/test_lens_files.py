"""Lens files: every format in and out, against OpenCV and real files."""

import json
import os
import struct

import cv2
import numpy as np
import pytest

import tolerances as tol
from gsut import CalibrationError, InputError
from gsut.lens import Camera, camera_models, load_camera, save_camera
from gsut.lens.files import (
    camera_from_colmap,
    camera_from_nerfstudio,
    list_binary_cameras,
)
from gsut.lens.files._format import list_formats
from lens_cases import all_lenses

# Each way to write a lens: the format and a file's name that chooses it.
WAYS = [
    pytest.param(each, pattern.replace("*", "x"), id=f"{each.name}-{pattern}")
    for each in list_formats()
    for pattern in each.names
]
COLMAP = (
    "division equirectangular extended_unified fisheye624 fov kannala_brandt opencv4 opencv5 "
    "opencv8 pinhole thin_prism_fisheye unified"
)
# Lenses that each format holds, at least with some parameters.
MODELS = {
    "colmap": COLMAP,
    "colmap-binary": COLMAP,
    "gsut": " ".join(camera_models()),
    "kalibr": "double_sphere extended_unified fov kannala_brandt mei opencv4 opencv5 pinhole "
    "unified",
    "mrcal": "cahvor cahvore latlon lonlat opencv12 opencv4 opencv5 opencv8 pinhole "
    "splined_stereographic stereographic",
    "nerfstudio": "equirectangular fisheye624 kannala_brandt opencv4 opencv5 opencv8 pinhole",
    "opencv": "kannala_brandt mei opencv12 opencv14 opencv4 opencv5 opencv8 pinhole",
}
# Fisheye files other than gsut's own have four coefficients, exactly.
MAX_FISHEYE_PARAMS = 8
FISHEYE = Camera("kannala_brandt", [300, 310, 320.25, 240.75, 0.01, -0.02, 0.003, -4e-05], 640, 480)


def assert_same_lens(found: Camera, expected: Camera) -> None:
    """The same lens; trailing coefficients that are zero may have come or gone."""
    assert (found.width, found.height) == (expected.width, expected.height)
    if expected.model == "unified" != found.model:  # the extended model with beta 1
        assert found.model == "extended_unified" and found.params[5] == 1.0
        found = Camera("unified", found.params[:5], found.width, found.height)
    longest = max(len(found.params), len(expected.params))
    padded = [np.pad(lens.params, (0, longest - len(lens.params))) for lens in (found, expected)]
    np.testing.assert_allclose(*padded, rtol=0, atol=tol.LENS_FILE_PARAMS)
    pixels = np.array([[0.5, 0.5], [expected.width / 2, expected.height / 3]])
    rays, valid = expected.unproject(pixels)
    again, valid_again = found.unproject(pixels)
    np.testing.assert_array_equal(valid_again, valid)
    np.testing.assert_allclose(again[valid], rays[valid], rtol=0, atol=tol.LENS_FILE_PARAMS)


def test_known_programs_have_a_format():
    assert {param.values[0].name for param in WAYS} == MODELS.keys()


@pytest.mark.parametrize(("lens_format", "name"), WAYS)
def test_saved_camera_reads_back_or_is_refused(lens_format, name, tmp_path):
    saved = refused = 0
    kind, path, models = lens_format.name, tmp_path / name, MODELS[lens_format.name].split()
    for camera in all_lenses():
        too_long = camera.model == "kannala_brandt" and len(camera.params) > MAX_FISHEYE_PARAMS
        skewed = kind == "kalibr" and camera.model == "mei" and camera.params[4] != 0.0
        if kind == "gsut":
            too_long = False
        three_radial = kind == "kalibr" and camera.model == "opencv5" and camera.params[8] != 0.0
        if camera.model not in models or too_long or skewed or three_radial:
            with pytest.raises(InputError, match=camera.model):
                save_camera(camera, path)
            refused += 1
            continue
        save_camera(camera, path)
        assert_same_lens(load_camera(path), camera)
        path.unlink()
        saved += 1
    fewest = {"gsut": len(all_lenses())}
    assert saved >= fewest.get(kind, 7) and saved + refused == len(all_lenses())
    assert os.listdir(tmp_path) == []


def test_save_with_format_overrides_the_name(tmp_path):
    for kind, word in [("kalibr", "cam0:"), ("opencv", "!!opencv-matrix"), ("colmap", "PINHOLE")]:
        path = tmp_path / "lens.yaml"
        save_camera(Camera("pinhole", [5, 6, 7, 8], 10, 11), path, format=kind)
        assert word in path.read_text()
    with pytest.raises(InputError, match=r"known: .*mrcal.*opencv"):
        save_camera(FISHEYE, tmp_path / "lens.yaml", format="vhs")
    wrong = {
        "lens.xyz": "chooses no format", "aria.json": "of Project Aria and writes none",
        "lens.matlab.json": "use a name without matlab",
    }  # fmt: skip
    for name, said in wrong.items():
        with pytest.raises(InputError, match=said):
            save_camera(FISHEYE, tmp_path / name)


def test_save_to_missing_folder_raises_and_failed_save_keeps_the_old_file(tmp_path):
    with pytest.raises(OSError):
        save_camera(FISHEYE, tmp_path / "absent" / "lens.yaml")
    path = tmp_path / "lens.cameramodel"
    save_camera(Camera("pinhole", [5, 6, 7, 8], 10, 11), path)
    before = path.read_text()
    with pytest.raises(InputError, match="kannala_brandt"):
        save_camera(FISHEYE, path)
    assert path.read_text() == before
    assert os.listdir(tmp_path) == ["lens.cameramodel"]


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_saved_opencv_file_is_read_by_opencv(suffix, tmp_path):
    path = tmp_path / f"lens{suffix}"
    save_camera(FISHEYE, path)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    expected = [[300, 0, 319.75], [0, 310, 240.25], [0, 0, 1]]
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), expected)
    coefficients = storage.getNode("distortion_coefficients").mat()
    np.testing.assert_array_equal(coefficients, FISHEYE.params[None, 4:])
    assert storage.getNode("image_width").real() == 640


# What OpenCV writes beside the image's size, and the lens that it is.
WRITTEN_BY_OPENCV = {
    "radial": (
        {"camera_matrix": [[300.1, 0, 319.5], [0, 301.25, 239.0], [0, 0, 1]],
         "distortion_coefficients": [[-0.25, 1e-05, 1e-3, -2e-3, 0.125]]},
        ("opencv5", [300.1, 301.25, 320.0, 239.5, -0.25, 1e-05, 1e-3, -2e-3, 0.125]),
    ),
    "omnidir": (
        {"camera_matrix": [[300.0, 0.5, 319.5], [0, 310, 239.5], [0, 0, 1]],
         "distortion_coefficients": [[-0.25, 0.01, 1e-3, -2e-3]], "xi": [[1.25]]},
        ("mei", [300, 310, 320, 240, 0.5, 1.25, -0.25, 0.01, 1e-3, -2e-3]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRITTEN_BY_OPENCV)
@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".json"])
def test_file_written_by_opencv_is_read(suffix, kind, tmp_path):
    matrices, lens = WRITTEN_BY_OPENCV[kind]
    path = tmp_path / f"lens{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    for key, rows in matrices.items():
        storage.write(key, np.array(rows))
    storage.release()
    assert load_camera(path) == Camera(*lens, 640, 480)


def test_ros_camera_info_is_read(tmp_path):
    path = tmp_path / "info.yaml"
    path.write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: left\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [300, 0, 319.5, 0, 310, 239.5, 0, 0, 1]\n"
        "distortion_model: equidistant\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 4\n  data: [0.1, 1e-2, 0, 0]\n"
    )
    expected = Camera("kannala_brandt", [300, 310, 320, 240, 0.1, 0.01, 0, 0], 640, 480)
    assert load_camera(path) == expected


def test_mrcal_file_keeps_extrinsics_region_and_field(tmp_path):
    region = [[10.5, 20.5], [600.25, 30.0], [300.0, 470.0]]
    camera = Camera(
        "opencv12",
        [500, 501, 320.3, 240.1, *np.linspace(-1e-2, 1e-2, 12)],
        640,
        480,
        extrinsics=[0.1, -0.2, 0.3, 1, 2, 3e-7],
        valid_region=region,
        valid_field_angle=0.5,
    )
    path = tmp_path / "lens.cameramodel"
    save_camera(camera, path)
    found = load_camera(path)
    assert found.valid_field_angle == 0.5
    np.testing.assert_array_equal(found.extrinsics, camera.extrinsics)
    np.testing.assert_allclose(found.valid_region, region, rtol=0, atol=tol.LENS_FILE_PARAMS)
    empty = Camera("pinhole", [5, 6, 7, 8], 10, 11, valid_region=np.zeros((0, 2)))
    save_camera(empty, path)
    assert load_camera(path).valid_region.shape == (0, 2)


def test_mrcal_real_files_are_read(shared):
    folder = shared / "data" / "lenses" / "mrcal"
    files = sorted(folder.glob("*.cameramodel"))
    assert len(files) == 6
    for path in files:
        camera = load_camera(path)
        splined = "splined" in path.name
        assert camera.model == ("splined_stereographic" if splined else "opencv8")
        assert camera.extrinsics.shape == (6,)
        assert (camera.valid_region is not None) == ("figueroa" in path.name)
    # The splined lens of a wide camera sees its image, but for a fold at the upper edge.
    wide = load_camera(folder / "figueroa-overpass-looking-S_splined-0.cameramodel")
    pixels = np.stack(np.meshgrid(np.linspace(0.5, 6015.5, 60), np.linspace(0.5, 4015.5, 40)), -1)
    rays, valid = wide.unproject(pixels.reshape(-1, 2))
    assert valid.mean() > 0.98
    back, _ = wide.project(rays[valid])
    assert np.abs(back - pixels.reshape(-1, 2)[valid]).max() < tol.ROUND_TRIP_PIXELS
    # cam0 has a fold inside the field; figueroa's principal point is moved by half a pixel.
    cam0 = load_camera(folder / "cam0.opencv8.cameramodel")
    assert np.degrees(cam0.max_angle) == pytest.approx(61.184, abs=1e-3)
    figueroa = load_camera(folder / "figueroa-overpass-looking-S_opencv8-0.cameramodel")
    np.testing.assert_allclose(figueroa.params[2:4], [3005.186823, 1997.877253], atol=1e-9)
    np.testing.assert_array_equal(figueroa.valid_region[0], [622.5, 0.5])


def test_real_transforms_files_are_read(shared):
    found = {}
    for path in sorted((shared / "data").glob("*/transforms.json")):
        found[path.parent.name] = load_camera(path)
    assert found["fox"].model == "opencv4"
    assert found["helmet_distorted_rs"].model == "opencv5"
    assert found["sponza_fisheye"].model == "kannala_brandt"
    assert found["sponza_fisheye"].valid_field_angle == pytest.approx(np.radians(95))
    assert (found["fox"].width, found["fox"].height) == (1080, 1920)
    assert len(found) == 4


COLMAP_CASES = [
    ("SIMPLE_PINHOLE", 0, [5, 7, 8], "pinhole", [5, 5, 7, 8]),
    ("PINHOLE", 1, [5, 6, 7, 8], "pinhole", [5, 6, 7, 8]),
    ("SIMPLE_RADIAL", 2, [5, 7, 8, 0.1], "opencv4", [5, 5, 7, 8, 0.1, 0, 0, 0]),
    ("RADIAL", 3, [5, 7, 8, 0.1, 0.2], "opencv4", [5, 5, 7, 8, 0.1, 0.2, 0, 0]),
    ("OPENCV", 4, [5, 6, 7, 8, 1, 2, 0.03, 0.04], "opencv4", [5, 6, 7, 8, 1, 2, 0.03, 0.04]),
    ("OPENCV_FISHEYE", 5, [5, 6, 7, 8, 1, 2, 3, 4], "kannala_brandt", [5, 6, 7, 8, 1, 2, 3, 4]),
    ("FULL_OPENCV", 6, [5, 6, 7, 8, *[0.1] * 8], "opencv8", [5, 6, 7, 8, *[0.1] * 8]),
    ("SIMPLE_RADIAL_FISHEYE", 8, [5, 7, 8, 0.1], "kannala_brandt", [5, 5, 7, 8, 0.1]),
    ("RADIAL_FISHEYE", 9, [5, 7, 8, 0.1, 0.2], "kannala_brandt", [5, 5, 7, 8, 0.1, 0.2]),
    ("FOV", 7, [5, 6, 7, 8, 0.9], "fov", [5, 6, 7, 8, 0.9]),
    ("THIN_PRISM_FISHEYE", 10, [5, 6, 7, 8, *[0.01] * 8], "thin_prism_fisheye", None),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 11, [5, 6, 7, 8, *[0.01] * 12], "fisheye624", None),
    ("SIMPLE_DIVISION", 12, [5, 7, 8, -0.1], "division", [5, 5, 7, 8, -0.1]),
    ("DIVISION", 13, [5, 6, 7, 8, -0.1], "division", None),
    ("SIMPLE_FISHEYE", 14, [5, 7, 8], "kannala_brandt", [5, 5, 7, 8]),
    ("FISHEYE", 15, [5, 6, 7, 8], "kannala_brandt", None),
    ("EUCM", 16, [5, 6, 7, 8, 0.6, 1.1], "extended_unified", None),
    ("EQUIRECTANGULAR", 17, [14, 16], "equirectangular", []),
]
# None: the same parameters.
COLMAP_CASES = [(*case[:4], case[2] if case[4] is None else case[4]) for case in COLMAP_CASES]


@pytest.mark.parametrize(("name", "number", "params", "model", "expected"), COLMAP_CASES)
def test_colmap_camera_by_name_and_number_is_the_lens(name, number, params, model, expected):
    camera = Camera(model, expected, 14, 16)
    assert camera_from_colmap(name, params, 14, 16) == camera
    assert camera_from_colmap(number, params, 14, 16, "cameras.bin") == camera


def colmap_files(folder) -> list:
    """The same cameras (ids 10, 11 ...) as text and as binary."""
    lines = ["# comment", ""]
    data = struct.pack("<Q", len(COLMAP_CASES))
    for key, (name, number, params, _, _) in enumerate(COLMAP_CASES, start=10):
        lines.append(f"{key} {name} 14 16 {' '.join(map(repr, params))}")
        data += struct.pack(f"<IiQQ{len(params)}d", key, number, 14, 16, *params)
    text_file, binary_file = folder / "cameras.txt", folder / "cameras.bin"
    text_file.write_text("\n".join(lines))
    binary_file.write_bytes(data)
    return [text_file, binary_file]


def test_colmap_files_with_several_cameras_ask_for_camera_id(tmp_path):
    for path in colmap_files(tmp_path):
        with pytest.raises(InputError, match="camera_id, one of 10, 11"):
            load_camera(path)
        with pytest.raises(InputError, match="no camera 7"):
            load_camera(path, camera_id=7)
        for key, (_, _, _, model, expected) in enumerate(COLMAP_CASES, start=10):
            assert load_camera(path, camera_id=key) == Camera(model, expected, 14, 16)


def test_kalibr_chain_with_two_cameras_asks_for_camera_id(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [300, 310, 319.5, 239.5]\n"
        "  distortion_model: equi\n  distortion_coeffs: [0.1, 0.01, 0, 0]\n"
        "  resolution: [640, 480]\n"
        "cam1:\n  camera_model: omni\n  intrinsics: [1, 300, 310, 319.5, 239.5]\n"
        "  resolution: [640, 480]\n"
    )
    with pytest.raises(InputError, match="cam0, cam1"):
        load_camera(path)
    expected = Camera("kannala_brandt", [300, 310, 320, 240, 0.1, 0.01, 0, 0], 640, 480)
    assert load_camera(path, camera_id="cam0") == load_camera(path, camera_id=0) == expected
    omni = Camera("mei", [300, 310, 320, 240, 0, 1, 0, 0, 0, 0], 640, 480)
    assert load_camera(path, camera_id="cam1") == omni
    path.write_text(path.read_text().replace("omni", "orbit"))
    with pytest.raises(CalibrationError, match=r"line 8, key 'camera_model': 'orbit'"):
        load_camera(path, camera_id="cam1")


NERFSTUDIO = {"w": 640, "h": 480.0, "fl_x": 300, "fl_y": 310, "cx": 320, "cy": 240}


@pytest.mark.parametrize(
    ("extra", "model", "coefficients"),
    [
        ({}, "pinhole", []),
        ({"k1": 0.0}, "pinhole", []),
        ({"k1": 0.1, "p2": 0.01}, "opencv4", [0.1, 0, 0, 0.01]),
        ({"camera_model": "OPENCV"}, "opencv4", [0, 0, 0, 0]),
        ({"camera_model": "OPENCV", "k3": 0.1}, "opencv5", [0, 0, 0, 0, 0.1]),
        ({"camera_model": "FULL_OPENCV", "k4": 0.1}, "opencv8", [0, 0, 0, 0, 0, 0.1, 0, 0]),
        ({"camera_model": "OPENCV_FISHEYE", "k4": 0.1}, "kannala_brandt", [0, 0, 0, 0.1]),
        ({"camera_model": "opencv_fisheye", "k4": 0.1}, "kannala_brandt", [0, 0, 0, 0.1]),
        ({"is_fisheye": True, "k1": 0.1}, "kannala_brandt", [0.1, 0, 0, 0]),
        (
            {"camera_model": "FISHEYE624", "distortion_params": [0.1, *[0.0] * 10, 0.01]},
            "fisheye624",
            [0.1, *[0.0] * 10, 0.01],
        ),
    ],
)
def test_nerfstudio_camera_of_each_model_is_the_lens(extra, model, coefficients):
    camera = camera_from_nerfstudio({**NERFSTUDIO, **extra}, "transforms.json")
    assert camera == Camera(model, [300, 310, 320, 240, *coefficients], 640, 480)


def test_nerfstudio_camera_without_focal_takes_the_angle():
    values = {"w": 640, "h": 480, "camera_angle_x": np.pi / 2}
    camera = camera_from_nerfstudio(values)
    assert camera.model == "pinhole"
    assert list(camera.params) == pytest.approx([320, 320, 320, 240])
    values["camera_angle_y"] = 2 * np.arctan(0.5)
    assert camera_from_nerfstudio(values).params[1] == pytest.approx(480)
    del values["camera_angle_x"]
    assert list(camera_from_nerfstudio(values).params[:2]) == pytest.approx([480, 480])
    limited = camera_from_nerfstudio({**NERFSTUDIO, "max_theta_rad": 0.5})
    assert limited.max_angle == pytest.approx(0.5)


def test_transforms_with_different_cameras_raises(tmp_path):
    path = tmp_path / "transforms.json"
    frames = [{"fl_x": 300}, {"fl_x": 300}, {"fl_x": 301}]
    path.write_text(json.dumps({**NERFSTUDIO, "frames": frames[:2]}))
    assert load_camera(path).params[0] == 300
    path.write_text(json.dumps({**NERFSTUDIO, "frames": frames}))
    with pytest.raises(InputError, match="2 different cameras"):
        load_camera(path)


def test_nerfstudio_panorama_needs_its_size_only():
    camera = camera_from_nerfstudio(
        {"camera_model": "EQUIRECTANGULAR", "w": 64, "h": 32, "fl_x": 7}
    )
    assert camera == Camera("equirectangular", [], 64, 32)


def test_aria_calibrations_are_read(shared):
    read = 0
    for path in sorted((shared / "data" / "lenses" / "aria").glob("*/calibration.json")):
        for label, entry in json.loads(path.read_text())["cameras"].items():
            camera = load_camera(path, camera_id=label)
            assert camera.model == "fisheye624"
            assert [camera.width, camera.height] == entry["size"]
            assert camera.params[0] == camera.params[1] == entry["params"][0]
            np.testing.assert_array_equal(camera.params[2:4], np.array(entry["params"][1:3]) + 0.5)
            assert camera.valid_field_angle == entry["max_solid_angle"]
            assert 0.98 * entry["max_solid_angle"] < camera.max_angle <= entry["max_solid_angle"]
            read += 1
        with pytest.raises(InputError, match="give camera_id, one of"):
            load_camera(path)
    assert read == 11


def test_saved_cameras_bin_is_read_as_a_data_set_reads_it(tmp_path):
    camera = Camera("division", [300, 310, 320.25, 240.75, -0.2], 640, 480)
    path = tmp_path / "cameras.bin"
    save_camera(camera, path)
    (row,) = list_binary_cameras(path.read_bytes(), "cameras.bin")
    assert (row.width, row.height, list(row.params)) == (640, 480, list(camera.params))
