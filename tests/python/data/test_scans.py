"""Exports of scanning apps: their poses, lenses, depths along z and confidences."""

import json
import shutil

import cv2
import numpy as np
import pytest

import gsut
import small_scans as made
from box_room import BoxRoom
from gsut.cli import main
from gsut.data.scene import read_depth
from gsut.training import TrainingLoop
from gsut.training.surface import check_maps
from raising import raises_saying

WRITERS = {
    "polycam": lambda folder: made.write_polycam(folder, corrected=False),
    "polycam, corrected": lambda folder: made.write_polycam(folder, corrected=True),
    "record3d": made.write_record3d,
    "3dscannerapp": made.write_scanner,
    "strayscanner": made.write_stray,
}


@pytest.mark.parametrize("app", list(WRITERS))
def test_export_of_a_scanning_app_gives_poses_lens_and_distances(app, tmp_path):
    WRITERS[app](tmp_path)
    scene = gsut.load_dataset(tmp_path)
    assert len(scene) == len(made.poses())
    if app == "record3d" and not cv2.haveImageWriter("a.exr"):  # wheels of OpenCV 5
        with pytest.raises(gsut.InputError, match=r"reads no .exr here; pip install '.*<5'"):
            read_depth(scene, 0)
        return
    for number, (view, pose) in enumerate(zip(scene.views, made.poses(), strict=True)):
        assert np.abs(np.linalg.inv(view.camera_from_world) - pose).max() < 1e-9
        np.testing.assert_allclose(scene.camera(number).params, made.CAMERA.params, rtol=1e-12)
        depth = read_depth(scene, number)
        truth = BoxRoom().measure_distances(made.CAMERA.resize(*made.DEPTH_SIZE), pose)
        unsure = 0 if app == "record3d" else 1  # its pictures of confidence are in no such export
        assert np.isnan(depth[:unsure]).all() and np.isfinite(depth[unsure:]).all()
        assert np.abs(depth / truth - 1)[unsure:].max() < 2e-3  # millimetres, or half floats
    check_maps(scene)


def test_training_on_a_scan_starts_at_its_depths(tmp_path):
    made.write_polycam(tmp_path, corrected=False)
    scene = gsut.load_dataset(tmp_path).centred
    loop = TrainingLoop(scene, gsut.TrainOptions(steps=10, max_gaussians=2000))
    assert any("lie at known depths" in note for note in loop.notes)
    inside = BoxRoom()
    points = loop.gaussians.means + scene.world_offset
    for pose in made.poses()[:1]:
        origins = np.broadcast_to(pose[:3, 3], points.shape)
        away = np.linalg.norm(points - origins, axis=1)
        wall, _ = inside.trace(origins, (points - origins) / away[:, None])
        assert np.mean(away < wall * 1.02) > 0.8


def test_written_dataset_keeps_the_form_of_its_depths(tmp_path):
    made.write_scanner(tmp_path / "scan")
    assert main(["data", "convert", f"{tmp_path}/scan", f"{tmp_path}/out"]) == 0
    ours, theirs = gsut.load_dataset(tmp_path / "out"), gsut.load_dataset(tmp_path / "scan")
    for number in range(len(theirs)):
        np.testing.assert_array_equal(read_depth(ours, number), read_depth(theirs, number))


def test_depths_of_instant_ngp_are_z_in_its_unit(tmp_path):
    made.write_scanner(tmp_path)
    frames = [
        {"file_path": f"frame_{i:05d}.jpg", "depth_path": f"depth_{i:05d}.png",
         "transform_matrix": (pose @ made.OPENGL_FROM_OPENCV).tolist()}
        for i, pose in enumerate(made.poses())
    ]  # fmt: skip
    fx, fy, cx, cy = made.CAMERA.params
    values = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(values | {"integer_depth_scale": 0.002}))
    scene = gsut.load_dataset(tmp_path)
    truth = BoxRoom().measure_distances(made.CAMERA.resize(*made.DEPTH_SIZE), made.poses()[0])
    assert np.abs(read_depth(scene, 0) / truth / 2 - 1).max() < 2e-3
    (tmp_path / "transforms.json").write_text(json.dumps(values | {"depth_along": "y"}))
    with raises_saying(["depth_along"]):
        gsut.load_dataset(tmp_path)


def test_film_without_pictures_names_the_command_that_takes_them_out(tmp_path):
    made.write_stray(tmp_path)
    shutil.rmtree(tmp_path / "rgb")
    (tmp_path / "rgb.mp4").write_bytes(b"")
    with raises_saying(["ffmpeg -i"]):
        gsut.load_dataset(tmp_path)


def test_export_without_a_key_names_the_picture(tmp_path):
    made.write_polycam(tmp_path, corrected=False)
    file = next((tmp_path / "keyframes/cameras").iterdir())
    file.write_text("{}")
    with raises_saying([f"pose of {file.stem}.jpg", "export the scan again"]):
        gsut.load_dataset(tmp_path)


def test_archive_of_record3d_becomes_a_dataset_with_its_depths(tmp_path):
    made.write_record3d_archive(tmp_path / "room.r3d")
    with raises_saying(["room.r3d", "gsut data convert"]):
        gsut.load_dataset(tmp_path / "room.r3d")
    assert main(["data", "convert", f"{tmp_path}/room.r3d", f"{tmp_path}/out"]) == 0
    scene = gsut.load_dataset(tmp_path / "out")
    for number, pose in enumerate(made.poses()):
        assert np.abs(np.linalg.inv(scene.views[number].camera_from_world) - pose).max() < 1e-9
        truth = BoxRoom().measure_distances(made.CAMERA.resize(*made.DEPTH_SIZE), pose)
        depth = read_depth(scene, number)
        assert np.isnan(depth[0]).all() and np.abs(depth / truth - 1)[1:].max() < 1e-6
