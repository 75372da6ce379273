"""transforms.json and its lens files: as they are written they are read back."""

import json

import cv2
import numpy as np
import pytest

import gsut
import small_datasets
from gsut import _core
from gsut._core import Shutter
from gsut.data import Frame, write_transforms
from gsut.data.points import format_points_ply
from gsut.lens import load_camera
from lens_cases import real_lenses
from raising import raises_saying

FISHEYE = gsut.Camera("kannala_brandt", [40, 41, 32, 24, 0.02, -0.01, 0.002, 0], 64, 48)
# Neither of nerfstudio's, and not square.
SPHERE = gsut.Camera("double_sphere", [40, 41, 32, 24, 0.2, 0.55], 64, 48, valid_field_angle=1.2)
REGION = {"extrinsics": [0.1, 0, 0, 1, 2, 3], "valid_region": [[0, 0], [60, 0], [60, 40]]}
STEREOGRAPHIC = gsut.Camera("stereographic", [20, 21, 32, 24], 64, 48, **REGION)
LENSES = {
    "one": [FISHEYE],
    "two": [FISHEYE, FISHEYE.with_params([50, *FISHEYE.params[1:]])],
    "file": [SPHERE],
    "both": [FISHEYE, SPHERE],
    "files": [SPHERE, STEREOGRAPHIC, SPHERE.with_valid_field_angle(None), FISHEYE],
}


def frames_in(folder, rng, cameras, shutter=None):
    (folder / "images").mkdir()
    out = []
    for i in range(4):
        camera = cameras[i % len(cameras)]
        path = folder / "images" / f"{i}.png"
        size = (camera.height, camera.width, 3)
        cv2.imwrite(str(path), rng.integers(0, 255, size, np.uint8))
        poses = [_core.exp_pose(rng.normal(size=6)) for _ in range(3)]
        ends = poses[1:] if shutter else (None, None)
        out.append(Frame(path.name, path, camera, poses[0], *ends, shutter=shutter))
    return out


@pytest.mark.parametrize("lenses", LENSES)
@pytest.mark.parametrize("shutter", [None, Shutter("top_to_bottom")])
def test_frames_come_back(tmp_path, rng, shutter, lenses):
    frames = frames_in(tmp_path, rng, LENSES[lenses], shutter)
    points = rng.normal(size=(5, 3))
    colors = rng.integers(0, 255, (5, 3), np.uint8)
    (tmp_path / "p.ply").write_bytes(format_points_ply(points, colors))
    write_transforms(tmp_path / "transforms.json", frames, points_file="p.ply", test=["1.png"])
    assert len(list(tmp_path.glob("*.lens.json"))) == {"file": 1, "both": 1, "files": 3}.get(
        lenses, 0
    )
    scene = gsut.load_dataset(tmp_path)
    assert scene.test_indices == (1,) and scene.train_indices == (0, 2, 3)
    np.testing.assert_allclose(scene.points + scene.world_offset, points, atol=1e-14)
    np.testing.assert_array_equal(scene.point_colors, colors)
    for index, frame in enumerate(frames):
        view = scene.views[index]
        assert scene.camera(index) == frame.camera
        read = np.linalg.inv(scene.to_dataset(view.camera_from_world))
        np.testing.assert_allclose(read, frame.world_from_camera, atol=1e-12)
        np.testing.assert_allclose(
            scene.from_dataset(scene.to_dataset(view.camera_from_world)),
            view.camera_from_world, atol=1e-15,
        )  # fmt: skip
        assert (view.shutter is None) == (shutter is None)
        if shutter is not None:
            start = np.linalg.inv(scene.to_dataset(view.camera_from_world_start))
            np.testing.assert_allclose(start, frame.world_from_camera_start, atol=1e-12)


