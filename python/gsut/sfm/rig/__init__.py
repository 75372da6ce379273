"""Rigs: photographs taken by several cameras on one body."""

from gsut.sfm.rig.fit import COVARIANCE_OF, find_lens_pair, solve_rig, write_lens_pair
from gsut.sfm.rig.images import find_rig_photographs

__all__ = [
    "COVARIANCE_OF",
    "find_lens_pair",
    "find_rig_photographs",
    "solve_rig",
    "write_lens_pair",
]
