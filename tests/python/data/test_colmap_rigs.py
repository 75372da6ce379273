"""Rigs of COLMAP 4 models: read, kept by a conversion, and left out with a sentence."""

import struct

import numpy as np
import pytest

import gsut
import small_datasets as small
import tolerances
from gsut.data.colmap import ColmapImage, RigPlace, hold_rigs, read_frames, read_rigs
from gsut.data.colmap.model import ColmapModel, format_model_texts
from gsut.data.layouts.colmap import read_colmap
from gsut.data.poses import pose_from_quaternion
from raising import raises_saying

CAMERAS = 2
FRAMES = small.VIEWS // CAMERAS
MOUNT = [np.cos(0.1), 0.0, np.sin(0.1), 0.0, -0.2, 0.01, 0.03]  # camera 2 from camera 1


def list_records() -> tuple[list, list]:
    """Numbers of one rig with an IMU, and of its frames, as COLMAP's files have them in order."""
    rig = [1, 3, "CAMERA", 1, "IMU", 1, 0, "CAMERA", 2, 1, *MOUNT]
    frames = []
    for number, (_, quat, translation, _) in enumerate(small.colmap_images()[:FRAMES], 1):
        images = ["CAMERA", 1, 2 * number - 1, "CAMERA", 2, 2 * number]
        frames.append([number, 1, *quat, *translation, 3, *images, "IMU", 1, 7])
    return [rig], frames


def pack(record: list, letters: str) -> bytes:
    types = {"CAMERA": 0, "IMU": 1}
    return struct.pack(
        f"<{letters}", *(types.get(v, v) if isinstance(v, str) else v for v in record)
    )


def write_rig_model(path, suffix: str = ".txt"):
    """Writes a COLMAP model of a rig of two equal lenses; images have the poses of the rig."""
    write = small.write_colmap_text if suffix == ".txt" else small.write_colmap_binary
    write(path)
    model = path / "sparse" / "0"
    rigs, frames = list_records()
    lens = f"{small.WIDTH} {small.HEIGHT} {small.FX} {small.FY} {small.CX} {small.CY}"
    lines, packed = [], struct.pack("<Q", small.VIEWS)
    for number, pose in enumerate(list_poses(), 1):
        values = [*small.quaternion(pose[:3, :3]), *pose[:3, 3]]
        camera, name = 2 - number % 2, f"{number - 1:03d}.png"
        lines += [f"{number} {' '.join(repr(float(v)) for v in values)} {camera} {name}", ""]
        packed += struct.pack("<I7dI", number, *values, camera) + name.encode() + bytes(9)
    if suffix == ".txt":
        (model / "cameras.txt").write_text(f"1 PINHOLE {lens}\n2 PINHOLE {lens}\n")
        (model / "images.txt").write_text("\n".join(lines) + "\n")
        for name, records in (("rigs", rigs), ("frames", frames)):
            rows = [" ".join(map(str, record)) for record in records]
            (model / f"{name}.txt").write_text("\n".join(["# of COLMAP 4", *rows]) + "\n")
        return path
    sizes = (small.WIDTH, small.HEIGHT, small.FX, small.FY, small.CX, small.CY)
    cameras = [struct.pack("<IiQQ4d", number, 1, *sizes) for number in (1, 2)]
    (model / "cameras.bin").write_bytes(struct.pack("<Q", 2) + b"".join(cameras))
    (model / "images.bin").write_bytes(packed)
    rig = struct.pack("<Q", 1) + pack(rigs[0], "IIiIiIBiIB7d")
    (model / "rigs.bin").write_bytes(rig)
    rows = [pack(record, "II7dIiIQiIQiIQ") for record in frames]
    (model / "frames.bin").write_bytes(struct.pack("<Q", FRAMES) + b"".join(rows))
    return path