def test_every_lens_comes_back_from_its_dataset(tmp_path, rng):
    compared = 0
    for camera in real_lenses():
        folder = tmp_path / str(compared)
        folder.mkdir()
        small = camera.resize(32, max(1, 32 * camera.height // camera.width))
        write_transforms(folder / "transforms.json", frames_in(folder, rng, [small]))
        read = gsut.load_dataset(folder).cameras[0]
        if small.model == "opencv5" and small.params[-1] == 0:
            continue
        assert read == small, camera
        assert load_camera(folder / "transforms.json") == small
        compared += 1
    assert compared >= len(gsut.lens.camera_models())


def test_lens_file_of_gsut_keeps_what_mrcal_keeps(tmp_path):
    gsut.save_camera(STEREOGRAPHIC, tmp_path / "any.lens.json")
    read = load_camera(tmp_path / "any.lens.json")
    assert read == STEREOGRAPHIC
    np.testing.assert_array_equal(read.extrinsics, STEREOGRAPHIC.extrinsics)
    np.testing.assert_array_equal(read.valid_region, STEREOGRAPHIC.valid_region)


def test_lens_file_of_each_level_wins_over_the_other(tmp_path):
    size = small_datasets.WIDTH, small_datasets.HEIGHT
    sphere = gsut.Camera("double_sphere", [40, 41, 24, 18, 0.2, 0.55], *size)
    gsut.save_camera(sphere, tmp_path / "sphere.lens.json")
    (tmp_path / "camchain.yaml").write_text(
        "".join(
            f"cam{i}:\n  camera_model: pinhole\n  distortion_model: equi\n"
            f"  intrinsics: [{40 + i}, 41, 23.5, 17.5]\n  distortion_coeffs: [0.1, 0, 0, 0]\n"
            f"  resolution: [{size[0]}, {size[1]}]\n"
            for i in range(2)
        )
    )
    values = small_datasets.transforms()
    pinhole = {key: values.pop(key) for key in ("camera_model", "fl_x", "fl_y", "cx", "cy")}
    values["lens_file"] = "sphere.lens.json"
    values["frames"][1].update(lens_file="camchain.yaml", lens_id="cam1")
    values["frames"][2].update(pinhole)
    scene = gsut.load_dataset(small_datasets.write_nerfstudio(tmp_path, values))
    assert scene.camera(0) == sphere
    assert scene.camera(1).model == "kannala_brandt" and scene.camera(1).params[0] == 41
    assert scene.camera(2).model == "pinhole"
    assert [view.camera_index for view in scene.views[3:]] == [scene.views[0].camera_index] * 7


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lens_file": "none.yaml"}, ["'lens_file'", "none.yaml", "does not exist"]),
        ({"lens_file": 3}, ["'lens_file'", "does not exist"]),
        ({"lens_file": "a.lens.json", "fl_x": 4.0}, ["'lens_file'", "fl_x", "keep one"]),
        ({"lens_file": "a.lens.json", "w": 50}, ["'w'", "50", "48"]),
        ({"lens_file": "bad.lens.json"}, ["bad.lens.json", "'params'", "list of numbers"]),
        ({"lens_file": "odd.lens.json"}, ["odd.lens.json", "no_lens", "known"]),
        ({"lens_file": "cameras.txt"}, ["cameras.txt", "2 cameras", "lens_id"]),
    ],
)
def test_bad_lens_file_names_file_and_key(tmp_path, change, words):
    size = small_datasets.WIDTH, small_datasets.HEIGHT
    gsut.save_camera(
        gsut.Camera("stereographic", [20, 20, 24, 18], *size), tmp_path / "a.lens.json"
    )
    own = {"model": "pinhole", "width": size[0], "height": size[1]}
    (tmp_path / "bad.lens.json").write_text(json.dumps({**own, "params": "x"}))
    (tmp_path / "odd.lens.json").write_text(json.dumps({**own, "model": "no_lens", "params": []}))
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 48 36 9 9 2 2\n2 PINHOLE 48 36 9 9 2 2\n")
    values = {
        key: value
        for key, value in small_datasets.transforms().items()
        if key not in ("camera_model", "fl_x", "fl_y", "cx", "cy")
    }
    small_datasets.write_nerfstudio(tmp_path, {**values, **change})
    with raises_saying(["transforms.json", *words]):
        gsut.load_dataset(tmp_path)


def test_missing_depth_file_is_a_note(tmp_path):
    values = small_datasets.transforms()
    values["frames"][3]["depth_file_path"] = "depth/3.png"
    scene = gsut.load_dataset(small_datasets.write_nerfstudio(tmp_path, values))
    assert len(scene.views) == small_datasets.VIEWS and scene.views[3].depth_path is None
    assert any("depth/3.png" in note and "1 depth file" in note for note in scene.notes)


def test_two_shutters_are_written_frame_by_frame(tmp_path, rng):
    frames = frames_in(tmp_path, rng, [FISHEYE], Shutter("top_to_bottom"))
    frames[0].shutter = Shutter("left_to_right")
    write_transforms(tmp_path / "transforms.json", frames)
    views = gsut.load_dataset(tmp_path, test_every=0).views
    found = {view.name.split("/")[-1]: view.shutter.direction for view in views}
    assert len(found) == len(frames)
    assert found == {frame.name.split("/")[-1]: frame.shutter.direction for frame in frames}


def test_a_panorama_has_what_nerfstudio_divides_by(tmp_path, rng):
    frames = frames_in(tmp_path, rng, [gsut.Camera("equirectangular", [], 64, 32)])
    write_transforms(tmp_path / "transforms.json", frames)
    values = json.loads((tmp_path / "transforms.json").read_text())
    assert [values[key] for key in ("fl_x", "fl_y", "cx", "cy")] == [32, 32, 32, 16]
