"""Solves for lenses and poses: by OpenCV or mrcal, one camera or a rig."""

from calib.solve.mrcal_process import ask, has_mrcal, require_mrcal
from calib.solve.mrcal_rig import solve_rig_together
from calib.solve.mrcal_solver import COARSE_KNOTS_DEGREES, MRCAL_LENSES, solve_by_mrcal
from calib.solve.opencv_solver import OPENCV_LENSES, solve_by_opencv
from calib.solve.pose_fit import compute_residuals, fit_poses
from calib.solve.rig import solve_rig, unify_turns
from calib.solve.splined_fit import fit_splined
