"""ROS bags, 1 and 2: topics of pictures, camera_info, odometry or poses, and tf.

BAG.bag, or a folder with metadata.yaml and .db3 or .mcap. Read by `gsut data convert BAG OUT` with
the package rosbags. A camera is a topic of pictures, raw or compressed, with its camera_info; poses
are those of an Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped topic, or of
/tf; /tf_static says where cameras sit on the body.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError
from gsut.data.layouts._bag_messages import (
    read_pose,
    stamp_message,
    strip_slash,
    write_picture,
)
from gsut.data.layouts._bag_tracks import FrameTree, Track, join_tracks
from gsut.data.layouts._layout import Layout
from gsut.data.poses import format_seconds, format_tum, invert_pose
from gsut.data.recordings import Recording, Stream
from gsut.data.rigs import BODY, OWN, Mount
from gsut.files import claim_name, to_file_name, write_file
from gsut.lens import Camera, camera_from_info
from gsut.run import Progress

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_INFO = "sensor_msgs/msg/CameraInfo"
_TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# Kinds of topics that hold poses, the first that is there is used.
_POSES = (
    "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped",
)  # fmt: skip
_LEAF = re.compile(r"/(image\w*|compressed|camera_info)$")
_TRAJECTORY = "trajectory.txt"


@dataclasses.dataclass
class _Camera:
    """A topic of pictures, and what was found of it."""

    name: str
    topic: str
    info: str | None
    images: list[Path] = dataclasses.field(default_factory=list)
    times: list[str] = dataclasses.field(default_factory=list)
    frame: str = ""
    lens: Camera | None = None
    problem: InputError | None = None  # why camera_info states no lens


def is_bag(path: Path) -> bool:
    """Returns whether this is a .bag, .mcap or .db3, or the folder of a bag of ROS 2."""
    if path.is_file():
        return path.suffix.lower() in (".bag", ".mcap", ".db3")
    return (path / "metadata.yaml").is_file() and any(
        p.suffix.lower() in (".db3", ".mcap") for p in path.iterdir()
    )


def unpack(
    bag: Path,
    folder: Path,
    *,
    poses_topic: str | None = None,
    cameras: Sequence[str] = (),
    poses_of: str | None = None,
    progress: bool = False,
) -> Recording:
    """Writes a bag's pictures and trajectory to a folder.

    Args:
        bag: the file, or the folder of ROS 2.
        folder: to write to.
        poses_topic: of the poses, where several are there; None: the only one; "": none.
        cameras: names to use, such as "cam0" of /cam0/image_raw; empty: all.
        poses_of: a frame of /tf_static whose poses a trajectory in a file holds, or None.
        progress: show a bar.

    Raises:
        InputError: the package rosbags is missing, the bag is damaged, or topics are missing.
    """
    with _open(bag) as reader:
        found = _find_cameras(reader, bag, cameras)
        topic = _choose_pose_topic(reader, bag, poses_topic)
        track, tree = Track(topic), FrameTree()
        moving: dict[tuple[str, str], Track] = {}
        wanted = {camera.topic: camera for camera in found}
        infos = {camera.info: camera for camera in found if camera.info is not None}
        topics = {*wanted, *infos, topic, "/tf", "/tf_static"}
        connections = [c for c in reader.connections if c.topic in topics]
        total = sum(c.msgcount for c in connections)
        bars = Progress(progress)
        for done, (name, received, message) in enumerate(
            _read_messages(reader, connections, bag), 1
        ):
            bars.show("messages", done, total)
            if name in wanted:
                _add_picture(wanted[name], message, stamp_message(message, received), folder)
            elif name in infos:
                _add_lens(infos[name], message, stamp_message(message, received), f"{bag}, {name}")
            elif hasattr(message, "transforms"):
                _add_transforms(name, message, received, tree, moving, f"{bag}, {name}")
            else:
                _add_pose(track, message, received, f"{bag}, {name}, message {done}")
        bars.close()
    if topic == "/tf":
        track = join_tracks(moving, tree, [camera.frame for camera in found], bag)
    if poses_of is not None and poses_of not in (BODY, OWN, *(camera.name for camera in found)):
        track.child = poses_of
    return _make_recording(bag, folder, found, track, tree)


@contextlib.contextmanager
def _open(bag: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            f"{bag} is a ROS bag, which the package rosbags reads, and Python lacks it here: pip "
            "install 'gsut[ros]'"
        ) from None
    path = bag.parent if bag.suffix.lower() in (".mcap", ".db3") else bag
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # of many kinds, the library's and the file's
        raise InputError(f"{bag} cannot be read as a ROS bag: {error}") from error
    try:
        yield reader
    finally:
        reader.close()


def _read_messages(reader: Any, connections: list, bag: Path) -> Iterator[tuple[str, int, Any]]:
    rows = reader.messages(connections=connections)
    while True:
        try:
            connection, received, raw = next(rows)
            message = reader.deserialize(raw, connection.msgtype)
        except StopIteration:
            return
        except Exception as error:  # as above
            raise InputError(f"{bag} is damaged: {error}; record or copy it again") from error
        yield connection.topic, received, message


def _find_cameras(reader: Any, bag: Path, wanted: Sequence[str]) -> list[_Camera]:
    types = {c.topic: c.msgtype for c in reader.connections}
    by_base: dict[str, _Camera] = {}
    found: dict[str, _Camera] = {}
    pictures = [topic for topic, kind in types.items() if kind in _IMAGES]
    for topic in sorted(pictures, key=lambda topic: (_IMAGES.index(types[topic]), topic)):
        if "depth" in topic.lower():
            continue
        base = topic
        while _LEAF.search(base):
            base = _LEAF.sub("", base)
        if base in by_base:  # the same pictures, compressed
            continue
        name = claim_name(to_file_name(base) if base.strip("/") else "camera", set(found))
        info = f"{base}/camera_info"
        camera = _Camera(name, topic, info if types.get(info) == _INFO else None)
        by_base[base] = found[name] = camera
    unknown = [name for name in wanted if name not in found]
    if unknown or not found:
        raise DatasetError(
            bag,
            f"there is no camera {unknown[0]}, only {', '.join(found)}" if unknown else
            f"no topic of pictures (Image, CompressedImage) among {', '.join(sorted(types))}",
            "name one of them" if unknown else "record one",
        )  # fmt: skip
    return [camera for name, camera in found.items() if not wanted or name in wanted]


def _choose_pose_topic(reader: Any, bag: Path, wanted: str | None) -> str:
    types = {c.topic: c.msgtype for c in reader.connections}
    if wanted == "":
        return wanted
    if wanted is not None:
        if types.get(wanted) not in (*_POSES, *_TF):
            raise DatasetError(
                bag,
                f"{wanted} is no topic of poses",
                f"name one of {', '.join(_list_pose_topics(types))}",
            )
        return wanted
    for kind in _POSES:
        topics = sorted(topic for topic, found in types.items() if found == kind)
        if len(topics) > 1:
            raise DatasetError(
                bag, f"it holds {len(topics)} topics of poses: {', '.join(topics)}",
                "choose one with --poses-topic",
            )  # fmt: skip
        if topics:
            return topics[0]
    return "/tf"


def _list_pose_topics(types: dict[str, str]) -> list[str]:
    return sorted(topic for topic, kind in types.items() if kind in (*_POSES, *_TF)) or ["(none)"]


def _add_picture(camera: _Camera, message: Any, time: int, folder: Path) -> None:
    place = folder / camera.name
    place.mkdir(exist_ok=True)
    camera.images.append(write_picture(message, place / str(time), camera.topic))
    camera.times.append(str(time))
    camera.frame = strip_slash(message.header.frame_id) or camera.frame


def _add_lens(camera: _Camera, message: Any, time: int, where: str) -> None:
    """Adds the lens of a CameraInfo, or why it is none: --lens may make up for it."""
    camera.frame = camera.frame or strip_slash(message.header.frame_id)
    rectified = "rect" in camera.topic.rsplit("/", 1)[-1]
    try:
        lens = camera_from_info(message, rectified=rectified, topic=where)
    except InputError as error:
        camera.problem = camera.problem or error
        return
    camera.lens = camera.lens or lens
    if lens != camera.lens and camera.problem is None:
        camera.problem = DatasetError(
            where, f"the lens changes at {format_seconds(time)} s", "give one with --lens"
        )


def _add_pose(track: Track, message: Any, received: int, where: str) -> None:
    pose = read_pose(message, where)
    if pose is not None:
        track.parent = strip_slash(message.header.frame_id)
        track.child = strip_slash(getattr(message, "child_frame_id", ""))
        track.times.append(stamp_message(message, received))
        track.poses.append(pose)


def _add_transforms(
    topic: str, message: Any, received: int, tree: FrameTree,
    moving: dict[tuple[str, str], Track], where: str,
) -> None:  # fmt: skip
    for transform in message.transforms:
        parent, child = (
            strip_slash(name) for name in (transform.header.frame_id, transform.child_frame_id)
        )
        pose = read_pose(transform, where)
        assert pose is not None
        if topic.endswith("static"):
            tree.add(parent, child, pose)
            continue
        track = moving.setdefault((parent, child), Track(topic, parent, child))
        track.times.append(stamp_message(transform, received))
        track.poses.append(pose)


def _make_recording(
    bag: Path, folder: Path, cameras: list[_Camera], track: Track, tree: FrameTree
) -> Recording:
    streams = [Stream(c.name, c.images, c.times) for c in cameras]
    recording = Recording(folder, streams, image_times="ns", pose_times="s")
    if track.times:
        text = format_tum([format_seconds(time) for time in track.times], np.array(track.poses))
        write_file(folder / _TRAJECTORY, text)
        recording.poses = folder / _TRAJECTORY
    places = {
        c.name: tree.find_transform(track.child, c.frame) if track.child and c.frame else None
        for c in cameras
    }
    recording.poses_of = BODY
    if all(camera.frame == track.child != "" for camera in cameras):
        recording.poses_of = OWN

    def make_mounts(names: Sequence[str]) -> dict[str, Mount]:
        found = {}
        for camera in cameras:
            if camera.problem is not None:
                raise camera.problem
            if camera.lens is None:
                raise DatasetError(
                    f"{bag}, {camera.topic}", "there is no camera_info of it",
                    "give its lens with --lens",
                )  # fmt: skip
            place = places[camera.name]
            where = (
                f"{bag}, {camera.topic}: /tf_static has no transform to '{camera.frame}' from "
                f"'{track.child}', which the poses are of"
            )
            found[camera.name] = Mount(
                camera.lens, where, None if place is None else invert_pose(place)
            )
        return {name: found[name] for name in names}

    recording.mounts = make_mounts
    if track.times:
        recording.notes.append(
            f"{bag}: poses of '{track.child or 'a frame without a name'}' in '{track.parent}' from "
            f"{track.topic}, pictures of {', '.join(c.topic for c in cameras)}"
        )
    return recording


LAYOUT = Layout("rosbag", "a ROS bag", rank=5, holds=is_bag, unpack=unpack)
