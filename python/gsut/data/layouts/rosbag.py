"""ROS bags, 1 and 2: topics of pictures, camera_info, poses, and /tf_static.

BAG.bag, or a folder with metadata.yaml and .db3 or .mcap. Read by `gsut data convert BAG OUT` with
the package rosbags. A camera is a topic of pictures, raw or compressed, with its camera_info; poses
are those of an Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped topic;
/tf_static says where cameras sit on the body.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.errors import DatasetError
from gsut.data.layouts._layout import Layout
from gsut.data.poses import (
    NANOSECONDS,
    format_seconds,
    format_tum,
    invert_pose,
    pose_from_quaternion,
)
from gsut.data.recordings import Recording, Stream
from gsut.data.rigs import BODY, OWN, Mount
from gsut.files import claim_name, to_file_name, write_file
from gsut.lens import Camera, camera_from_info
from gsut.run import Progress

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# Kinds of topics that hold poses, the first that is there is used.
_POSES = (
    "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped",
)  # fmt: skip
_LEAVES = ("compressed", "camera_info")  # of topics of a camera, beside image...
_COMPRESSED = {b"\xff\xd8": ".jpg", b"\x89P": ".png"}  # by their first bytes
# Channels of raw pictures of 8 or 16 bits and OpenCV's conversion to BGR. A Bayer pattern is named
# by its first two pixels; OpenCV names the second row's second and third.
_ENCODINGS = {
    "mono": (1, ""), "bgr": (3, ""), "rgb": (3, "RGB2BGR"), "bgra": (4, "BGRA2BGR"),
    "rgba": (4, "RGBA2BGR"), "bayer_rggb": (1, "BayerBG2BGR"), "bayer_bggr": (1, "BayerRG2BGR"),
    "bayer_gbrg": (1, "BayerGR2BGR"), "bayer_grbg": (1, "BayerGB2BGR"),
}  # fmt: skip


@dataclasses.dataclass
class _Camera:
    """A topic of pictures, and what was found of it; `problem` is why it has no lens."""

    name: str
    topic: str
    info: str
    images: list[Path] = dataclasses.field(default_factory=list)
    times: list[str] = dataclasses.field(default_factory=list)
    frame: str = ""
    lens: Camera | None = None
    problem: InputError | None = None

    def add_lens(self, message: Any, where: str) -> None:
        """Adds the lens of a CameraInfo, or why it is none: --lens may make up for it."""
        rectified = "rect" in self.topic.rsplit("/", 1)[-1]
        try:
            lens = camera_from_info(message, rectified=rectified, topic=where)
            if lens != (self.lens or lens):
                seconds = format_seconds(_read_time(message, 0))
                raise DatasetError(where, f"the lens changes at {seconds} s", "give it with --lens")
            self.lens = lens
        except InputError as error:
            self.problem = self.problem or error


def _find_root(parents: Mapping[str, tuple[str, np.ndarray]], frame: str) -> tuple[str, np.ndarray]:
    """Finds the frame above all others of /tf_static, and the transform (4, 4) from this one.

    `parents` has the frame above each, and the transform to that.
    """
    pose, seen = np.eye(4), {frame}
    while frame in parents and parents[frame][0] not in seen:
        frame, step = parents[frame]
        pose = step @ pose
        seen.add(frame)
    return frame, pose


def is_bag(path: Path) -> bool:
    """Returns whether this is a .bag, .mcap or .db3, or the folder of a bag of ROS 2."""
    if path.is_file():
        return path.suffix.lower() in (".bag", ".mcap", ".db3")
    return (path / "metadata.yaml").is_file() and any(
        p.suffix.lower() in (".db3", ".mcap") for p in path.iterdir()
    )


def unpack(
    bag: Path, folder: Path, *, poses_topic: str | None = None, cameras: Sequence[str] = (),
    progress: bool = False,
) -> Recording:  # fmt: skip
    """Writes a bag's pictures and trajectory to a folder.

    Args:
        bag: the file, or the folder of ROS 2.
        folder: to write to.
        poses_topic: of the poses, where several are there; None: the only one, if any; "": none.
        cameras: names to use, such as "cam0" of /cam0/image_raw; empty: all.
        progress: show a bar.

    Raises:
        InputError: the package rosbags is missing, the bag is damaged, or topics are missing.
    """
    parents, poses = dict[str, tuple[str, np.ndarray]](), dict[int, np.ndarray]()
    parent = child = ""
    with _open(bag) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        found = find_cameras(types, bag, cameras)
        topic = _choose_pose_topic(types, bag, poses_topic)
        wanted, infos = {c.topic: c for c in found}, {c.info: c for c in found}
        names = {*wanted, *infos, topic, "/tf_static"}
        connections = [c for c in reader.connections if c.topic in names]
        total, bars = sum(c.msgcount for c in connections), Progress(progress)
        rows = reader.messages(connections=connections)
        for done, (connection, received, raw) in enumerate(rows, 1):
            bars.show("messages", done, total)
            name, where = connection.topic, f"{bag}, {connection.topic}"
            message = reader.deserialize(raw, connection.msgtype)
            if name == "/tf_static":
                for each in message.transforms:
                    above, frame = _read_frames(each)
                    parents[frame] = above, _read_pose(each, where)
            elif name in wanted:
                _add_picture(wanted[name], message, _read_time(message, received), folder)
            elif name in infos:
                infos[name].add_lens(message, where)
            else:
                poses[_read_time(message, received)] = _read_pose(message, where)
                parent, child = _read_frames(message)
        bars.close()
    recording = _make_recording(bag, folder, found, parents, child)
    if poses:
        recording.poses = folder / "trajectory.txt"
        stamps = [format_seconds(time) for time in poses]
        write_file(recording.poses, format_tum(stamps, np.array([*poses.values()])))
        what = f"poses of '{child or 'a frame without a name'}' in '{parent}' from {topic}"
        recording.notes.append(f"{bag}: {what}, pictures of {', '.join(wanted)}")
    return recording


@contextlib.contextmanager
def _open(bag: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            f"{bag} is a ROS bag, which the package rosbags reads: pip install 'gsut[ros]'"
        ) from None
    path = bag.parent if bag.suffix.lower() in (".mcap", ".db3") else bag
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except (InputError, OSError, MemoryError):
        raise
    except Exception as error:  # of many kinds, the library's and the file's
        raise InputError(
            f"{bag} cannot be read as a ROS bag: {error}; record or copy it again"
        ) from error


def _strip_leaves(topic: str) -> str:
    """Strips the last parts of a topic that name pictures, not the camera."""
    parts = topic.split("/")
    while len(parts) > 1 and (parts[-1].startswith("image") or parts[-1] in _LEAVES):
        parts.pop()
    return "/".join(parts)


def find_cameras(types: dict[str, str], bag: Path, wanted: Sequence[str]) -> list[_Camera]:
    """Finds the cameras among topics, raw pictures before the same ones compressed."""
    found: dict[str, _Camera] = {}
    pictures = [t for t, kind in types.items() if kind in _IMAGES and "depth" not in t.lower()]
    for topic in sorted(pictures, key=lambda topic: (_IMAGES.index(types[topic]), topic)):
        base = _strip_leaves(topic)
        if f"{base}/camera_info" not in {camera.info for camera in found.values()}:
            name = claim_name(to_file_name(base) if base.strip("/") else "camera", set(found))
            found[name] = _Camera(name, topic, f"{base}/camera_info")
    if not found:
        what = f"no topic of pictures (Image, CompressedImage) among {', '.join(sorted(types))}"
        raise DatasetError(bag, what, "record one")
    for name in wanted:
        if name not in found:
            what = f"there is no camera {name}, only {', '.join(found)}"
            raise DatasetError(bag, what, "name one of them")
    return [camera for name, camera in found.items() if not wanted or name in wanted]


def _choose_pose_topic(types: dict[str, str], bag: Path, wanted: str | None) -> str:
    """Chooses the topic of poses, of the kind that comes first in `_POSES`; "" if there is none."""
    known = {kind: sorted(t for t, its in types.items() if its == kind) for kind in _POSES}
    topics = [topic for each in known.values() for topic in each]
    if wanted and wanted not in topics:
        advice = f"name one of {', '.join(topics) or '(none)'}"
        raise DatasetError(bag, f"{wanted} is no topic of poses", advice)
    first = next(filter(None, known.values()), [""])
    if wanted is None and len(first) > 1:
        what = f"it holds {len(first)} topics of poses: {', '.join(first)}"
        raise DatasetError(bag, what, "choose one with --poses-topic")
    return first[0] if wanted is None else wanted


def _add_picture(camera: _Camera, message: Any, time: int, folder: Path) -> None:
    """Writes a picture without a loss: a compressed one as it is, a raw one as PNG."""
    import cv2

    data = np.asarray(message.data, np.uint8).tobytes()
    suffix = ".png" if hasattr(message, "encoding") else _COMPRESSED.get(data[:2])
    if suffix is None:
        raise InputError(
            f"{camera.topic}: a compressed picture of format '{message.format}' is neither JPEG "
            "nor PNG; republish the topic as raw or JPEG"
        )
    if hasattr(message, "encoding"):
        data = cv2.imencode(".png", _decode_pixels(message, data, camera.topic))[1].tobytes()
    file = folder / camera.name / f"{time}{suffix}"
    file.parent.mkdir(exist_ok=True)
    write_file(file, data)
    camera.images.append(file)
    camera.times.append(str(time))
    camera.frame = _read_frames(message)[0] or camera.frame


def _decode_pixels(message: Any, data: bytes, where: str) -> np.ndarray:
    """Decodes a raw picture to grey, or to blue, green, red; 8 or 16 bits."""
    import cv2

    encoding = str(message.encoding).lower()
    order = encoding.rstrip("0123456789")
    bits = encoding[len(order) :]
    if order not in _ENCODINGS or bits not in ("8", "16"):
        known = ", ".join(_ENCODINGS)
        raise InputError(f"{where}: pictures '{message.encoding}' are not read; known: {known}")
    kind = np.dtype(f"{'>' if message.is_bigendian else '<'}u{int(bits) // 8}")
    channels, conversion = _ENCODINGS[order]
    width, height, step = int(message.width), int(message.height), int(message.step)
    row = width * channels * kind.itemsize  # too few bytes or a step below it: a damaged bag
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(kind).reshape(height, width, channels)
    pixels = pixels.astype(kind.newbyteorder("="))
    return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}")) if conversion else pixels


def _read_time(message: Any, received: int) -> int:
    """Reads a message's time in nanoseconds: its header's, else when it was recorded."""
    stamp = message.header.stamp
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec) or received


def _read_frames(message: Any) -> tuple[str, str]:
    """Reads the names of a message's frame and child frame; ROS 1 puts a slash before them."""
    return message.header.frame_id.lstrip("/"), getattr(message, "child_frame_id", "").lstrip("/")


