"""gsut: 3D Gaussian splatting for photographs from any real lens, without a GPU.

`scene` makes a scene from videos or photographs in one call. Its stages one by one: `load_dataset`
and `load_camera` read, `find_poses` finds where photographs were taken, `train` trains, `render`
draws, `evaluate` judges, `compact` reduces, `save_gaussians` writes. More lies in submodules by
purpose: `gsut.lens`, `gsut.poses`, `gsut.surface`, `gsut.edit`, `gsut.rendering`, `gsut.loop` (for
a training loop of your own), `gsut.metrics`, `gsut.machine`. docs/api.md lists all of it.
"""

from gsut import _starting  # noqa: I001  before all that takes time

from typing import TYPE_CHECKING

from gsut._core import (
    BlendRule,
    CalibrationError,
    CameraMotion,
    InputError,
    PhotometricTarget,
    Shutter,
    SolveError,
    __version__,
    exp_pose,
    num_threads,
    photometric_loss,
)

# Imported on first use: see gsut._on_demand.
if TYPE_CHECKING:
    from gsut.blocks import BlocksResult, train_blocks
    from gsut.capture import capture
    from gsut.check import Finding, doctor
    from gsut.compact import Compaction, compact
    from gsut.data import (
        DatasetError,
        Scene,
        View,
        convert_dataset,
        load_dataset,
        save_dataset,
        scene_from_arrays,
    )
    from gsut.evaluate import evaluate
    from gsut.formats import load_gaussians, save_gaussians
    from gsut.gaussians import Gaussians, LinearGaussians, seed_from_points
    from gsut.lens import Camera, load_camera, save_camera
    from gsut.lifting import lift
    from gsut.machine import set_num_threads
    from gsut.metrics import psnr, ssim
    from gsut.optimize import GaussianOptimizer
    from gsut.refine import localize
    from gsut.render import (
        Gradients,
        Render,
        Surface,
        project,
        render,
        render_backward,
        render_surface,
        write_png,
        write_video,
    )
    from gsut.run import BlockOptions, SceneOptions, TrainOptions, Verdict
    from gsut.scene import SceneResult
    from gsut.scene import make_scene as scene
    from gsut.sfm import PosesOptions, PosesResult, find_poses
    from gsut.surface import Mesh, extract_mesh, load_mesh, save_mesh
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
    "scene_from_arrays",
    "save_dataset",
    "convert_dataset",
    "Scene",
    "View",
    "doctor",
    "Finding",
    "load_camera",
    "save_camera",
    "Camera",
    # Find poses
    "capture",
    "find_poses",
    "PosesOptions",
    "PosesResult",
    "localize",
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
    "LinearGaussians",
    "seed_from_points",
    "PhotometricTarget",
    "photometric_loss",
    "render_backward",
    "Gradients",
    "GaussianOptimizer",
    # Render
    "render",
    "Render",
    "render_surface",
    "Surface",
    "Shutter",
    "CameraMotion",
    "exp_pose",
    "BlendRule",
    "project",
    "write_png",
    "write_video",
    "lift",
    # Make a mesh
    "extract_mesh",
    "Mesh",
    "save_mesh",
    "load_mesh",
    # Judge
    "evaluate",
    "psnr",
    "ssim",
    # Compact
    "compact",
    "Compaction",
    # Save
    "save_gaussians",
    "load_gaussians",
    # Machine
    "num_threads",
    "set_num_threads",
    "__version__",
    # Errors
    "InputError",
    "DatasetError",
    "CalibrationError",
    "SolveError",
]

from gsut import _on_demand

_on_demand.import_names(__name__, __file__)
