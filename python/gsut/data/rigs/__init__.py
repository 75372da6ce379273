"""Cameras that are fixed to each other: rig files, and each camera's place on a body."""

from gsut.data.rigs.mounts import (
    BODY,
    OWN,
    Mount,
    find_body_from_camera,
    is_rig_file,
    parse_matrix,
    read_mounts,
)
from gsut.data.rigs.rig import LineReading, Rig, measure_changes, read_rig, write_rig
