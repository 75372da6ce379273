"""Rigs: photographs taken by several cameras on one body."""

from gsut.sfm.rig.fit import COVARIANCE_OF, RigFit, refuse_beside_rig, solve_rig
from gsut.sfm.rig.images import find_rig_photographs
from gsut.sfm.rig.lens_pair import find_lens_pair, scaled_rig, write_lens_pair

__all__ = [
    "COVARIANCE_OF",
    "RigFit",
    "find_lens_pair",
    "find_rig_photographs",
    "refuse_beside_rig",
    "scaled_rig",
    "solve_rig",
    "write_lens_pair",
]
