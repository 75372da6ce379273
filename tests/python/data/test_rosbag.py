"""Bags of ROS 1 and 2 become datasets; what is missing in them is said."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import small_datasets as small
import small_recordings as made
import tolerances
from gsut.capture.video import Video
from gsut.cli import main
from gsut.data.layouts import rosbag
from gsut.data.layouts._bag_tracks import FrameTree, Track, join_tracks
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
    connections = [SimpleNamespace(topic=t, msgtype=k) for t, k in zip(topics, kinds, strict=True)]
    reader = SimpleNamespace(connections=connections)
    found = rosbag._find_cameras(reader, Path("walk.bag"), ())
    assert {camera.topic for camera in found} == {topics[0], *topics[2:]}
    assert len({camera.name for camera in found}) == 4


def test_poses_of_tf_serve_without_odometry(write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", odometry=(), tf=True)
    gsut.convert_dataset(bag, tmp_path / "out", "euroc")
    assert_truth(gsut.load_dataset(tmp_path / "out"))


def test_poses_of_tf_from_map_to_odom_to_base_are_joined(write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", odometry=(), tf=True, corrected=True)
    gsut.convert_dataset(bag, tmp_path / "out", "euroc")
    scene = gsut.load_dataset(tmp_path / "out")
    times = made.times()[1:]  # the correction has times between those of the odometry
    assert [view.image_path.stem for view in scene.views] == [str(time) for time in times]
    for view, time in zip(scene.views, times, strict=True):
        made.assert_pose(view, 0, time)


def test_two_moving_ways_up_to_one_camera_are_refused(tmp_path):
    tracks = {(parent, "base"): Track("/tf", parent, "base") for parent in ("map", "odom")}
    with raises_saying(("no single way", "map to base, odom to base", "--to films")):
        join_tracks(tracks, FrameTree(), ["base"], tmp_path)
    circle = {pair: Track("/tf", *pair) for pair in (("a", "b"), ("b", "a"))}
    with raises_saying(("no single way",)):
        join_tracks(circle, FrameTree(), ["a"], tmp_path)


@pytest.mark.parametrize("state", [{}, {"compressed": True}, {"calibrated": False}])
def test_a_bag_without_poses_becomes_a_film_of_the_same_pictures(state, write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", odometry=(), **state)
    notes = gsut.convert_dataset(bag, tmp_path / "out", "films")
    lens = tmp_path / "out" / "cam0.lens.json"
    said = f"gsut scene cam0.mov{' --camera cam0.lens.json' if lens.exists() else ''} -o SCENE"
    assert said in notes[-1] and lens.exists() == (state.get("calibrated", True))
    with Video(tmp_path / "out" / "cam0.mov") as film:
        frames = [(time, picture()[..., ::-1]) for _, time, picture in film.read_frames()]
    times = np.array(made.times())
    assert len(frames) == len(times) == small.VIEWS
    for (seconds, picture), time in zip(frames, times, strict=True):
        assert seconds == pytest.approx((time - times[0]) / 1e9, abs=1e-6)
        np.testing.assert_array_equal(picture, small.render(made.world_from_camera(0, time)))


def test_films_take_a_range_of_times_and_no_poses(write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE")
    seconds = (np.array(made.times()) - made.times()[0]) / 1e9
    parts = {"time_range": [0.0, (seconds[1] + seconds[2]) / 2]}
    notes = gsut.convert_dataset(bag, tmp_path / "out", "films", parts=parts)
    assert notes[-1].startswith("2 pictures")
    with raises_saying(("two times at least",)):
        gsut.convert_dataset(bag, tmp_path / "one", "films", parts={"time_range": [0.0, 0.0]})
    with raises_saying(("films hold no poses",)):
        gsut.convert_dataset(bag, tmp_path / "two", "films", poses_topic="/odom")
    with raises_saying(("is no ROS bag",)):
        gsut.convert_dataset(tmp_path, tmp_path / "two", "films")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "walk"]


def test_a_camchain_places_the_camera_where_tf_does_not(write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", static=False)
    (tmp_path / "chain.yaml").write_text(made.camchain())
    gsut.convert_dataset(bag, tmp_path / "out", parts={"lens": str(tmp_path / "chain.yaml")})
    made.assert_pose(gsut.load_dataset(tmp_path / "out").views[0], 0, made.START)


@pytest.mark.parametrize("state", [{"calibrated": False}, {"zooms": True}])
def test_a_lens_file_serves_a_bag_without_one_lens(state, write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", **state)
    (tmp_path / "chain.yaml").write_text(made.camchain())
    gsut.convert_dataset(bag, tmp_path / "out", parts={"lens": str(tmp_path / "chain.yaml")})
    made.assert_pose(gsut.load_dataset(tmp_path / "out").views[0], 0, made.START)


def test_a_trajectory_in_a_file_serves_a_bag_without_poses(write_bag, tmp_path):
    bag = write_bag(tmp_path / "walk", "ROS2_HUMBLE", odometry=())
    (tmp_path / "slam.txt").write_text(made.trajectory(made.times()))
    parts = {"poses": str(tmp_path / "slam.txt"), "poses_of": "base"}
    gsut.convert_dataset(bag, tmp_path / "out", parts=parts)
    assert_truth(gsut.load_dataset(tmp_path / "out"))


REFUSED = {
    "no_place": ({"static": False}, {}, ("no transform to 'cam0_optical' from 'base'", "poses_of")),
    "two_odometries": ({"odometry": ("/a", "/b")}, {}, ("2 topics of poses: /a, /b",
                                                        "--poses-topic")),
    "no_poses": ({"odometry": ()}, {}, ("no topic of poses", "--poses FILE")),
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