def _read_pose(message: Any, where: str) -> np.ndarray:
    """Reads parent_from_child (4, 4)."""
    if hasattr(message, "transform"):
        place, turn = message.transform.translation, message.transform.rotation
    else:
        pose = getattr(message.pose, "pose", message.pose)
        place, turn = pose.position, pose.orientation
    quaternion = [turn.w, turn.x, turn.y, turn.z]
    return pose_from_quaternion(quaternion, [place.x, place.y, place.z], where)


def _make_recording(
    bag: Path, folder: Path, cameras: list[_Camera],
    parents: Mapping[str, tuple[str, np.ndarray]], child: str,
) -> Recording:  # fmt: skip
    def make_mount(camera: _Camera) -> Mount:
        where = f"{bag}, {camera.topic}"
        if camera.problem is not None:
            raise camera.problem
        if camera.lens is None:
            raise DatasetError(where, "there is no camera_info of it", "give its lens with --lens")
        place = None
        if child and camera.frame:
            (above, pose), (other, of_child) = (
                _find_root(parents, frame) for frame in (camera.frame, child)
            )
            place = invert_pose(pose) @ of_child if above == other else None
        missing = f"/tf_static has no transform to '{camera.frame}' from '{child}', of the poses"
        return Mount(camera.lens, f"{where}: {missing}", place)

    known = {camera.name: camera for camera in cameras}
    return Recording(
        folder, [Stream(c.name, c.images, c.times) for c in cameras],
        lambda names: {name: make_mount(known[name]) for name in names},
        poses_of=OWN if all(c.frame == child for c in cameras) else BODY if child else None,
        image_times="ns", pose_times="s",
    )  # fmt: skip


LAYOUTS = (Layout("rosbag", "a ROS bag", rank=5, holds=is_bag, unpack=unpack),)
