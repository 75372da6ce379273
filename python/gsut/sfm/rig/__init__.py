"""Rigs: photographs taken by several cameras on one body."""

from gsut.sfm.rig.description import COVARIANCE_OF
from gsut.sfm.rig.fit import RIG, adjust_rig_near_places, solve_rig, write_rig_fit
from gsut.sfm.rig.images import find_rig_photographs, require_features
from gsut.sfm.rig.motion import find_image_lines
from gsut.sfm.rig.pair import find_lens_pair
from gsut.sfm.rig.shutter import find_rig_shutter
