"""Cameras that are fixed to each other: rig files, and each camera's place on a body."""

from gsut.data.rigs.mounts import (
    BODY,
    OWN,
    Mount,
    body_from_camera,
    is_rig_file,
    matrix_of,
    read_mounts,
)
from gsut.data.rigs.rig import Rig, read_rig, relative_changes, write_rig

__all__ = [
    "BODY",
    "OWN",
    "Mount",
    "Rig",
    "body_from_camera",
    "is_rig_file",
    "matrix_of",
    "read_mounts",
    "read_rig",
    "relative_changes",
    "write_rig",
]
