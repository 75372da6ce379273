"""Datasets written in every layout and read again; from arrays, from runs; scenes in memory."""

import json
from pathlib import Path

import numpy as np
import pytest

import gsut
import small_datasets as small
import small_recordings as made
import tolerances
from gsut.cli import main
from gsut.data import list_writable_layouts
from gsut.data.export import Export
from gsut.files import UNFINISHED
from raising import raises_saying

LAYOUTS = sorted(list_writable_layouts())


def assert_same(scene: gsut.Scene, other: gsut.Scene, order=None) -> None:
    """Poses, lenses, pixels, masks and points are equal, view by view."""
    assert len(scene) == len(other) > 0
    for i, k in enumerate(range(len(scene)) if order is None else order):
        np.testing.assert_allclose(
            scene.views[i].camera_from_world, other.views[k].camera_from_world,
            rtol=0, atol=tolerances.LAYOUT_POSE,
        )  # fmt: skip
        mine, theirs = scene.camera(i), other.camera(k)
        np.testing.assert_allclose(mine.params[:4], theirs.params[:4], rtol=tolerances.LAYOUT_POSE)
        np.testing.assert_array_equal(scene.image(i), other.image(k))
    np.testing.assert_array_equal(scene.points, other.points)
    np.testing.assert_array_equal(scene.point_colors, other.point_colors)


@pytest.mark.parametrize("to", LAYOUTS)
def test_a_dataset_is_the_same_in_every_layout(to, tmp_path):
    scene = gsut.load_dataset(small.write_nerfstudio(tmp_path / "in"), test_every=0)
    gsut.convert_dataset(tmp_path / "in", tmp_path / "out", to)
    assert_same(gsut.load_dataset(tmp_path / "out", test_every=0), scene)
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(UNFINISHED)] == []


@pytest.mark.parametrize("to", LAYOUTS)
@pytest.mark.parametrize("place", ["", "../images/"])
def test_images_whose_names_meet_below_images_all_keep_their_pixels(place, to, tmp_path):
    data = small.write_nerfstudio(tmp_path / "in")
    values = json.loads((data / "transforms.json").read_text())
    first, second = (values["frames"][i]["file_path"] for i in (0, 1))
    values["frames"][1]["file_path"] = place + Path(first).name
    (data / place).mkdir(exist_ok=True)
    (data / second).rename(data / values["frames"][1]["file_path"])
    (data / "transforms.json").write_text(json.dumps(values))
    scene = gsut.load_dataset(data, test_every=0)
    gsut.convert_dataset(data, tmp_path / "out", to)
    found = gsut.load_dataset(tmp_path / "out", test_every=0)
    assert len(found) == len(scene) == small.VIEWS
    pixels = {scene.image(i).tobytes() for i in range(len(scene))}
    assert {found.image(i).tobytes() for i in range(len(found))} == pixels


@pytest.mark.parametrize("to", LAYOUTS)
def test_a_rig_is_the_same_in_every_layout(to, tmp_path):
    scene = gsut.load_dataset(made.write_euroc(tmp_path / "in"), test_every=0)
    gsut.convert_dataset(tmp_path / "in", tmp_path / "out", to)
    found = gsut.load_dataset(tmp_path / "out", test_every=0)
    assert_same(found, scene)


