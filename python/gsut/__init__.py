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
from gsut.cameras import Camera, camera_models
from gsut.compact import compact
from gsut.compact_scores import seen_views
from gsut.data.lens_files import load_camera
from gsut.data.load import load_dataset
from gsut.data.scene import Scene, View
from gsut.evaluate import evaluate
from gsut.formats import load_ply, save_ply
from gsut.gaussians import Gaussians
from gsut.low_pass import filter_radii, low_pass, low_pass_backward
from gsut.metrics import psnr, ssim
from gsut.options import TrainOptions
from gsut.projection import METHODS as PROJECTION_METHODS
from gsut.projection import Projection, project
from gsut.refine import RefinedPose, refine_pose
from gsut.render import Gradients, Render, render, render_backward
from gsut.seeding import seed_from_points, seed_in_view
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
