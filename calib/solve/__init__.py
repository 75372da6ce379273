"""Solves for lenses and poses: by OpenCV or mrcal, one camera or a rig."""

from calib.solve import mrcal_solver, opencv_solver
from calib.solve.mrcal_process import INSTALL, ask, has_mrcal, require_mrcal
from calib.solve.mrcal_rig import solve_rig_together
from calib.solve.pose_fit import compute_residuals, fit_poses
from calib.solve.rig import solve_rig, unify_turns
from calib.solve.splined_fit import fit_splined

__all__ = [
    "INSTALL",
    "ask",
    "compute_residuals",
    "fit_poses",
    "fit_splined",
    "has_mrcal",
    "mrcal_solver",
    "opencv_solver",
    "require_mrcal",
    "solve_rig",
    "solve_rig_together",
    "unify_turns",
]
