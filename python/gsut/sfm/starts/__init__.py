"""Other starts of the structure, images that it left out, and what halves of the points say."""

from gsut.sfm.starts.halves import compare_halves, measure_halves
from gsut.sfm.starts.leaving_out import leave_out_contradicted, leave_out_look_alikes
from gsut.sfm.starts.left_out import register_left_out
from gsut.sfm.starts.second_start import try_other_starts
