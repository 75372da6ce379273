"""Bags of ROS 1 and 2 become datasets; what is missing in them is said."""

import sys
from pathlib import Path

import numpy as np
import pytest

import gsut
import small_datasets as small
import small_recordings as made
import tolerances
from gsut.cli import main
from gsut.data import find_lens_files
from gsut.data.images import decode_image
from gsut.data.layouts import rosbag
from gsut.files import UNFINISHED
from raising import raises_saying

STORES = {"ROS1_NOETIC": "walk.bag", "ROS2_HUMBLE": "walk"}


@pytest.fixture
def write_bag():
    pytest.importorskip("rosbags", reason="rosbags writes and reads bags")
    from small_bags import write_bag

    return write_bag


def assert_truth(scene: gsut.Scene) -> None:
    assert len(scene) == small.VIEWS
    np.testing.assert_allclose(
        scene.cameras[0].params[:4], [small.FX, small.FY, small.CX, small.CY],
        rtol=tolerances.LAYOUT_POSE,
    )  # fmt: skip
    for i, (view, time) in enumerate(zip(scene.views, made.times(), strict=True)):
        assert view.image_path.stem == str(time)
        made.assert_pose(view, 0, time)
        picture = small.render(made.world_from_camera(0, time))
        np.testing.assert_array_equal(scene.image(i), picture)


@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize("compressed", [False, True])
def test_bag_becomes_a_dataset_with_exact_times(store, compressed, write_bag, tmp_path, capsys):
    bag = write_bag(tmp_path / STORES[store], store, compressed=compressed)
    assert main(["data", "convert", str(bag), str(tmp_path / "out")]) == 0
    assert "poses of 'base' in 'map' from /odom" in capsys.readouterr().err
    assert_truth(gsut.load_dataset(tmp_path / "out"))
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(UNFINISHED)] == []


@pytest.mark.parametrize("topic", ["/..", "/../../x", "/.", "/a\0b:c", "/.git"])
def test_topic_of_a_bag_never_leaves_the_output_folder(topic, write_bag, tmp_path):
    (tmp_path / "in").mkdir()
    bag = write_bag(tmp_path / "in" / "walk.bag", "ROS1_NOETIC", camera=topic)
    gsut.convert_dataset(bag, tmp_path / "out" / "data")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", "out"]
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["data"]
    assert_truth(gsut.load_dataset(tmp_path / "out" / "data"))


def test_topics_that_differ_in_slashes_alone_stay_two_cameras():
    names = ("a/b", "a/b", "a/b_3", "a_b", "a/b/")
    topics = [f"/{name}/image_raw" for name in names]
    topics[1] += "/compressed"
    kinds = [rosbag._IMAGES["compressed" in topic] for topic in topics]
    found = rosbag.find_cameras(dict(zip(topics, kinds, strict=True)), Path("walk.bag"), ())
    assert {camera.topic for camera in found} == {topics[0], *topics[2:]}
    assert len({camera.name for camera in found}) == 4


@pytest.mark.parametrize("state", [{}, {"compressed": True}, {"calibrated": False}])
def test_a_bag_without_poses_becomes_a_folder_of_pictures_and_a_lens(state, write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", odometry=(), **state)
    notes = gsut.convert_dataset(bag, tmp_path / "out")
    assert f"`gsut scene {tmp_path}/out -o SCENE` finds them" in notes[-1]
    assert (tmp_path / "out/cam0.lens.json").exists() == state.get("calibrated", True)
    assert bool(find_lens_files(tmp_path / "out")) == state.get("calibrated", True)
    for time in made.times():
        pixels, _ = decode_image(tmp_path / f"out/images/cam0/{time}.png")
        np.testing.assert_array_equal(pixels, small.render(made.world_from_camera(0, time)))


@pytest.mark.parametrize("state", [{"static": False}, {"calibrated": False}, {"zooms": True}])
def test_a_camchain_serves_a_bag_without_place_or_one_lens(state, write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", **state)
    (tmp_path / "chain.yaml").write_text(made.camchain())
    gsut.convert_dataset(bag, tmp_path / "out", parts={"lens": str(tmp_path / "chain.yaml")})
    made.assert_pose(gsut.load_dataset(tmp_path / "out").views[0], 0, made.START)


def test_a_trajectory_in_a_file_serves_a_bag_without_poses(write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", odometry=())
    (tmp_path / "slam.txt").write_text(made.trajectory(made.times()))
    (tmp_path / "chain.yaml").write_text(made.camchain())
    parts = {"poses": str(tmp_path / "slam.txt"), "lens": str(tmp_path / "chain.yaml")}
    gsut.convert_dataset(bag, tmp_path / "out", parts=parts)
    assert_truth(gsut.load_dataset(tmp_path / "out"))


REFUSED = {
    "no_place": ({"static": False}, {}, ("no transform to 'cam0_optical' from 'base'", "poses_of")),
    "two_odometries": ({"odometry": ("/a", "/b")}, {}, ("2 topics of poses: /a, /b",
                                                        "--poses-topic")),
    "not_calibrated": ({"calibrated": False}, {}, ("not calibrated (K is all zero)", "--lens")),
    "a_zoom": ({"zooms": True}, {}, ("camera_info: the lens changes at 1403636580.", "--lens")),
    "wrong_topic": ({}, {"poses_topic": "/gps"}, ("/gps is no topic of poses", "/odom")),
    "wrong_camera": ({}, {"parts": {"cameras": ["left"]}}, ("no camera left, only cam0",)),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_bag_lacks_is_one_sentence(name, write_bag, tmp_path):
    made_with, asked, parts = REFUSED[name]
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", **made_with)
    with raises_saying(parts):
        gsut.convert_dataset(bag, tmp_path / "out", **asked)
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]


def test_a_bag_is_no_dataset_until_it_is_converted(tmp_path):
    (tmp_path / "walk.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(gsut.InputError, match="gsut data convert"):
        gsut.load_dataset(tmp_path / "walk.bag")


@pytest.mark.parametrize("command", ["poses", "scene"])
@pytest.mark.parametrize("store", STORES)
def test_poses_and_scene_of_a_bag_name_the_command_that_unpacks_it(
    command, store, write_bag, tmp_path, capsys
):
    bag = write_bag(tmp_path / STORES[store], store)
    assert main([command, str(bag), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    assert f"a ROS bag, whose pictures are inside; `gsut data convert {bag} FOLDER`" in (
        capsys.readouterr().err
    )
    assert not (tmp_path / "out").exists()


def test_a_damaged_bag_is_said_to_be_one(write_bag, tmp_path):
    (tmp_path / "walk.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    with pytest.raises(gsut.InputError, match="cannot be read as a ROS bag"):
        gsut.convert_dataset(tmp_path / "walk.bag", tmp_path / "out")


def test_without_the_library_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (tmp_path / "walk.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(gsut.InputError, match=r"pip install 'gsut\[ros\]'"):
        gsut.convert_dataset(tmp_path / "walk.bag", tmp_path / "out")
