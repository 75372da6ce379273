"""Bad lens files: one clear sentence with file, line and key."""

import pytest
from test_lens_files_ocam import text_of
from test_lens_files_photogrammetry import FRAME

from gsut import CalibrationError, InputError
from gsut.lens import load_camera
from gsut.lens.files import camera_from_nerfstudio

NERFSTUDIO = {"w": 640, "h": 480.0, "fl_x": 300, "fl_y": 310, "cx": 320, "cy": 240}
BAD_NERFSTUDIO = [
    ({"w": None}, "key 'w'"),
    ({"w": 640.5}, "key 'w': expected a positive whole number"),
    ({"fl_x": "wide"}, "key 'fl_x': expected a finite number, found 'wide'"),
    ({"camera_model": "ORTHOPHOTO"}, "ORTHOPHOTO.*supported: .*OPENCV_FISHEYE"),
    ({"camera_model": "FISHEYE624"}, "key 'distortion_params': is missing"),
    ({"camera_model": "OPENCV", "k4": 0.1}, "key 'k4': .*FULL_OPENCV"),
    ({"camera_model": "OPENCV_FISHEYE", "p1": 0.1}, "key 'p1'"),
    ({"camera_model": "PINHOLE", "k1": 0.1}, "yet the file gives distortion"),
]


@pytest.mark.parametrize(("change", "message"), BAD_NERFSTUDIO)
def test_nerfstudio_camera_of_bad_values_names_the_key(change, message):
    with pytest.raises(CalibrationError, match=f"^some/transforms.json.*{message}"):
        camera_from_nerfstudio({**NERFSTUDIO, **change}, "some/transforms.json")


