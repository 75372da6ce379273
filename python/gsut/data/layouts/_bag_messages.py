"""ROS messages as values: pictures and poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.poses import NANOSECONDS, pose_from_quaternion
from gsut.files import write_file

_SUFFIXES = {b"\xff\xd8": ".jpg", b"\x89P": ".png"}  # of compressed pictures, by their first bytes
# Bayer patterns by the colours of the first two pixels of the first row: OpenCV names the second
# row's second and third pixel.
_BAYER = {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUYV", "yuyv": "YUYV"}
_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}


def stamp_message(message: Any, received: int) -> int:
    """Returns a message's time in nanoseconds: its header's, else when it was recorded."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return received
    time = int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)
    return time or received


def write_picture(message: Any, path: Path, where: str) -> Path:
    """Writes a picture without a loss: a compressed one as it is, a raw one as PNG.

    Args:
        message: sensor_msgs Image or CompressedImage.
        path: without a suffix.
        where: topic, for messages.

    Returns:
        The file.

    Raises:
        InputError: an encoding that is not known, or too few bytes.
    """
    import cv2

    if not hasattr(message, "encoding"):
        data = np.asarray(message.data, np.uint8).tobytes()
        suffix = _SUFFIXES.get(data[:2])
        if suffix is None:
            raise InputError(
                f"{where}: a compressed picture of format '{message.format}' is neither JPEG nor "
                "PNG; republish the topic as raw or JPEG"
            )
        file = path.with_name(path.name + suffix)
        write_file(file, data)
        return file
    file = path.with_name(path.name + ".png")
    write_file(file, cv2.imencode(".png", _decode_pixels(message, where))[1].tobytes())
    return file


def _decode_pixels(message: Any, where: str) -> np.ndarray:
    """Decodes a raw picture to grey, or to blue, green, red; 8 or 16 bits."""
    import cv2

    name = str(message.encoding).lower()
    width, height, step = int(message.width), int(message.height), int(message.step)
    deep = name.endswith("16") or name.startswith("16u")
    kind = np.dtype(np.uint16 if deep else np.uint8).newbyteorder(
        ">" if message.is_bigendian else "<"
    )
    data = np.asarray(message.data, np.uint8).tobytes()
    base = name.rstrip("0123456789")
    pattern = next((code for key, code in _BAYER.items() if f"bayer_{key}" in name), None)
    yuv = _YUV.get(name)
    channels = 2 if yuv else 1 if pattern else _CHANNELS.get(base)
    channels = {"8uc": 1, "16uc": 1}.get(base, channels) if name[-1:] == "1" else channels
    channels = 3 if name == "8uc3" else channels
    if channels is None:
        known = "mono8, mono16, rgb8, bgr8, rgba8, bgra8, bayer_*, yuv422, yuv422_yuy2"
        raise InputError(f"{where}: pictures of encoding '{name}' are not read; known: {known}")
    row = width * channels * kind.itemsize
    if step < row or len(data) < step * height:
        raise InputError(
            f"{where}: a picture of {width} x {height} '{name}' has {len(data)} bytes and a step "
            f"of {step}; the bag may be damaged"
        )
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(kind).reshape(height, width, channels)
    pixels = pixels.astype(kind.newbyteorder("="))
    if pattern is not None:
        return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_Bayer{pattern}2BGR"))
    if yuv is not None:
        return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_YUV2BGR_{yuv}"))
    if channels == 1:
        return pixels[:, :, 0]
    pixels = pixels[:, :, :3]
    return pixels[:, :, ::-1] if base.startswith("rgb") else pixels


def read_pose(message: Any, where: str) -> np.ndarray | None:
    """Reads the pose (4, 4) that a message holds; None if it holds none."""
    if hasattr(message, "transform"):
        place, turn = message.transform.translation, message.transform.rotation
    elif hasattr(message, "pose"):
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        place, turn = pose.position, pose.orientation
    else:
        return None
    return pose_from_quaternion(
        [turn.w, turn.x, turn.y, turn.z], [place.x, place.y, place.z], where
    )


def strip_slash(name: str) -> str:
    """Strips the slash that ROS 1 puts before a frame's name."""
    return name.lstrip("/")
