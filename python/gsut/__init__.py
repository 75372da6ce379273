"""gsut: 3D Gaussian splatting for any real lens, without a GPU."""

from gsut._core import (
    BlendRule,
    CalibrationError,
    InputError,
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
from gsut.gaussians import Gaussians
from gsut.render import Gradients, Projection, Render, project, render, render_backward

__all__ = [
    "BlendRule",
    "CalibrationError",
    "Camera",
    "Gaussians",
    "Gradients",
    "InputError",
    "Projection",
    "Render",
    "SolveError",
    "__version__",
    "active_isa",
    "available_isas",
    "camera_models",
    "exp_pose",
    "num_threads",
    "project",
    "render",
    "render_backward",
    "set_isa",
    "set_num_threads",
]
