"""Each reader gives the same scene from the same plane, cameras and points."""

import json
from pathlib import Path

import numpy as np
import pytest

import small_datasets as small
import tolerances
from gsut.data import load_dataset

WRITERS = {
    "nerfstudio": small.write_nerfstudio,
    "colmap_text": small.write_colmap_text,
    "colmap_binary": small.write_colmap_binary,
    "folder": small.write_folder,
}


def dataset_centers(scene) -> np.ndarray:
    return np.array([view.camera_center for view in scene.views]) + scene.world_offset


@pytest.mark.parametrize("kind", WRITERS)
def test_load_each_format_gives_the_same_scene(kind, tmp_path):
    scene = load_dataset(WRITERS[kind](tmp_path))
    assert len(scene) == small.VIEWS
    assert len(scene.cameras) == 1 and scene.notes == ()
    camera = scene.cameras[0]
    assert (camera.model, camera.width, camera.height) == ("pinhole", small.WIDTH, small.HEIGHT)
    np.testing.assert_array_equal(camera.params, [small.FX, small.FY, small.CX, small.CY])
    truth = small.world_from_cameras()
    for i, view in enumerate(scene.views):
        assert Path(view.name).name == f"{i:03d}.png"
        expected = np.linalg.inv(truth[i])
        np.testing.assert_allclose(
            view.camera_from_world[:3, :3], expected[:3, :3], atol=tolerances.DATA_POSE
        )
        np.testing.assert_array_equal(scene.image(i), small.render(truth[i]))
        assert scene.mask(i).all()
    centers = np.array([pose[:3, 3] for pose in truth])
    np.testing.assert_allclose(dataset_centers(scene), centers, atol=tolerances.DATA_POSE)
    np.testing.assert_allclose(
        np.mean([v.camera_center for v in scene.centred.views], axis=0),
        0,
        atol=tolerances.DATA_POSE,
    )
    xyz, rgb = small.points()
    np.testing.assert_allclose(
        scene.points + scene.world_offset, xyz, atol=tolerances.DATA_PLY_POSITION
    )
    np.testing.assert_array_equal(scene.point_colors, rgb)
    assert scene.test_indices == (0, 8) and len(scene.train_indices) == 8


def test_load_points_fall_on_pixels_of_their_colour(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path))
    compared = 0
    for i, view in enumerate(scene.views):
        pose = view.camera_from_world
        pixels, valid = scene.camera(i).project(scene.points @ pose[:3, :3].T + pose[:3, 3])
        x, y = np.floor(pixels[valid]).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < small.WIDTH) & (y < small.HEIGHT)
        seen = scene.image(i)[y[inside], x[inside]].astype(int)
        error = np.abs(seen - scene.point_colors[valid][inside])
        assert error.max() <= tolerances.DATA_TEXTURE_STEP
        compared += inside.sum()
    assert compared > 1000


def test_load_transforms_file_itself_is_accepted(tmp_path):
    path = small.write_nerfstudio(tmp_path) / "transforms.json"
    assert len(load_dataset(path)) == small.VIEWS


def test_load_frame_intrinsics_win_over_the_files(tmp_path):
    values = small.transforms()
    values["frames"][3]["fl_x"] = 55.0
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    assert len(scene.cameras) == 2
    assert [scene.camera(i).params[0] for i in (2, 3)] == [small.FX, 55.0]


def test_load_field_of_view_only_gives_focal_length_and_centre(tmp_path):
    values = small.transforms()
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del values[key]
    values["camera_angle_x"] = 2 * np.arctan(0.5)
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    expected = [small.WIDTH, small.WIDTH, small.WIDTH / 2, small.HEIGHT / 2]
    np.testing.assert_allclose(scene.cameras[0].params, expected, rtol=tolerances.DATA_ROUNDING)


def test_load_missing_images_are_counted_named_and_left_out(tmp_path):
    small.write_nerfstudio(tmp_path)
    (tmp_path / "images/002.png").unlink()
    (tmp_path / "images/005.png").unlink()
    scene = load_dataset(tmp_path)
    assert len(scene) == small.VIEWS - 2
    assert len(scene.notes) == 1
    assert "2 of 10 images do not exist" in scene.notes[0]
    assert "images/002.png, images/005.png" in scene.notes[0]


def test_load_file_path_without_suffix_finds_the_image(tmp_path):
    values = small.transforms()
    for frame in values["frames"]:
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    assert [view.name for view in scene.views] == small.names()


