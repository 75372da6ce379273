"""Broken datasets: each gives one clear sentence, from the loader and from the doctor."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
import small_datasets as small
from gsut.data import load_dataset
from gsut.data.doctor import diagnose

# name -> (function that writes a broken dataset, parts that the message must hold)
CASES: dict = {}


def case(*parts):
    """Registers a function that writes a broken dataset."""

    def register(write):
        CASES[write.__name__] = (write, parts)
        return write

    return register


def edit(path: Path, change) -> None:
    values = small.transforms()
    change(values)
    small.write_nerfstudio(path, values)


def edit_pose(path: Path, change, frame: int = 3) -> None:
    def apply(values):
        matrix = np.array(values["frames"][frame]["transform_matrix"])
        values["frames"][frame]["transform_matrix"] = change(matrix)

    edit(path, apply)


def replace_text(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


# --- places ---------------------------------------------------------------------------------------
@case("does not exist", "check the path")
def missing_folder(path):
    path.rmdir()


@case("no dataset found", "transforms.json", "sparse/0", "lens file")
def empty_folder(path):
    pass


@case("transforms.json", "lists no images")
def no_frames(path):
    edit(path, lambda values: values["frames"].clear())


@case("transforms.json", "none of its 10 images exist", "images/000.png")
def no_image_exists(path):
    small.write_nerfstudio(path)
    for name in small.names():
        (path / name).unlink()


@case("no lens file", "gsut calibrate")
def folder_without_lens(path):
    small.write_folder(path)
    (path / "cameras.txt").unlink()


@case("neither of ('poses.txt', 'poses.json')", "gsut poses")
def folder_without_poses(path):
    small.write_folder(path)
    (path / "poses.txt").unlink()


# --- images ---------------------------------------------------------------------------------------
@case("images/004.png", "PNG file is truncated", "copy")
def png_cut_off(path):
    small.write_nerfstudio(path)
    image = path / "images/004.png"
    image.write_bytes(image.read_bytes()[:-300])


@case("images/004.png", "wrong checksum")
def png_damaged(path):
    small.write_nerfstudio(path)
    image = path / "images/004.png"
    data = bytearray(image.read_bytes())
    data[len(data) // 2] ^= 0xFF
    image.write_bytes(bytes(data))


@case("images/004.jpg", "JPEG file is truncated")
def jpeg_cut_off(path):
    edit(path, lambda values: values["frames"][4].update(file_path="images/004.jpg"))
    picture = small.render(small.world_from_cameras()[4])
    (path / "images/004.jpg").write_bytes(cv2.imencode(".jpg", picture)[1].tobytes()[:-200])


@case("images/004.jpg", "truncated in its header")
def jpeg_cut_off_in_header(path):
    edit(path, lambda values: values["frames"][4].update(file_path="images/004.jpg"))
    (path / "images/004.jpg").write_bytes(b"\xff\xd8\xff\xe0\x00\x10JF")


@case("images/004.png", "cannot be decoded")
def image_is_text(path):
    small.write_nerfstudio(path)
    (path / "images/004.png").write_text("<html>404 not found</html>")


@case("images/004.png", "empty")
def image_is_empty(path):
    small.write_nerfstudio(path)
    (path / "images/004.png").write_bytes(b"")


@case("images/004.png", "the image is 20 x 36", "expects 48 x 36", "uncropped")
def image_of_wrong_size(path):
    small.write_nerfstudio(path)
    small.write_png(path / "images/004.png", np.zeros((36, 20, 3), np.uint8))


@case("images/004.png", "the image is 36 x 48", "turned")
def image_turned(path):
    small.write_nerfstudio(path)
    small.write_png(path / "images/004.png", np.zeros((48, 36, 3), np.uint8))


@case("mask.png", "the mask is 10 x 10, the image 48 x 36")
def mask_of_wrong_size(path):
    edit(path, lambda values: values.update(mask_path="mask.png"))
    small.write_png(path / "mask.png", np.full((10, 10), 255, np.uint8))


@case("frame images/002.png", "mask_path 'no.png' does not exist")
def mask_missing(path):
    edit(path, lambda values: values["frames"][2].update(mask_path="no.png"))


# --- transforms.json ------------------------------------------------------------------------------
@case("transforms.json", "not valid JSON at line 1, column", "cut off")
def json_cut_off(path):
    small.write_nerfstudio(path)
    file = path / "transforms.json"
    file.write_text(file.read_text()[:700])


@case("transforms.json", "byte 0 is not UTF-8")
def json_is_binary(path):
    small.write_nerfstudio(path)
    (path / "transforms.json").write_bytes(b"\xff\xfe{\x00")


@case("transforms.json", "no list 'frames'")
def json_without_frames(path):
    edit(path, lambda values: values.pop("frames"))


@case("frame 5", "no 'file_path'")
def frame_without_name(path):
    edit(path, lambda values: values["frames"][5].pop("file_path"))


@case("frame images/005.png", "no 'transform_matrix'")
def frame_without_pose(path):
    edit(path, lambda values: values["frames"][5].pop("transform_matrix"))


@case("frame images/005.png", "only one of transform_matrix_start")
def shutter_without_end(path):
    edit(path, lambda v: v["frames"][5].update(transform_matrix_start=np.eye(4).tolist()))


@case("frame images/003.png", "the pose holds nan in row 1, column 2")
def pose_nan(path):
    def change(matrix):
        matrix[1, 2] = np.nan
        return matrix.tolist()

    edit_pose(path, change)


@case("frame images/003.png", "the pose holds -inf in row 0, column 3")
def pose_infinite(path):
    def change(matrix):
        matrix[0, 3] = -np.inf
        return matrix.tolist()

    edit_pose(path, change)


@case("frame images/003.png", "shape (3, 3)")
def pose_of_wrong_shape(path):
    edit_pose(path, lambda matrix: matrix[:3, :3].tolist())


@case("frame images/003.png", "not a matrix of numbers")
def pose_of_words(path):
    edit_pose(path, lambda matrix: [["a"] * 4] * 4)


@case("frame images/003.png", "not a rotation", "differs from the identity by")
def pose_sheared(path):
    def change(matrix):
        matrix[:3, 0] += 0.1 * matrix[:3, 1]
        return matrix.tolist()

    edit_pose(path, change)


@case("frame images/003.png", "rotation times a uniform scale of 2.5")
def pose_scaled(path):
    def change(matrix):
        matrix[:3, :3] *= 2.5
        return matrix.tolist()

    edit_pose(path, change)


@case("frame images/003.png", "not a rotation")
def pose_zero(path):
    def change(matrix):
        matrix[:3, :3] = 0
        return matrix.tolist()

    edit_pose(path, change)


@case("frame images/003.png", "mirrors", "determinant -1")
def pose_mirrored(path):
    def change(matrix):
        matrix[:3, 0] *= -1
        return matrix.tolist()

    edit_pose(path, change)


@case("frame images/003.png", "last row", "transposed")
def pose_transposed(path):
    edit_pose(path, lambda matrix: matrix.T.tolist())


@case("listed twice with different poses", "images/000.png")
def frame_twice_with_two_poses(path):
    def change(values):
        copy = dict(values["frames"][0])
        copy["transform_matrix"] = values["frames"][1]["transform_matrix"]
        values["frames"].append(copy)

    edit(path, change)


@case("transforms.json", "camera_model", "FISHEYE_8000", "OPENCV_FISHEYE")
def unknown_camera_model(path):
    edit(path, lambda values: values.update(camera_model="FISHEYE_8000"))


@case("transforms.json", "fl_x", "nan")
def intrinsics_nan(path):
    edit(path, lambda values: values.update(fl_x=float("nan")))


@case("transforms.json", "fl_x")
def focal_length_missing(path):
    edit(path, lambda values: values.pop("fl_x"))


@case("transforms.json", "test_filenames has 'images/00.png', which is not an image", "nearest")
def unknown_test_name(path):
    edit(path, lambda values: values.update(test_filenames=["images/00.png"]))


@case("transforms.json", "in the training and the test list", "images/001.png")
def train_and_test_overlap(path):
    names = small.names()
    edit(path, lambda v: v.update(train_filenames=names[:5], test_filenames=names[1:2]))


@case("transforms.json", "'test_filenames' is not a list")
def list_of_test_names_is_a_word(path):
    edit(path, lambda values: values.update(test_filenames="images/001.png"))


@case("transforms.json", "no training view is left")
def everything_held_out(path):
    edit(path, lambda values: values.update(test_filenames=small.names()))


# --- points ---------------------------------------------------------------------------------------
@case("transforms.json", "'points3D.ply' does not exist")
def points_missing(path):
    small.write_nerfstudio(path)
    (path / "points3D.ply").unlink()


@case("points3D.ply")
def points_cut_off(path):
    small.write_nerfstudio(path)
    file = path / "points3D.ply"
    file.write_bytes(file.read_bytes()[:-100])


@case("points3D.ply")
def points_are_text(path):
    small.write_nerfstudio(path)
    (path / "points3D.ply").write_text("x y z\n")


# --- COLMAP ---------------------------------------------------------------------------------------
@case("cameras.txt, line 2", "expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", "'7 PINHOLE 48'")
def colmap_camera_line_cut_off(path):
    small.write_colmap_text(path)
    (path / "sparse/0/cameras.txt").write_text("# cameras\n7 PINHOLE 48")


@case("cameras.txt, line 1", "RAINBOW", "SIMPLE_PINHOLE")
def colmap_unknown_model(path):
    small.write_colmap_text(path)
    (path / "sparse/0/cameras.txt").write_text("7 RAINBOW 48 36 1 2 3 4\n")


@case("cameras.txt, line 1", "not finite")
def colmap_camera_nan(path):
    small.write_colmap_text(path)
    (path / "sparse/0/cameras.txt").write_text("7 PINHOLE 48 36 40 nan 24 18\n")


@case("images.txt, line 2", "camera 7, which does not exist")
def colmap_camera_missing(path):
    small.write_colmap_text(path)
    replace_text(path / "sparse/0/cameras.txt", "7 PINHOLE", "8 PINHOLE")


@case("images.txt, line 6", "expected IMAGE_ID")
def colmap_image_line_malformed(path):
    small.write_colmap_text(path)
    replace_text(path / "sparse/0/images.txt", "7 002.png", "002.png")


@case("images.txt, line 3", "an empty line if it has none")
def colmap_points_line_missing(path):
    small.write_colmap_text(path)
    file = path / "sparse/0/images.txt"
    file.write_text("\n".join(line for line in file.read_text().splitlines() if line) + "\n")


@case("images.txt, line 4", "001.png", "norm is 3")
def colmap_quaternion_not_unit(path):
    small.write_colmap_text(path)
    file = path / "sparse/0/images.txt"
    lines = file.read_text().splitlines()
    words = lines[3].split()
    words[1:5] = ["3", "0", "0", "0"]
    lines[3] = " ".join(words)
    file.write_text("\n".join(lines) + "\n")


@case("images.txt, line 4", "001.png", "NaN or infinity")
def colmap_translation_nan(path):
    small.write_colmap_text(path)
    file = path / "sparse/0/images.txt"
    lines = file.read_text().splitlines()
    words = lines[3].split()
    words[6] = "nan"
    lines[3] = " ".join(words)
    file.write_text("\n".join(lines) + "\n")


@case("points3D.txt, line 3", "expected POINT3D_ID", "'1 0.5 0.5'")
def colmap_point_line_cut_off(path):
    small.write_colmap_text(path)
    file = path / "sparse/0/points3D.txt"
    lines = file.read_text().splitlines()
    lines[2] = "1 0.5 0.5"
    file.write_text("\n".join(lines) + "\n")


@case("1 of 400 points have NaN")
def colmap_point_nan(path):
    small.write_colmap_text(path)
    file = path / "sparse/0/points3D.txt"
    lines = file.read_text().splitlines()
    lines[2] = "1 nan 0.5 0.5 1 2 3 0"
    file.write_text("\n".join(lines) + "\n")


@case("cameras.bin", "ends at byte 60", "camera 1 of 1", "byte 32")
def colmap_cameras_truncated(path):
    small.write_colmap_binary(path)
    file = path / "sparse/0/cameras.bin"
    file.write_bytes(file.read_bytes()[:60])


@case("cameras.bin", "camera model 99")
def colmap_binary_unknown_model(path):
    small.write_colmap_binary(path, model_number=99)


@case("images.bin", "image 10 of 10", "ends at byte")
def colmap_images_truncated(path):
    small.write_colmap_binary(path)
    file = path / "sparse/0/images.bin"
    file.write_bytes(file.read_bytes()[:-30])


@case("images.bin", "in its header")
def colmap_images_empty(path):
    small.write_colmap_binary(path)
    (path / "sparse/0/images.bin").write_bytes(b"")


@case("images.bin", "7 bytes are left after 10 image records")
def colmap_images_too_long(path):
    small.write_colmap_binary(path)
    with open(path / "sparse/0/images.bin", "ab") as file:
        file.write(b"garbage")


@case("points3D.bin", "point 400 of 400", "ends at byte")
def colmap_points_truncated(path):
    small.write_colmap_binary(path)
    file = path / "sparse/0/points3D.bin"
    file.write_bytes(file.read_bytes()[:-5])


@case("points3D.bin", "ends at byte")
def colmap_points_count_absurd(path):
    small.write_colmap_binary(path)
    file = path / "sparse/0/points3D.bin"
    file.write_bytes(struct.pack("<Q", 2**60) + file.read_bytes()[8:])


@case("images.txt", "lists no images")
def colmap_without_images(path):
    small.write_colmap_text(path)
    (path / "sparse/0/images.txt").write_text("# nothing\n")


@case("images.bin", "none of its 10 images exist")
def colmap_images_folder_missing(path):
    small.write_colmap_binary(path)
    (path / "images").rename(path / "photos")


# --- plain folder ---------------------------------------------------------------------------------
@case("poses.txt, line 3", "name tx ty tz qx qy qz qw", "'001.png 1 2 3'")
def folder_pose_line_cut_off(path):
    small.write_folder(path)
    file = path / "poses.txt"
    lines = file.read_text().splitlines()
    lines[2] = "001.png 1 2 3"
    file.write_text("\n".join(lines) + "\n")


@case("poses.txt, line 3", "norm is 2")
def folder_quaternion_not_unit(path):
    small.write_folder(path)
    file = path / "poses.txt"
    lines = file.read_text().splitlines()
    lines[2] = "001.png 1 2 3 0 0 0 2"
    file.write_text("\n".join(lines) + "\n")


@case("poses.json, image 001", "not a rotation")
def folder_json_pose_not_a_rotation(path):
    small.write_folder(path)
    (path / "poses.txt").unlink()
    (path / "poses.json").write_text(json.dumps({"001": np.full((4, 4), 0.5).tolist()[:3]}))


@case("poses.json", "not valid JSON")
def folder_json_cut_off(path):
    small.write_folder(path)
    (path / "poses.txt").unlink()
    (path / "poses.json").write_text('{"001": [[1,')


@case("poses.txt", "none of its 10 images exist")
def folder_poses_of_other_images(path):
    small.write_folder(path)
    file = path / "poses.txt"
    file.write_text(file.read_text().replace(".png", "_left.png"))


@case("cameras.txt")
def folder_lens_broken(path):
    small.write_folder(path)
    (path / "cameras.txt").write_text("1 PINHOLE forty-eight 36 1 2 3 4\n")


# Cases that show only when pixels are decoded; the doctor must find them, and so must `image`.
NEEDS_DECODING = {"png_cut_off", "png_damaged", "jpeg_cut_off", "mask_of_wrong_size"}


def test_bad_input_table_has_all_its_cases():
    assert len(CASES) == 67


@pytest.mark.parametrize("name", CASES)
def test_load_bad_input_is_one_clear_sentence(name, tmp_path):
    write, parts = CASES[name]
    path = tmp_path / "data set ü"
    path.mkdir()
    write(path)
    with pytest.raises(gsut.InputError) as caught:
        load_dataset(path).preload()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 700
    missing = [part for part in parts if part not in message]
    assert not missing, f"{missing} not in: {message}"
    assert str(path) in message


@pytest.mark.parametrize("name", sorted(NEEDS_DECODING))
def test_load_bad_pixels_are_not_read_before_they_are_needed(name, tmp_path):
    CASES[name][0](tmp_path)
    assert len(load_dataset(tmp_path)) == small.VIEWS


@pytest.mark.parametrize("name", CASES)
def test_diagnose_bad_input_says_the_same_without_raising(name, tmp_path):
    write, parts = CASES[name]
    path = tmp_path / "data set ü"
    path.mkdir()
    write(path)
    errors = [str(f) for f in diagnose(path, progress=False) if f.severity == "error"]
    assert any(all(part in error for part in parts) for error in errors), errors
    assert all("\n" not in error for error in errors)
