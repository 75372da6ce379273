"""Broken datasets: each gives one clear sentence, from the loader and from the doctor."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
import small_datasets as small
from gsut.check import diagnose
from gsut.data import load_dataset

Write = Callable[[Path], object]
# name -> (function that writes a broken dataset, parts that the message must hold)
CASES: dict[str, tuple[Write, tuple[str, ...]]] = {}


def case(name: str, write: Write, *parts: str) -> None:
    CASES[name] = (write, parts)


def listed(change: Callable[[dict], object]) -> Write:
    """transforms.json with its values changed."""

    def write(path):
        values = small.transforms()
        change(values)
        small.write_nerfstudio(path, values)

    return write


def frame(number: int, **values) -> Write:
    return listed(lambda all_values: all_values["frames"][number].update(values))


def posed(change: Callable[[np.ndarray], object]) -> Write:
    """transforms.json with the pose of images/003.png replaced by what `change` gives of it."""

    def apply(values):
        pose = np.array(values["frames"][3]["transform_matrix"])
        changed = change(pose)
        values["frames"][3]["transform_matrix"] = np.array(changed).tolist()

    return listed(apply)


def entry(row, column, value) -> Write:
    """The same with some of its numbers replaced, or changed by a function."""

    def change(pose):
        pose[row, column] = value(pose) if callable(value) else value
        return pose

    return posed(change)


def broken(dataset: Callable[[Path], object], file: str, change) -> Write:
    """One file of a dataset replaced by a text or bytes, by a function of its bytes, or removed."""

    def write(path):
        dataset(path)
        if change is None:
            (path / file).unlink()
        elif isinstance(change, str):
            (path / file).write_text(change)
        else:
            before = (path / file).read_bytes() if callable(change) else b""
            (path / file).write_bytes(change(before) if callable(change) else change)

    return write


def nerfstudio(file: str, change) -> Write:
    return broken(small.write_nerfstudio, file, change)


def colmap_text(file: str, change) -> Write:
    return broken(small.write_colmap_text, f"sparse/0/{file}", change)


def colmap_binary(file: str, change) -> Write:
    return broken(small.write_colmap_binary, f"sparse/0/{file}", change)


def folder(file: str, change) -> Write:
    return broken(small.write_folder, file, change)


def line(number: int, text: str) -> Callable[[bytes], bytes]:
    """Replaces a line, counted from 1."""
    return lambda data: b"\n".join(
        text.encode() if i == number else row for i, row in enumerate(data.split(b"\n"), 1)
    )


def words(number: int, first: int, *new: str) -> Callable[[bytes], bytes]:
    """Replaces words of a line, the first of them counted from 0."""

    def change(data):
        old = data.decode().splitlines()[number - 1].split()
        old[first : first + len(new)] = new
        return line(number, " ".join(old))(data)

    return change


def replaced(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    def change(data):
        assert old in data
        return data.replace(old, new, 1)

    return change


def instead_of_poses_txt(json_text: str) -> Write:
    def write(path):
        folder("poses.txt", None)(path)
        (path / "poses.json").write_text(json_text)

    return write


def without_images(path):
    small.write_nerfstudio(path)
    for name in small.names():
        (path / name).unlink()


def picture(height: int, width: int) -> bytes:
    return cv2.imencode(".png", np.zeros((height, width, 3), np.uint8))[1].tobytes()


def jpeg(data: bytes) -> Write:
    def write(path):
        frame(4, file_path="images/004.jpg")(path)
        (path / "images/004.jpg").write_bytes(data)

    return write


def small_mask(path):
    listed(lambda values: values.update(mask_path="mask.png"))(path)
    small.write_png(path / "mask.png", np.full((10, 10), 255, np.uint8))


def one_frame_twice(values):
    pose = values["frames"][1]["transform_matrix"]
    values["frames"].append({**values["frames"][0], "transform_matrix": pose})


def renamed_images(path):
    small.write_colmap_binary(path)
    (path / "images").rename(path.parent / "elsewhere")


def flipped_byte(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 0xFF]) + data[middle + 1 :]


NAMES = small.names()
IMAGE = "images/004.png"
JPEG = cv2.imencode(".jpg", small.render(small.world_from_cameras()[4]))[1].tobytes()
ABSURD = struct.pack("<Q", 2**60)
HALVES = json.dumps({"001": np.full((4, 4), 0.5).tolist()[:3]})

# --- places
case("missing_folder", lambda path: path.rmdir(), "does not exist", "check the path")
case("empty_folder", lambda path: None,
     "no dataset found", "transforms.json", "sparse/0", "lens file")  # fmt: skip
case("no_frames", listed(lambda v: v["frames"].clear()), "transforms.json", "lists no images")
case("no_image_exists", without_images,
     "transforms.json", "none of its 10 images exist", "images/000.png")  # fmt: skip
case("folder_without_lens", folder("cameras.txt", None), "no lens file", "gsut calibrate")
case("folder_without_poses", folder("poses.txt", None),
     "neither of ('poses.txt', 'poses.json')", "gsut poses")  # fmt: skip

# --- images
case("png_cut_off", nerfstudio(IMAGE, lambda data: data[:-300]),
     IMAGE, "PNG file is truncated", "copy")  # fmt: skip
case("png_damaged", nerfstudio(IMAGE, flipped_byte), IMAGE, "wrong checksum")
case("jpeg_cut_off", jpeg(JPEG[:-200]), "images/004.jpg", "JPEG file is truncated")
case("image_is_text", nerfstudio(IMAGE, "<html>404 not found</html>"), IMAGE, "cannot be decoded")
case("image_is_empty", nerfstudio(IMAGE, b""), IMAGE, "empty")
case("image_of_wrong_size", nerfstudio(IMAGE, picture(36, 20)),
     IMAGE, "the image is 20 x 36", "expects 48 x 36", "uncropped")  # fmt: skip
case("image_turned", nerfstudio(IMAGE, picture(48, 36)), IMAGE, "the image is 36 x 48", "turned")
case("mask_of_wrong_size", small_mask, "mask.png", "the mask is 10 x 10, the image 48 x 36")
case("mask_missing", frame(2, mask_path="no.png"),
     "frame images/002.png", "mask_path 'no.png' does not exist")  # fmt: skip

# --- transforms.json
case("json_cut_off", nerfstudio("transforms.json", lambda data: data[:700]),
     "transforms.json", "not valid JSON at line 1, column", "cut off")  # fmt: skip
case("json_without_frames", listed(lambda v: v.pop("frames")),
     "transforms.json", "no list 'frames'")  # fmt: skip
case("frame_without_name", listed(lambda v: v["frames"][5].pop("file_path")),
     "frame 5", "no 'file_path'")  # fmt: skip
case("frame_without_pose", listed(lambda v: v["frames"][5].pop("transform_matrix")),
     "frame images/005.png", "no 'transform_matrix'")  # fmt: skip
case("shutter_without_end", frame(5, transform_matrix_start=np.eye(4).tolist()),
     "frame images/005.png", "only one of transform_matrix_start")  # fmt: skip
POSE = "frame images/003.png"
case("pose_nan", entry(1, 2, np.nan), POSE, "the pose holds nan in row 1, column 2")
case("pose_of_wrong_shape", posed(lambda pose: pose[:3, :3]), POSE, "shape (3, 3)")
case("pose_of_words", posed(lambda pose: [["a"] * 4] * 4), POSE, "not a matrix of numbers")
case("pose_sheared", entry(slice(3), 0, lambda pose: pose[:3, 0] + 0.1 * pose[:3, 1]),
     POSE, "not a rotation", "differs from the identity by")  # fmt: skip
case("pose_scaled", entry(slice(3), slice(3), lambda pose: 2.5 * pose[:3, :3]),
     POSE, "rotation times a uniform scale of 2.5")  # fmt: skip
case("pose_mirrored", entry(slice(3), 0, lambda pose: -pose[:3, 0]),
     POSE, "mirrors", "determinant -1")  # fmt: skip
case("pose_transposed", posed(np.transpose), POSE, "last row", "transposed")
case("frame_twice_with_two_poses", listed(one_frame_twice),
     "listed twice with different poses", "images/000.png")  # fmt: skip
case("unknown_test_name", listed(lambda v: v.update(test_filenames=["images/00.png"])),
     "transforms.json", "test_filenames has 'images/00.png', which is not an image",
     "nearest")  # fmt: skip
case("train_and_test_overlap",
     listed(lambda v: v.update(train_filenames=NAMES[:5], test_filenames=NAMES[1:2])),
     "transforms.json", "in the training and the test list", "images/001.png")  # fmt: skip
case("list_of_test_names_is_a_word", listed(lambda v: v.update(test_filenames="images/001.png")),
     "transforms.json", "'test_filenames' is not a list")  # fmt: skip
case("everything_held_out", listed(lambda v: v.update(test_filenames=NAMES)),
     "transforms.json", "no training view is left")  # fmt: skip

# --- points
case("points_missing", nerfstudio("points3D.ply", None),
     "transforms.json", "'points3D.ply' does not exist")  # fmt: skip
case("points_cut_off", nerfstudio("points3D.ply", lambda data: data[:-100]), "points3D.ply")

# --- COLMAP
case("colmap_camera_missing", colmap_text("cameras.txt", replaced(b"7 PINHOLE", b"8 PINHOLE")),
     "images.txt, line 2", "camera 7, which does not exist")  # fmt: skip
case("colmap_image_line_malformed", colmap_text("images.txt", replaced(b"7 002.png", b"002.png")),
     "images.txt, line 6", "expected IMAGE_ID")  # fmt: skip
case("colmap_points_line_missing",
     colmap_text("images.txt", lambda data: data.replace(b"\n\n", b"\n")),
     "images.txt, line 3", "an empty line if it has none")  # fmt: skip
case("colmap_quaternion_not_unit", colmap_text("images.txt", words(4, 1, "3", "0", "0", "0")),
     "images.txt, line 4", "001.png", "norm is 3")  # fmt: skip
case("colmap_translation_nan", colmap_text("images.txt", words(4, 6, "nan")),
     "images.txt, line 4", "001.png", "NaN or infinity")  # fmt: skip
case("colmap_point_line_cut_off", colmap_text("points3D.txt", line(3, "1 0.5 0.5")),
     "points3D.txt, line 3", "expected POINT3D_ID", "'1 0.5 0.5'")  # fmt: skip
case("colmap_point_nan", colmap_text("points3D.txt", line(3, "1 nan 0.5 0.5 1 2 3 0")),
     "points3D.txt", "1 of 400 points have NaN", "the first is row 1")  # fmt: skip
case("colmap_images_truncated", colmap_binary("images.bin", lambda data: data[:-30]),
     "images.bin", "image 10 of 10", "ends at byte")  # fmt: skip
case("colmap_images_empty", colmap_binary("images.bin", b""), "images.bin", "in its header")
case("colmap_images_too_long", colmap_binary("images.bin", lambda data: data + b"garbage"),
     "images.bin", "7 bytes are left after 10 image records")  # fmt: skip
case("colmap_points_truncated", colmap_binary("points3D.bin", lambda data: data[:-5]),
     "points3D.bin", "point 400 of 400", "ends at byte")  # fmt: skip
case("colmap_points_count_absurd", colmap_binary("points3D.bin", lambda data: ABSURD + data[8:]),
     "points3D.bin", "ends at byte")  # fmt: skip
case("colmap_without_images", colmap_text("images.txt", "# nothing\n"),
     "images.txt", "lists no images")  # fmt: skip
case("colmap_images_folder_missing", renamed_images, "images.bin", "none of its 10 images exist")

# --- plain folder
case("folder_pose_line_cut_off", folder("poses.txt", line(3, "001.png 1 2 3")),
     "poses.txt, line 3", "name tx ty tz qx qy qz qw", "'001.png 1 2 3'")  # fmt: skip
case("folder_json_pose_not_a_rotation", instead_of_poses_txt(HALVES),
     "poses.json, image 001", "not a rotation")  # fmt: skip
case("folder_json_cut_off", instead_of_poses_txt('{"001": [[1,'), "poses.json", "not valid JSON")
case("folder_poses_of_other_images",
     folder("poses.txt", lambda data: data.replace(b".png", b"_left.png")),
     "poses.txt", "none of its 10 images exist")  # fmt: skip

# Cases that show only when pixels are decoded; the doctor must find them, and so must `image`.
NEEDS_DECODING = {"png_cut_off", "png_damaged", "jpeg_cut_off", "mask_of_wrong_size"}


def test_bad_input_table_has_all_its_cases():
    assert len(CASES) == 52


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "data set ü"
    path.mkdir()
    return path


@pytest.mark.parametrize(("write", "parts"), CASES.values(), ids=CASES)
def test_bad_input_is_one_clear_sentence_of_the_loader_and_the_doctor(write, parts, path):
    write(path)
    with pytest.raises(gsut.InputError) as caught:
        load_dataset(path).check_pixels()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 700
    missing = [part for part in parts if part not in message]
    assert not missing, f"{missing} not in: {message}"
    assert str(path) in message
    errors = [str(f) for f in diagnose(path, progress=False) if f.severity == "error"]
    assert any(all(part in error for part in parts) for error in errors), errors
    assert all("\n" not in error for error in errors)


@pytest.mark.parametrize("name", sorted(NEEDS_DECODING))
def test_load_bad_pixels_are_not_read_before_they_are_needed(name, tmp_path):
    CASES[name][0](tmp_path)
    assert len(load_dataset(tmp_path)) == small.VIEWS