def test_load_names_with_spaces_and_unicode_are_kept(tmp_path):
    values = small.transforms()
    small.write_nerfstudio(tmp_path)
    name = "images/görlitz  platz 東京.png"
    (tmp_path / "images/004.png").rename(tmp_path / name)
    values["frames"][4]["file_path"] = name
    (tmp_path / "transforms.json").write_text(json.dumps(values, ensure_ascii=False), "utf-8")
    scene = load_dataset(tmp_path, test_names=[name])
    assert [scene.views[i].name for i in scene.test_indices] == [name]
    assert scene.image(scene.test_indices[0]).shape == (small.HEIGHT, small.WIDTH, 3)


def test_load_colmap_names_with_spaces_and_folders_are_kept(tmp_path):
    small.write_colmap_text(tmp_path)
    listing = tmp_path / "sparse/0/images.txt"
    listing.write_text(listing.read_text().replace("003.png", "left cam/a b ü.png"), "utf-8")
    (tmp_path / "images/left cam").mkdir()
    (tmp_path / "images/003.png").rename(tmp_path / "images/left cam/a b ü.png")
    assert "left cam/a b ü.png" in [view.name for view in load_dataset(tmp_path).views]


def test_load_repeated_frame_is_used_once(tmp_path):
    values = small.transforms()
    values["frames"].append(dict(values["frames"][3]))
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    assert len(scene) == small.VIEWS
    assert "1 images are listed twice" in scene.notes[0]


def test_load_rolling_shutter_poses_are_kept(tmp_path):
    values = small.transforms()
    truth = small.world_from_cameras()
    for i, frame in enumerate(values["frames"]):
        for key, shift in (("start", -0.01), ("end", 0.01)):
            pose = truth[i].copy()
            pose[0, 3] += shift
            frame[f"transform_matrix_{key}"] = (pose @ small.OPENGL_FROM_OPENCV).tolist()
        if i % 2:
            del frame["transform_matrix"]  # then it lies half way between the two
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    assert len(scene) == small.VIEWS
    for i, view in enumerate(scene.views):
        for key, shift in (("_start", -0.01), ("", 0.0), ("_end", 0.01)):
            pose = np.linalg.inv(getattr(view, f"camera_from_world{key}"))
            expected = truth[i][:3, 3] + [shift, 0, 0] - scene.world_offset
            np.testing.assert_allclose(pose[:3, 3], expected, atol=tolerances.DATA_POSE)
            np.testing.assert_allclose(pose[:3, :3], truth[i][:3, :3], atol=tolerances.DATA_POSE)


