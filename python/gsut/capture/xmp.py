"""Reads how a drone held its camera from a photograph's XMP."""

from __future__ import annotations

import math
import re

# Bytes of XMP that are searched: cameras write a few thousand.
_MOST_BYTES = 1 << 20
# Largest turns in degrees that a gimbal can mean.
_MOST_TURNS = {"Yaw": 360.0, "Pitch": 120.0, "Roll": 180.0}


def read_gimbal_angles(xmp: bytes | str | None) -> dict[str, float]:
    """Reads the angles of a gimbal in degrees.

    Args:
        xmp: the packet, whose attributes or elements drones name GimbalYawDegree and such.

    Returns:
        "yaw" clockwise from north, "pitch" up from the horizon and "roll" clockwise as the camera
        sees it; each only where it is stated and possible.
    """
    text = xmp.decode("utf-8", "replace") if isinstance(xmp, bytes) else xmp or ""
    found = {}
    for name, most in _MOST_TURNS.items():
        match = re.search(
            rf":Gimbal{name}Degree(?:\s*=\s*[\"']|>)\s*([+-]?\d{{1,4}}(?:\.\d{{1,9}})?)\s*[\"'<]",
            text[:_MOST_BYTES],
        )
        if match and abs(float(match[1])) <= most:
            found[name.lower()] = float(match[1])
    return found


def find_up(angles: dict[str, float]) -> tuple[float, float, float] | None:
    """Returns up in the camera's axes (x right, y down, z forward); None if it is not known."""
    if "pitch" not in angles:
        return None
    pitch, roll = math.radians(angles["pitch"]), math.radians(angles.get("roll", 0.0))
    level = math.cos(pitch)
    return -math.sin(roll) * level, -math.cos(roll) * level, math.sin(pitch)
