"""Writes small bags of ROS 1 and 2 with the package rosbags, from the small recording."""

from pathlib import Path

import numpy as np

import small_datasets as small
import small_recordings as made

POSES = "/odom"


def _header(make, store: str, time: int, frame: str):
    stamp = make("builtin_interfaces/msg/Time", sec=time // 10**9, nanosec=time % 10**9)
    extra = {"seq": 0} if store == "ROS1_NOETIC" else {}
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **extra)


def _pose(make, pose: np.ndarray):
    w, x, y, z = small.quaternion(pose[:3, :3])
    place = dict(zip("xyz", map(float, pose[:3, 3]), strict=True))
    return (
        make("geometry_msgs/msg/Point", **place),
        make("geometry_msgs/msg/Vector3", **place),
        make("geometry_msgs/msg/Quaternion", w=float(w), x=float(x), y=float(y), z=float(z)),
    )


def write_bag(path: Path, store: str, *, compressed: bool = False, static: bool = True,
              odometry: tuple[str, ...] = (POSES,), calibrated: bool = True,
              camera: str = "/cam0", zooms: bool = False) -> Path:  # fmt: skip
    """One camera on a body at /cam0, its camera_info, and odometry of the body.

    Args:
        path: BAG.bag for ROS 1, a new folder for ROS 2.
        store: name of the message definitions, "ROS1_NOETIC" or "ROS2_HUMBLE".
        compressed: pictures as PNG in CompressedImage.
        static: with /tf_static, which places the camera on the body.
        odometry: topics of it.
        calibrated: camera_info has a lens.
        camera: topic above those of the pictures and camera_info.
        zooms: the focal length of the last camera_info is another.
    """
    import cv2
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores[store])
    if "tf2_msgs/msg/TFMessage" not in types.types:
        text = "geometry_msgs/TransformStamped[] transforms"
        types.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    one = store == "ROS1_NOETIC"

    def make(name: str, **values):
        return types.types[name](**values)

    def header(time, frame):
        return _header(make, store, time, frame)

    def transform(time, parent, child, pose):
        _, place, turn = _pose(make, pose)
        value = make("geometry_msgs/msg/Transform", translation=place, rotation=turn)
        return make("geometry_msgs/msg/TransformStamped", header=header(time, parent),
                    child_frame_id=child, transform=value)  # fmt: skip

    with Writer1(path) if one else Writer2(path, version=8) as writer:
        connections = {}

        def write(topic, message, time):
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=types)
            raw = types.serialize_ros1(message, name) if one else types.serialize_cdr(message, name)
            writer.write(connections[topic], time + 7, raw)  # recorded a little later

        k = np.array([made.LENS[0], 0, made.LENS[2], 0, made.LENS[1], made.LENS[3], 0, 0, 1.0])
        k = k if calibrated else np.zeros(9)
        letters = "DKRP" if one else "dkrp"
        lens = dict(zip(letters, (np.zeros(5), k, np.eye(3).ravel(), np.zeros(12)), strict=True))
        roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
                   do_rectify=False)  # fmt: skip
        if static:
            message = make("tf2_msgs/msg/TFMessage", transforms=[
                transform(made.START, "base", "cam0_optical", made.body_from_cameras()[0])
            ])  # fmt: skip
            write("/tf_static", message, made.START - 1000)
        for time in made.times():
            pixels = small.render(made.world_from_camera(0, time))
            if compressed:
                data = cv2.imencode(".png", pixels[..., ::-1])[1]
                picture = make("sensor_msgs/msg/CompressedImage", format="png", data=data,
                               header=header(time, "cam0_optical"))  # fmt: skip
                write(f"{camera}/image_raw/compressed", picture, time)
            else:
                picture = make("sensor_msgs/msg/Image", header=header(time, "cam0_optical"),
                               height=small.HEIGHT, width=small.WIDTH, encoding="rgb8",
                               is_bigendian=0, step=3 * small.WIDTH,
                               data=pixels.ravel())  # fmt: skip
                write(f"{camera}/image_raw", picture, time)
            if zooms and time == made.times()[-1]:
                k[0] = k[4] = 2 * k[0]
            info = make("sensor_msgs/msg/CameraInfo", header=header(time, "cam0_optical"),
                        height=small.HEIGHT, width=small.WIDTH, distortion_model="plumb_bob",
                        binning_x=0, binning_y=0, roi=roi, **lens)  # fmt: skip
            write(f"{camera}/camera_info", info, time)
            body = made.world_from_body(time)
            place, speed, turn = _pose(make, body)
            pose = make("geometry_msgs/msg/Pose", position=place, orientation=turn)
            twist = make("geometry_msgs/msg/Twist", linear=speed, angular=speed)
            for topic in odometry:
                message = make(
                    "nav_msgs/msg/Odometry", header=header(time, "map"), child_frame_id="base",
                    pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose,
                              covariance=np.zeros(36)),
                    twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist,
                               covariance=np.zeros(36)),
                )  # fmt: skip
                write(topic, message, time)
    return path