def test_an_output_folder_that_holds_something_is_left_alone(tmp_path):
    small.write_nerfstudio(tmp_path / "in")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("kept")
    with pytest.raises(gsut.InputError, match="exists"):
        gsut.convert_dataset(tmp_path / "in", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_an_interrupted_conversion_leaves_nothing(tmp_path, monkeypatch):
    small.write_nerfstudio(tmp_path / "in")
    monkeypatch.setattr(Export, "write_points", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        gsut.convert_dataset(tmp_path / "in", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_what_layouts_have_no_place_for_is_said(tmp_path):
    small.write_nerfstudio(tmp_path / "in", test_filenames=small.names()[:2], mask_path="mask.png")
    small.write_png(tmp_path / "in/mask.png", np.full((small.HEIGHT, small.WIDTH), 255, np.uint8))
    notes = gsut.convert_dataset(tmp_path / "in", tmp_path / "out", "colmap")
    assert any("no place for lists of held-out images" in note for note in notes)
    assert gsut.convert_dataset(tmp_path / "in", tmp_path / "same", "nerfstudio") == []
    scene = gsut.load_dataset(tmp_path / "same")
    assert len(scene.test_indices) == 2 and scene.views[0].mask_path is not None
    check_nerfstudio_split(json.loads((tmp_path / "same/transforms.json").read_text()))


def check_nerfstudio_split(values: dict) -> None:
    """Fails where nerfstudio's reader would: with one list of images, it requires all three."""
    known = {frame["file_path"] for frame in values["frames"]}
    lists = [values.get(f"{split}_filenames") for split in ("train", "val", "test")]
    assert all(lists) and known.issuperset(name for names in lists for name in names)


def test_what_a_dataset_has_is_not_given_again(tmp_path):
    small.write_nerfstudio(tmp_path / "in")
    with raises_saying(["'time_offset'", "give both lens and poses"]):
        gsut.convert_dataset(tmp_path / "in", tmp_path / "out", parts={"time_offset": 1.0})


def test_convert_says_that_times_and_depths_have_no_place(tmp_path):
    values = small.transforms()
    for number, frame in enumerate(values["frames"]):
        frame |= {"timestamp": number / 2, "depth_file_path": "depth.png"}
    small.write_png(tmp_path / "in/depth.png", np.ones((small.HEIGHT, small.WIDTH), np.uint16))
    small.write_nerfstudio(tmp_path / "in", values)
    notes = " ".join(gsut.convert_dataset(tmp_path / "in", tmp_path / "out", "colmap"))
    assert "those of 10 images are left out" in notes and "no place for the times" in notes


def test_convert_of_a_lens_with_a_valid_field_says_what_the_layout_drops(tmp_path):
    small.write_nerfstudio(
        tmp_path / "in", camera_model="OPENCV_FISHEYE", k1=0.01, max_theta_rad=1.0
    )
    notes = gsut.convert_dataset(tmp_path / "in", tmp_path / "out", "colmap")
    assert any("pixels beyond 57.3 degrees" in note for note in notes)
    assert gsut.convert_dataset(tmp_path / "in", tmp_path / "same") == []


def test_trajectory_of_pictures_without_times_says_so(tmp_path):
    small.write_nerfstudio(tmp_path / "in")
    (note,) = gsut.convert_dataset(tmp_path / "in", tmp_path / "poses.txt")
    assert "no times" in note and "begin with names" in note


# --- the command


def test_convert_command_takes_a_folder_of_pictures_a_lens_and_a_trajectory(tmp_path, capsys):
    made.write_pictures(tmp_path / "cam0", 0)
    (tmp_path / "chain.yaml").write_text(made.camchain())
    (tmp_path / "slam.txt").write_text(made.trajectory(made.times()))
    words = [
        "data", "convert", str(tmp_path / "cam0"), str(tmp_path / "out"), "--to", "colmap",
        "--lens", str(tmp_path / "chain.yaml"), "--poses", str(tmp_path / "slam.txt"),
        "--json",
    ]  # fmt: skip
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["layout"] == "colmap"
    scene = gsut.load_dataset(tmp_path / "out")
    assert [view.image_path.stem for view in scene.views] == [str(t) for t in made.times()]


def test_times_go_through_transforms_json_to_the_nanosecond(tmp_path):
    made.write_euroc(tmp_path / "in")
    gsut.convert_dataset(tmp_path / "in", tmp_path / "out", parts={"cameras": ["cam0"]})
    for row in json.loads((tmp_path / "out/transforms.json").read_text())["frames"]:
        assert row["timestamp_ns"] in made.times()
    gsut.convert_dataset(tmp_path / "out", tmp_path / "poses.txt")
    rows = (tmp_path / "poses.txt").read_text().splitlines()[1:]
    stamps = [row.split()[0] for row in rows]
    assert stamps == [f"{t // 10**9}.{t % 10**9:09d}" for t in made.times()]


def test_poses_go_out_as_a_trajectory_and_come_back(tmp_path, capsys):
    made.write_euroc(tmp_path / "in")
    out = tmp_path / "poses.txt"
    words = ["data", "convert", str(tmp_path / "in"), str(out), "--cameras", "cam0"]
    assert main(words) == 0
    assert out.read_text().splitlines()[1].split()[0] == "1403636579.763555584"
    made.write_pictures(tmp_path / "again/images", 0)
    (tmp_path / "again/lens.yaml").write_text(made.camchain(with_imu=False).split("cam1:")[0])
    out.rename(tmp_path / "again/poses.txt")
    scene = gsut.load_dataset(tmp_path / "again")
    for view, time in zip(scene.views, made.times(), strict=True):
        made.assert_pose(view, 0, time)
    assert "poses.txt" in capsys.readouterr().out


# --- from arrays


def arrays() -> dict:
    poses = np.array(small.world_from_cameras())
    points, colors = small.points()
    return {
        "images": [small.render(pose) for pose in poses],
        "cameras": gsut.Camera(
            "pinhole", [small.FX, small.FY, small.CX, small.CY], small.WIDTH, small.HEIGHT
        ),
        "camera_from_world": np.linalg.inv(poses),
        "points": points,
        "point_colors": colors,
    }


def test_save_dataset_writes_what_load_dataset_reads(tmp_path):
    given = arrays()
    valid = np.ones((small.HEIGHT, small.WIDTH), bool)
    valid[:4] = False
    masks = [valid] + [None] * (small.VIEWS - 1)
    gsut.save_dataset(tmp_path / "out", **given, masks=masks, test_names=["000003"])
    scene = gsut.load_dataset(tmp_path / "out")
    np.testing.assert_allclose(
        scene.poses(range(small.VIEWS)), given["camera_from_world"],
        rtol=0, atol=tolerances.LAYOUT_POSE,
    )  # fmt: skip
    for i, image in enumerate(given["images"]):
        np.testing.assert_array_equal(scene.image(i), image)
    np.testing.assert_allclose(scene.points, given["points"], rtol=0, atol=tolerances.LAYOUT_POSE)
    assert scene.test_indices == (3,)
    np.testing.assert_array_equal(scene.mask(0), valid)
    assert scene.mask(1).all()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


WRONG = {
    "images": (lambda a: [image[:-1] for image in a], "image 000000 is uint8 of shape (35, 48, 3)"),
    "camera_from_world": (lambda a: a[:-1], "camera_from_world has shape (9, 4, 4)"),
    "points": (lambda a: a[:, :2], "points has shape (400, 2)"),
    "point_colors": (lambda a: a / 255.0, "point_colors is float64"),
    "cameras": (lambda a: [a] * 3, "cameras has 3 entries for 10 images"),
}


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("call", ["save_dataset", "scene_from_arrays"])
def test_wrong_arrays_are_refused_by_name(call, name, tmp_path):
    change, message = WRONG[name]
    given = arrays()
    given[name] = change(given[name])
    place = (tmp_path / "out",) if call == "save_dataset" else ()
    with raises_saying([message]):
        getattr(gsut, call)(*place, **given)
    assert list(tmp_path.iterdir()) == []


def test_make_scene_is_the_scene_of_the_files(tmp_path):
    given = arrays()
    scene = gsut.scene_from_arrays(**given, test_every=4)
    small.write_nerfstudio(tmp_path)
    files = gsut.load_dataset(tmp_path, test_every=4)
    assert (scene.train_indices, scene.test_indices) == (files.train_indices, files.test_indices)
    half, small_files = scene.scale_images(0.5), files.scale_images(0.5)
    for i in range(small.VIEWS):
        np.testing.assert_array_equal(half.image(i), small_files.image(i))
        np.testing.assert_array_equal(scene.mask(i), files.mask(i))
