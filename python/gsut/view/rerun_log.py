"""Logs a run to rerun: Gaussians, cameras with their lens as rays, photographs beside renders."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import Scene
from gsut.data.poses import invert_pose
from gsut.gaussians import SH_C0, Gaussians
from gsut.render import render, to_uint8
from gsut.run import RunFolder
from gsut.view.stage import Stage, open_stage

_HIGHER = 15  # harmonics above degree 0 that rerun stores for each Gaussian
_RAYS = (12, 9)  # rays that are drawn of a camera, across and down
# Length of these rays, x the extent of the scene.
_RAY_LENGTH = 0.08
_INSTALL = "rerun is not installed: pip install rerun-sdk"


def to_rerun(
    run: str | os.PathLike[str],
    file: str | os.PathLike[str] | None = None,
    *,
    views: Iterable[int] | None = None,
) -> None:
    """Logs a finished run to rerun, in the dataset's coordinates.

    Gaussians, points, and the training's curve are logged once; on the time line "view" each view
    has its pose, its lens as rays (rerun draws pinholes only), its photograph, and the render
    through the same lens in the photograph's light.

    Args:
        run: RUN of `gsut train` or `gsut.train(..., out=RUN)`.
        file: an .rrd file to write; None: the recording that the program has opened with
            `rerun.init`.
        views: indices of the scene's views; None: those held out, or all if none is.

    Raises:
        InputError: rerun is not installed, or `run` is no finished run.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError(_INSTALL) from error
    stage = open_stage(run)
    scene = stage.scene
    if stage.kind != "run" or scene is None:
        raise InputError(f"{run}: is no finished run; give the folder that `gsut train` wrote")
    recording = None
    if file is not None:
        recording = rr.RecordingStream("gsut")
        recording.save(os.fspath(file))
    _log_scene(rr, recording, stage, scene)
    chosen = scene.test_indices or range(len(scene)) if views is None else views
    length = _RAY_LENGTH * stage.place()["extent"]
    for index in chosen:
        _log_view(rr, recording, stage, scene, index, length)
    for row in RunFolder.open(run).read_history():
        if "psnr" in row:
            rr.set_time("step", sequence=row["step"], recording=recording)
            rr.log("training/psnr", rr.Scalars(row["psnr"]), recording=recording)
    if recording is not None:
        recording.flush()


def describe_splats(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Returns Gaussians as rerun stores them.

    Returns:
        dict of float32: centers (N, 3), scales (N, 3), linear, quaternions (N, 4) x, y, z, w,
        sh_coefficients (N, 15, 3), 0 above the scene's degree; and of uint8: colors (N, 4), red,
        green, blue and opacity.
    """
    quats = gaussians.quats / np.linalg.norm(gaussians.quats, axis=1, keepdims=True)
    higher = np.zeros((len(gaussians), _HIGHER, 3), np.float32)
    higher[:, : gaussians.sh.shape[1] - 1] = gaussians.sh[:, 1:]
    opacity = 1 / (1 + np.exp(-gaussians.opacity_logits))
    shown = np.column_stack([0.5 + SH_C0 * gaussians.sh[:, 0], opacity])
    return {
        "centers": (gaussians.means + gaussians.origin).astype(np.float32),
        "scales": np.exp(gaussians.log_scales).astype(np.float32),
        "quaternions": np.roll(quats, -1, axis=1).astype(np.float32),
        "colors": to_uint8(shown),
        "sh_coefficients": higher,
    }


def _log_scene(rr: Any, recording: Any, stage: Stage, scene: Scene) -> None:
    """Logs what does not change from view to view, and which way is up."""
    up = stage.place()["up"]
    axis = int(np.argmax(np.abs(up)))
    name = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"
    rr.log("world", getattr(rr.ViewCoordinates, name), static=True, recording=recording)
    splats = rr.GaussianSplats3D(**describe_splats(stage.gaussians))
    rr.log("world/gaussians", splats, static=True, recording=recording)
    if len(scene.points):
        points = rr.Points3D(scene.points, colors=scene.point_colors)
        rr.log("world/points", points, static=True, recording=recording)


def _log_view(
    rr: Any, recording: Any, stage: Stage, scene: Scene, index: int, length: float
) -> None:
    """Logs pose, rays of this length, photograph and render of one view."""
    view, camera = scene.views[index], scene.camera(index)
    rr.set_time("view", sequence=index, recording=recording)
    world_from_camera = invert_pose(view.camera_from_world)
    pose = rr.Transform3D(translation=world_from_camera[:3, 3], mat3x3=world_from_camera[:3, :3])
    rr.log("world/camera", pose, recording=recording)
    rays, valid = camera.rays()
    columns, rows = (
        np.linspace(0, size - 1, count).astype(int)
        for size, count in zip((camera.width, camera.height), _RAYS, strict=True)
    )
    chosen = rays[np.ix_(rows, columns)][valid[np.ix_(rows, columns)]]
    strips = np.stack([np.zeros_like(chosen), length * chosen], axis=1)
    rr.log("world/camera/rays", rr.LineStrips3D(strips), recording=recording)
    image = render(stage.gaussians, camera, view.motion, background=stage.background).image
    if stage.light is not None:
        image = image * stage.light.on(camera, index, view.camera_index)
    rr.log("photograph", rr.Image(scene.image(index)), recording=recording)
    rr.log("render", rr.Image(to_uint8(image)), recording=recording)