def list_poses() -> list[np.ndarray]:
    """camera_from_world of the images, by number."""
    mount = pose_from_quaternion(MOUNT[:4], MOUNT[4:], "")
    poses = []
    for _, quat, translation, _ in small.colmap_images()[:FRAMES]:
        rig_from_world = pose_from_quaternion(list(quat), list(translation), "")
        poses += [rig_from_world, mount @ rig_from_world]
    return poses


def assert_truth(scene) -> None:
    assert not scene.notes
    for view, pose in zip(scene.views, list_poses(), strict=True):
        assert np.allclose(
            scene.to_dataset(view.camera_from_world), pose, rtol=0, atol=tolerances.LAYOUT_POSE
        )


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_colmap_model_of_a_rig_converted_keeps_its_rig(suffix, tmp_path):
    write_rig_model(tmp_path / "in", suffix)
    assert_truth(gsut.load_dataset(tmp_path / "in"))
    notes = gsut.convert_dataset(tmp_path / "in", tmp_path / "out", "colmap")
    assert notes == []
    assert_truth(gsut.load_dataset(tmp_path / "out"))
    model = tmp_path / "out" / "sparse" / "0"
    (rig,), frames = read_rigs(model / "rigs.bin"), read_frames(model / "frames.bin")
    assert list(rig.cameras) == [1, 2]
    assert np.allclose(rig.cameras[2], MOUNT, rtol=0, atol=tolerances.LAYOUT_POSE)
    assert [frame.images for frame in frames] == [
        [(1, 2 * i + 1), (2, 2 * i + 2)] for i in range(FRAMES)
    ]
    places = [frame.rig for frame in read_colmap(tmp_path / "out").frames]
    assert places == [RigPlace(1, i % 2, i // 2 + 1) for i in range(small.VIEWS)]


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_colmap_frames_cut_off_raise_where(suffix, tmp_path):
    frames = write_rig_model(tmp_path, suffix) / f"sparse/0/frames{suffix}"
    frames.write_bytes(frames.read_bytes()[:-9])
    with raises_saying([f"frames{suffix}", "again"]):
        gsut.load_dataset(tmp_path)


def test_colmap_frame_of_an_unknown_rig_raises_its_number(tmp_path):
    frames = write_rig_model(tmp_path) / "sparse/0/frames.txt"
    frames.write_text(frames.read_text().replace("\n3 1 ", "\n3 9 "))
    with raises_saying(["rig, 9", "rigs.txt"]):
        gsut.load_dataset(tmp_path)


def make_images() -> list[ColmapImage]:
    camera = gsut.Camera("opencv4", [40.0, 40.0, 24.0, 18.0, 0, 0, 0, 0], 48, 36)
    return [
        ColmapImage(i + 1, f"{i}.png", camera, pose, rig=RigPlace(4, i % CAMERAS, i // CAMERAS))
        for i, pose in enumerate(list_poses())
    ]


def test_hold_rigs_where_cameras_move_leaves_the_rig_out_with_a_note():
    images = make_images()
    images[3].camera_from_world = images[3].camera_from_world.copy()
    images[3].camera_from_world[0, 3] += 0.01
    held, (note,) = hold_rigs(images)
    assert "rig 4 is left out" in note
    model = ColmapModel(held, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    assert not set(format_model_texts(model)) & {"rigs.txt", "frames.txt"}


def test_hold_rigs_of_a_rig_beside_single_images_numbers_each_camera():
    images = make_images()
    images[-1].rig = None
    held, notes = hold_rigs(images)
    assert notes == []
    texts = format_model_texts(ColmapModel(held, np.zeros((0, 3)), np.zeros((0, 3), np.uint8)))
    rigs = [line.split() for line in texts["rigs.txt"].splitlines()[1:]]
    assert [row[:4] for row in rigs] == [["1", "2", "CAMERA", "1"], ["2", "1", "CAMERA", "3"]]
    assert len(texts["frames.txt"].splitlines()) == 1 + FRAMES + 1
    assert texts["cameras.txt"].count("OPENCV") == 3