MRCAL = (
    "{\n 'lensmodel': 'LENSMODEL_PINHOLE',\n 'intrinsics': [ 5., 6, 7, 8 ],\n"
    " 'extrinsics': [ 0,0,0,0,0,0 ],\n 'imagersize': [ 10, 11 ] }\n"
)
SPLINED = "SPLINED_STEREOGRAPHIC_order=3_Nx=4_Ny=4_fov_x_deg=90"
OPENCV = (
    "%YAML:1.0\n---\nimage_width: 64\nimage_height: 48\ncamera_matrix: !!opencv-matrix\n"
    "   rows: 3\n   cols: 3\n   dt: d\n   data: [ 30., 0., 31.5, 0., 30., 23.5, 0., 0., 1. ]\n"
)
BAD_FILES = [
    ("a.cameramodel", "", "line 1: expected a value, the file ends"),
    ("a.cameramodel", MRCAL[:60], "line 3: .*the file ends"),
    ("a.cameramodel", MRCAL.replace("5.", "5.x"), "line 3: expected ']', found 'x'"),
    ("a.cameramodel", MRCAL.replace("5.,", ""), "line 3, key 'intrinsics': pinhole takes"),
    ("a.cameramodel", MRCAL.replace("'lensm", "'m"), "key 'lensmodel' is missing"),
    ("a.cameramodel", MRCAL.replace("[ 10", "[ 1.5"), "line 5, key 'imagersize'"),
    ("a.cameramodel", MRCAL.replace("0,0,0,0,0,0", "0"), "line 4, key 'extrinsics': .*6 numbers"),
    ("a.cameramodel", MRCAL + "x", "line 6: expected the end of the file"),
    ("a.yaml", OPENCV.replace("image_width", "wide"), "key 'image_width': is missing"),
    ("a.yaml", OPENCV.replace("0., 31.5", "0.1, 31.5"), "line 5, key 'camera_matrix': .*skew"),
    ("a.yaml", OPENCV.replace("31.5, ", ""), "line 5, key 'camera_matrix': expected 9"),
    ("a.yaml", OPENCV + "D: [1, 2, 3]\n", "line 10, key 'D': expected 4, 5, 8, 12, 14"),
    ("a.yaml", OPENCV + "fisheye: 1\n", "a fisheye has 4 coefficients, found 0"),
    ("a.yaml", OPENCV + "lens_dist: [1, 2, 3, 4]\n", "line 10, key 'lens_dist': is it the dist"),
    ("a.yaml", OPENCV.replace("30.", "0.05"), "fx is 0.05 pixels.*millimetres"),
    ("a.yaml", OPENCV[:-10], "not YAML"),
    ("a.yaml", "x: 1\n", "holds none of cameras .*camera_matrix"),
    ("a.yaml", "Camera.fx: 1.0\n", "a lens file of ORB-SLAM, which is not read: write image_w"),
    ("a.json", '{"value0": {"intrinsics": []}}', "a lens file of Basalt, which is not read"),
    ("a.yml", "K1: [1.0]\nK2: [1.0]\n", "a lens file of two cameras, which is not read"),
    ("a.json", '{"fl_x": 1,', "not valid JSON at line 1"),
    ("a.json", '{\n"w": 1,\n"h": 1,\n"fl_x": "no"}', "line 4, key 'fl_x'"),
    ("cameras.txt", "# nothing\n", "holds no camera"),
    ("cameras.txt", "1 PINHOLE 10 x 1 1 1 1\n", "line 1: "),
    ("cameras.txt", "1 PINHOLE 10 11 1 1 1\n", "PINHOLE has 4 parameters, found 3"),
    (
        "cameras.txt",
        "\n1 VOF 10 11 1 1 1 1 1\n",
        "line 2 .*VOF is not supported; supported: SIMPLE",
    ),
    ("cameras.txt", "1 EQUIRECTANGULAR 10 5 20 10\n", "not the image's size 10 x 5"),
    ("a.yaml", OPENCV + "xi: 1.5\nD: [1, 2, 3]\n", "line 11, key 'D': omnidir has 4"),
    (
        "a.cameramodel",
        MRCAL.replace("PINHOLE", "SPLINED_STEREOGRAPHIC_order=3"),
        "line 2, key 'len",
    ),
    (
        "a.cameramodel",
        MRCAL.replace("PINHOLE", SPLINED),
        "line 3, key 'intrinsics': splined_stereographic takes",
    ),
    ("a.json", '{"cameras": {"a": {"model": "X", "params": [1]}}}', "key 'model': 'X'"),
    ("lens.csv", "x,y,rx,ry,rz\n1,2,0,0,1\n", "there is no width"),
    ("lens.csv", "# width: 9\n# height: 9\n1,2,0,0\n", "row 1: expected 5 numbers"),
    ("lens.csv", "# width: 9\n# height: 9\n# model: pinhole\n1,2,0,0,1\n", "a fit needs 8"),
]
# What is replaced in a whole file, and the message.
BAD_OCAM = [
    ("5 -289", "6 -289", "line 3.*polynomial.*expected 7"),
    ("0.0 0.00177", "0.1 0.00177", "line 3.*0.1.*smooth"),
    ("800 848", "", "image size.*cut off"),
    ("800 848", "800 zero", "line 19.*image size.*zero"),
    ("387.121004 417.520087", "387.121004", "line 11.*center.*2 finite"),
    ("-289.7359", "289.7359", "a0"),
]
BAD_METASHAPE = [
    ("<f>1430.15016509976</f>", "", "'f'.*missing"),
    ("frame", "cylindrical", "cylindrical.*fisheye"),
    ("</calibration>", "", "line.*not XML|not XML.*line"),
    ("<k1>-", "<k1>x", "k1.*finite"),
    ("</p1>", "</p1><p3>1</p3>", "p3"),
    ("calibration>", "other>", "no <calibration>"),
]
for name, whole, rows in (
    ("calib_results.txt", text_of("800 848"), BAD_OCAM),
    ("bad.xml", FRAME.format(projection="frame"), BAD_METASHAPE),
):
    assert all(old in whole for old, _, _ in rows)
    BAD_FILES += [(name, whole.replace(old, new), message) for old, new, message in rows]


@pytest.mark.parametrize(("name", "text", "message"), BAD_FILES)
def test_bad_file_raises_naming_file_line_and_key(name, text, message, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        load_camera(path)
    assert str(path) in str(caught.value)


def test_unknown_kind_of_file_raises(tmp_path):
    path = tmp_path / "lens.toml"
    path.write_text("<xml/>")
    with pytest.raises(InputError, match=r"known: .*\.cameramodel \(mrcal\)"):
        load_camera(path)
    with pytest.raises(FileNotFoundError):
        load_camera(tmp_path / "absent.yaml")
    binary = tmp_path / "lens.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CalibrationError, match="not text"):
        load_camera(binary)
