"""Rigs: photographs taken by several cameras on one body."""

from gsut.sfm.rig.description import COVARIANCE_OF
from gsut.sfm.rig.fit import RIG, solve_rig, write_rig_fit
from gsut.sfm.rig.images import find_rig_photographs
from gsut.sfm.rig.pair import find_lens_pair

__all__ = [
    "COVARIANCE_OF",
    "RIG",
    "find_lens_pair",
    "find_rig_photographs",
    "solve_rig",
    "write_rig_fit",
]
