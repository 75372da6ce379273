"""Aligns test views with a refined scene before they are judged, and says how far they moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gsut._core import SolveError
from gsut.data import Scene
from gsut.evaluate import evaluate
from gsut.gaussians import Gaussians
from gsut.refine.motion import measure_pose_changes
from gsut.refine.pose import refine_pose
from gsut.render import Light, choose_solid

NOTE = (
    "Poses were refined, so the given poses of the held-out views no longer fit the scene: each "
    "was aligned with it by its own photograph before it was judged. The figures before alignment "
    "are in metrics.json under alignment."
)


def evaluate_aligned(
    gaussians: Gaussians,
    scene: Scene,
    indices: Sequence[int],
    *,
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0),
    light: Light | None = None,
    find_movers: Callable[[Scene], Callable[[int, int, int], Any] | None] | None = None,
    render_folder: Path | None = None,
) -> tuple[Scene, dict[str, Any]]:
    """Evaluates views after refining the pose of each on its own photograph.

    Only the six numbers of a view's pose are fitted to its photograph (with a gain and a bias that
    are then discarded), as is usual if training moved the poses.

    Args:
        gaussians, scene, indices, background, light, render_folder: see `evaluate`.
        find_movers: called with the scene once its poses are aligned, since a wrong pose looks like
            movers; returns `find_moving` of `evaluate`. None: nothing moved.

    Returns:
        The scene with the aligned poses, and the evaluation with an entry `alignment`: the means
        psnr_before and psnr_after, and for each view name, psnr_before, psnr_after, turned_degrees,
        moved (scene units) and converged. A view keeps its pose if its photograph does not
        determine one.
    """
    before = evaluate(gaussians, scene, indices, background=background, light=light)
    poses, converged = [], []
    for index in indices:
        pose = scene.views[index].camera_from_world
        try:
            found = refine_pose(
                gaussians, scene.camera(index), pose, scene.image(index), scene.mask(index),
                background=choose_solid(background),
            )  # fmt: skip
            poses.append(found.camera_from_world)
            converged.append(found.converged)
        except SolveError:
            poses.append(pose)
            converged.append(False)
    aligned = scene.with_poses(indices, poses)
    evaluation = evaluate(
        gaussians,
        aligned,
        indices,
        background=background,
        light=light,
        find_moving=find_movers and find_movers(aligned),
        render_folder=render_folder,
    )
    changes = measure_pose_changes(aligned.poses(indices), scene.poses(indices))
    evaluation["alignment"] = {
        "psnr_before": before["psnr"],
        "psnr_after": evaluation["psnr"],
        "note": NOTE,
        "views": [
            {
                "name": now["name"],
                "psnr_before": then["psnr"],
                "psnr_after": now["psnr"],
                "turned_degrees": float(degrees),
                "moved": float(distance),
                "converged": bool(ok),
            }
            for now, then, degrees, distance, ok in zip(
                evaluation["views"], before["views"], changes.degrees, changes.distances, converged,
                strict=True,
            )
        ],
    }  # fmt: skip
    return aligned, evaluation
