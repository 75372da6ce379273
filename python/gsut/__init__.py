"""gsut: 3D Gaussian splatting for any real lens, without a GPU."""

from gsut._core import (
    BlendRule,
    CalibrationError,
    CameraMotion,
    InputError,
    Shutter,
    SolveError,
    __version__,
    active_isa,
    available_isas,
    exp_pose,
    num_threads,
    set_isa,
    set_num_threads,
)
from gsut.compact import compact, seen_views
from gsut.data import Scene, View, load_dataset
from gsut.evaluate import evaluate
from gsut.formats import load_ply, save_ply
from gsut.gaussians import (
    Gaussians,
    filter_radii,
    low_pass,
    low_pass_backward,
    seed_from_points,
    seed_in_view,
)
from gsut.lens import Camera, camera_models, load_camera
from gsut.refine import RefinedPose, refine_pose
from gsut.render import METHODS as PROJECTION_METHODS
from gsut.render import Gradients, Projection, Render, project, psnr, render, render_backward, ssim
from gsut.run import TrainOptions
from gsut.train import TrainResult, train

__all__ = [
    "PROJECTION_METHODS",
    "BlendRule",
    "CalibrationError",
    "Camera",
    "CameraMotion",
    "Gaussians",
    "Gradients",
    "InputError",
    "Projection",
    "RefinedPose",
    "Render",
    "Scene",
    "Shutter",
    "SolveError",
    "TrainOptions",
    "TrainResult",
    "View",
    "__version__",
    "active_isa",
    "available_isas",
    "camera_models",
    "compact",
    "evaluate",
    "exp_pose",
    "filter_radii",
    "load_camera",
    "load_dataset",
    "load_ply",
    "low_pass",
    "low_pass_backward",
    "num_threads",
    "project",
    "psnr",
    "refine_pose",
    "render",
    "render_backward",
    "save_ply",
    "seed_from_points",
    "seed_in_view",
    "seen_views",
    "set_isa",
    "set_num_threads",
    "ssim",
    "train",
]