def test_load_utm_coordinates_keep_their_digits(tmp_path):
    """5.4e6 m from the origin, where float32 would round by 0.5 m."""
    values = small.transforms()
    offset = np.array([4.5e5, 5.4e6, 300.0])
    for frame in values["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] += offset
        frame["transform_matrix"] = matrix.tolist()
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    truth = np.array([pose[:3, 3] for pose in small.world_from_cameras()])
    centers = np.array([view.camera_center for view in scene.views])
    np.testing.assert_allclose(
        centers - centers[0], truth - truth[0], atol=tolerances.DATA_UTM_POSITION
    )
    np.testing.assert_allclose(
        scene.centred.world_offset, offset + truth.mean(axis=0), rtol=tolerances.DATA_ROUNDING
    )


ALL = small.names()
LISTS = {"train_filenames": ALL[:6], "test_filenames": ALL[7:9]}
# Lists of the file, arguments of `load_dataset`, the views held out and the number trained on.
SPLITS = {
    "the file's lists": (LISTS, {}, (7, 8), 6),
    "validation, where there is no test list": ({"val_filenames": ALL[2:4]}, {}, (2, 3), 8),
    "full name": (LISTS, {"test_names": ["images/004.png"]}, (4,), 9),
    "file name": (LISTS, {"test_names": ["004.png"]}, (4,), 9),
    "stem": (LISTS, {"test_names": ["004"]}, (4,), 9),
    "none": ({}, {"test_every": 0}, (), 10),
    "every 4th": ({}, {"test_every": 4}, (0, 4, 8), 7),
    "every 8th": ({}, {"test_every": 8}, (0, 8), 8),
    "a single image": ({"frames": 1}, {}, (), 1),
}


@pytest.mark.parametrize("name", SPLITS)
def test_load_split(name, tmp_path):
    lists, arguments, test, trained = SPLITS[name]
    frames = small.transforms()["frames"][: lists.get("frames")][::-1]  # sorted by name again
    path = small.write_nerfstudio(tmp_path, **{**lists, "frames": frames})
    scene = load_dataset(path, **arguments)
    assert scene.test_indices == test and len(scene.train_indices) == trained
    assert not set(scene.train_indices) & set(test)
    assert bool(scene.notes) == (name == "the file's lists")
    if scene.notes:
        assert (
            scene.train_indices == tuple(range(6)) and "2 images are in no list" in scene.notes[0]
        )


def test_load_colmap_beside_transforms_moves_its_points(tmp_path):
    """The points of colmap/sparse are in the frame before applied_transform."""
    small.write_colmap_text(tmp_path / "colmap")
    values = small.transforms()
    del values["ply_file_path"]
    transform = [[0, 1, 0, 5], [1, 0, 0, 0], [0, 0, -1, 2]]
    scene = load_dataset(small.write_nerfstudio(tmp_path, values, applied_transform=transform))
    xyz = small.points()[0]
    expected = np.stack([xyz[:, 1] + 5, xyz[:, 0], 2 - xyz[:, 2]], axis=1)
    np.testing.assert_allclose(
        scene.points + scene.world_offset, expected, atol=tolerances.DATA_POSE
    )


def test_load_colmap_scaled_images_resize_the_camera(tmp_path):
    small.write_colmap_binary(tmp_path)
    (tmp_path / "images").rename(tmp_path / "full")
    for i in range(small.VIEWS):
        pixels = np.zeros((small.HEIGHT // 2, small.WIDTH // 2, 3), np.uint8)
        small.write_png(tmp_path / f"images_2/{i:03d}.png", pixels)
    scene = load_dataset(tmp_path)
    expected = np.array([small.FX, small.FY, small.CX, small.CY]) / 2
    np.testing.assert_allclose(scene.cameras[0].params, expected, rtol=tolerances.DATA_ROUNDING)
    assert any("resized from 48 x 36 to 24 x 18" in note for note in scene.notes)


@pytest.mark.parametrize("folder", ["sparse/0", "sparse", "."])
def test_load_colmap_model_is_found_in_each_place(folder, tmp_path):
    small.write_colmap_text(tmp_path)
    target = tmp_path / folder
    if folder != "sparse/0":
        for file in list((tmp_path / "sparse/0").iterdir()):
            file.rename(target / file.name)
        (tmp_path / "sparse/0").rmdir()
    assert len(load_dataset(tmp_path)) == small.VIEWS
    assert len(load_dataset(target)) == small.VIEWS  # the model's own folder


@pytest.mark.parametrize("style", ["000.png", "000.png.png"])
def test_load_colmap_masks_of_both_names_are_found(style, tmp_path):
    small.write_colmap_text(tmp_path)
    mask = np.full((small.HEIGHT, small.WIDTH), 255, np.uint8)
    mask[:5] = 0
    small.write_png(tmp_path / "masks" / style, mask)
    scene = load_dataset(tmp_path)
    assert not scene.mask(0)[:5].any() and scene.mask(0)[5:].all()
    assert scene.mask(1).all()


def test_load_folder_poses_json_equals_poses_txt(tmp_path):
    scene = load_dataset(small.write_folder(tmp_path))
    (tmp_path / "poses.txt").unlink()
    stems = [Path(name).stem for name in small.names()]
    matrices = [pose.tolist() for pose in small.world_from_cameras()]
    (tmp_path / "poses.json").write_text(json.dumps(dict(zip(stems, matrices, strict=True))))
    other = load_dataset(tmp_path)
    assert len(other) == small.VIEWS
    for mine, theirs in zip(scene.views, other.views, strict=True):
        np.testing.assert_allclose(
            mine.camera_from_world, theirs.camera_from_world, atol=tolerances.DATA_POSE
        )


def test_load_folder_timestamps_match_file_names_as_numbers(tmp_path):
    small.write_folder(tmp_path)
    poses = tmp_path / "poses.txt"
    text = poses.read_text()
    for i in range(small.VIEWS):
        text = text.replace(f"{i:03d}.png ", f"{i}.0 ")
    poses.write_text(text)
    assert len(load_dataset(tmp_path)) == small.VIEWS


def test_load_folder_images_without_pose_are_named(tmp_path):
    small.write_folder(tmp_path)
    poses = tmp_path / "poses.txt"
    poses.write_text("\n".join(poses.read_text().splitlines()[:-2]) + "\n")
    scene = load_dataset(tmp_path)
    assert len(scene) == small.VIEWS - 2
    assert "2 of 10 images have no pose" in scene.notes[0] and "009.png" in scene.notes[0]


@pytest.mark.parametrize(
    ("name", "train", "test", "missing"),
    [
        ("fox", 43, 7, 17),
        ("sponza_fisheye", 60, 10, 0),
        ("sponza_fisheye_tiny", 20, 4, 0),
        ("helmet_distorted_rs", 30, 5, 0),
    ],
)
def test_load_shared_dataset_gives_its_known_split(shared, name, train, test, missing):
    scene = load_dataset(shared / "data" / name)
    assert (len(scene.train_indices), len(scene.test_indices)) == (train, test)
    assert bool(scene.notes) == bool(missing)
    if missing:
        assert f"{missing} of {train + test + missing} images do not exist" in scene.notes[0]
    assert len(scene.points) == len(scene.point_colors) > 1000
