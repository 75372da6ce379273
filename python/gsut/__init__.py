"""gsut: 3D Gaussian splatting for photographs from any real lens, without a GPU.

By task: `load_dataset`, `load_camera`, `doctor` read; `find_poses`, `refine_pose`,
`localize_image` find poses; `train` trains, and `render`, `photometric_loss`, `render_backward` and
`GaussianOptimizer` make a training loop of your own; `render`, `project`, `orbit_path`,
`write_video` draw; `evaluate`, `psnr`, `ssim` judge; `compact` reduces; `save_gaussians`
and `save_camera` write. docs/api.md lists all of it.
"""

from typing import TYPE_CHECKING

from gsut import _starting  # noqa: F401  before all that takes time
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

# Imported when they are asked for: see gsut._on_demand.
if TYPE_CHECKING:
    from gsut.blocks import BlocksResult, train_blocks
    from gsut.capture import Capture, capture
    from gsut.check import Finding, doctor
    from gsut.compact import Compaction, SeenView, Support, compact, find_support, seen_views
    from gsut.data import (
        DatasetError,
        Scene,
        View,
        convert_dataset,
        load_dataset,
        make_scene,
        save_dataset,
    )
    from gsut.data.points import color_points
    from gsut.evaluate import evaluate
    from gsut.formats import load_gaussians, load_ply, save_gaussians, save_ply
    from gsut.gaussians import (
        Gaussians,
        apply_low_pass,
        apply_low_pass_backward,
        find_filter_radii,
        find_ground,
        is_inside_box,
        is_inside_sphere,
        merge_gaussians,
        rotate_upright,
        seed_from_points,
        seed_in_view,
        transform_gaussians,
    )
    from gsut.lens import (
        Camera,
        Conversion,
        LensProfile,
        SplineGrid,
        camera_models,
        convert_camera,
        find_lenses,
        fit_camera,
        load_camera,
        save_camera,
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
        z_of_distance,
    )
    from gsut.run import BlockOptions, SceneOptions, TrainOptions, Verdict
    from gsut.scene import SceneResult, scene
    from gsut.sfm import (
        DatasetCalibration,
        PoseErrors,
        PosesOptions,
        PosesResult,
        TriangulatedPoints,
        calibrate_from_dataset,
        compare_poses,
        find_poses,
        triangulate,
    )
    from gsut.surface import (
        DepthMap,
        Grid,
        Mesh,
        MeshOptions,
        depth_maps,
        depth_points,
        extract_grid,
        extract_mesh,
        fuse_depth,
        grid_of_depth,
        load_mesh,
        save_grid,
        save_mesh,
    )
    from gsut.train import TrainResult, train
    from gsut.training import TrainedRun, load_run

# By task: docs/api.md is made from this list and its comments, in this order.
__all__ = [  # noqa: RUF022
    # Make a scene
    "scene",
    "SceneOptions",
    "SceneResult",
    "Verdict",
    # Load
    "load_dataset",
    "make_scene",
    "save_camera",
    "save_dataset",
    "convert_dataset",
    "Scene",
    "View",
    "doctor",
    "Finding",
    "load_camera",
    "Camera",
    "camera_models",
    "find_lenses",
    "fit_camera",
    "LensProfile",
    "convert_camera",
    "Conversion",
    "calibrate_from_dataset",
    "DatasetCalibration",
    "SplineGrid",
    # Find poses
    "capture",
    "Capture",
    "find_poses",
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
    "find_filter_radii",
    "apply_low_pass",
    "apply_low_pass_backward",
    # Render
    "render",
    "Render",
    "render_surface",
    "Surface",
    "render_surface_backward",
    "z_of_distance",
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
    # Make a mesh, a cloud, a grid
    "extract_mesh",
    "MeshOptions",
    "fuse_depth",
    "depth_maps",
    "DepthMap",
    "Mesh",
    "save_mesh",
    "load_mesh",
    "depth_points",
    "extract_grid",
    "grid_of_depth",
    "Grid",
    "save_grid",
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
    # Edit
    "merge_gaussians",
    "is_inside_box",
    "is_inside_sphere",
    "find_support",
    "Support",
    "find_ground",
    "rotate_upright",
    "transform_gaussians",
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

from gsut import _on_demand

_on_demand.import_names(__name__, __file__)
