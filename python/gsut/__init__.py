"""gsut: 3D Gaussian splatting for photographs from any real lens, without a GPU.

By task: `load_dataset`, `load_camera`, `diagnose` read; `estimate_poses`, `refine_pose`,
`localize_image` find poses; `train` trains, and `render`, `photometric_loss`, `render_backward` and
`GaussianOptimizer` make a training loop of your own; `render`, `project`, `orbit_path`,
`write_video` draw; `evaluate`, `psnr`, `ssim` judge; `compact` reduces; `save_gaussians`
and `Camera.save` write. docs/api.md lists all of it.
"""

from gsut._core import (
    BlendRule,
    CalibrationError,
    CameraMotion,
    InputError,
    PhotometricTarget,
    Shutter,
    SolveError,
    __version__,
    active_isa,
    available_isas,
    exp_pose,
    num_threads,
    photometric_loss,
    set_isa,
    set_num_threads,
)
from gsut.blocks import BlocksResult, train_blocks
from gsut.check import diagnose
from gsut.compact import Compaction, SeenView, compact, seen_views
from gsut.data import (
    DatasetError,
    Finding,
    Scene,
    View,
    color_points,
    convert_dataset,
    load_dataset,
    make_scene,
    save_dataset,
)
from gsut.evaluate import evaluate
from gsut.formats import load_gaussians, load_ply, save_gaussians, save_ply
from gsut.gaussians import (
    Gaussians,
    filter_radii,
    low_pass,
    low_pass_backward,
    seed_from_points,
    seed_in_view,
)
from gsut.lens import (
    Camera,
    Conversion,
    LensProfile,
    SplineGrid,
    camera_models,
    convert_camera,
    find_lenses,
    load_camera,
)
from gsut.optimize import (
    GaussianOptimizer,
    LearningRates,
    densify_adaptive,
    densify_mcmc,
    learning_rates,
)
from gsut.refine import Localized, RefinedPose, localize, localize_image, refine_pose
from gsut.render import METHODS as PROJECTION_METHODS
from gsut.render import (
    Gradients,
    Projection,
    Render,
    Surface,
    auto_path,
    color_corrected_psnr,
    orbit_path,
    project,
    psnr,
    render,
    render_backward,
    render_surface,
    render_surface_backward,
    ring_psnr,
    smooth_path,
    ssim,
    to_uint8,
    weighted_psnr,
    write_png,
    write_video,
)
from gsut.run import BlockOptions, TrainOptions
from gsut.sfm import (
    PoseErrors,
    PosesOptions,
    PosesResult,
    TriangulatedPoints,
    compare_poses,
    estimate_poses,
    triangulate,
)
from gsut.surface import (
    DepthMap,
    Mesh,
    MeshOptions,
    extract_mesh,
    fuse_depth,
    load_mesh,
    save_mesh,
)
from gsut.train import TrainResult, train
from gsut.training import TrainedRun, load_run

# By task: docs/api.md is made from this list and its comments, in this order.
__all__ = [  # noqa: RUF022
    # Load
    "load_dataset",
    "make_scene",
    "save_dataset",
    "convert_dataset",
    "Scene",
    "View",
    "diagnose",
    "Finding",
    "load_camera",
    "Camera",
    "camera_models",
    "find_lenses",
    "LensProfile",
    "convert_camera",
    "Conversion",
    "SplineGrid",
    # Find poses
    "estimate_poses",
    "PosesOptions",
    "PosesResult",
    "compare_poses",
    "PoseErrors",
    "refine_pose",
    "RefinedPose",
    "localize",
    "localize_image",
    "Localized",
    "triangulate",
    "TriangulatedPoints",
    "color_points",
    # Train
    "train",
    "TrainOptions",
    "TrainResult",
    "train_blocks",
    "BlockOptions",
    "BlocksResult",
    "load_run",
    "TrainedRun",
    # Write a training loop
    "Gaussians",
    "seed_from_points",
    "seed_in_view",
    "PhotometricTarget",
    "photometric_loss",
    "render_backward",
    "Gradients",
    "GaussianOptimizer",
    "densify_mcmc",
    "densify_adaptive",
    "learning_rates",
    "LearningRates",
    "filter_radii",
    "low_pass",
    "low_pass_backward",
    # Render
    "render",
    "Render",
    "render_surface",
    "Surface",
    "render_surface_backward",
    "Shutter",
    "CameraMotion",
    "exp_pose",
    "BlendRule",
    "project",
    "Projection",
    "PROJECTION_METHODS",
    "auto_path",
    "orbit_path",
    "smooth_path",
    "to_uint8",
    "write_png",
    "write_video",
    # Make a mesh
    "extract_mesh",
    "MeshOptions",
    "fuse_depth",
    "DepthMap",
    "Mesh",
    "save_mesh",
    "load_mesh",
    # Judge
    "evaluate",
    "psnr",
    "ssim",
    "ring_psnr",
    "weighted_psnr",
    "color_corrected_psnr",
    # Compact
    "compact",
    "Compaction",
    "seen_views",
    "SeenView",
    # Save
    "save_gaussians",
    "load_gaussians",
    "save_ply",
    "load_ply",
    # Machine
    "num_threads",
    "set_num_threads",
    "active_isa",
    "available_isas",
    "set_isa",
    "__version__",
    # Errors
    "InputError",
    "DatasetError",
    "CalibrationError",
    "SolveError",
]
