"""Refines poses, and optionally the lens, of training views by bundle adjustment of tracks.

`--refine-poses` begins with it: tracks of features tie distant views together, while colours do so
slowly and only once a scene is sharp. The new poses are moved by the similarity that fits the given
ones best, so that the scene's points keep their places. Given poses that are as good are kept.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.data import Scene
from gsut.data.poses import move_poses, split_similarity
from gsut.lens import Camera, find_focal_params, find_refinable_params, has_focal_length
from gsut.refine.motion import measure_pose_changes, turn_onto
from gsut.run import TrainOptions
from gsut.sfm import PosesOptions, compare_poses
from gsut.sfm.matches import match_images, verify_matches
from gsut.sfm.photographs import Images, Photographs, collect_features
from gsut.sfm.solution import Adjustment, Solution, adjust_poses

# Factor on the largest error of a match before the lens is refined, which moves all matches.
_LOOSER = 4.0
# Training views below which there is nothing to adjust: two poses have no redundancy.
_FEWEST_VIEWS = 3
# Called with (stage, parts done, parts in all).
OnProgress = Callable[[str, int, int], None]


@dataclasses.dataclass(frozen=True)
class TracksResult:
    """The scene after adjustment, with its figures.

    Attributes:
        scene: with the refined poses, and lens, of the training views.
        figures: for metrics.json; sigma_degrees and sigma_moved are medians of the predicted
            standard deviations of a pose (root of the sum over three axes).
        tracked: the views whose pose comes from tracks.
        note: why nothing was refined, or what was left out; empty otherwise.
    """

    scene: Scene
    figures: dict[str, Any]
    tracked: list[int]
    note: str = ""

    def summarize(self) -> dict[str, Any]:
        """Returns figures, number of refined views, and note, for metrics.json."""
        note = {"note": self.note} if self.note else {}
        return {**self.figures, "refined": len(self.tracked), **note}


def refine_by_tracks(
    scene: Scene, options: TrainOptions, on_progress: OnProgress | None = None
) -> TracksResult:
    """Refines the poses of the training views, and with `refine_lens` their lens.

    Features are found in the image files at full size. If they do not determine the poses, the
    scene is returned unchanged, with a note: colours alone may still suffice.

    Args:
        scene: with poses that are roughly right.
        options: of the run.
        on_progress: see `OnProgress`.
    """
    show = on_progress or (lambda what, done, total: None)
    try:
        solution = _adjust_tracks(scene, options, show)
    except (InputError, SolveError) as error:
        return TracksResult(scene, {}, [], f"no poses from tracks of features: {error}")
    indices = [
        index
        for index, registered in zip(scene.train_indices, solution.registered, strict=True)
        if registered
    ]
    given = scene.poses(indices)
    found = np.array(solution.camera_from_world)[np.asarray(solution.registered, bool)]
    world = split_similarity(compare_poses(found, given).reference_from_world)
    found = turn_onto(move_poses(found, *world), given)
    changes = measure_pose_changes(found, given)
    refined = scene.with_poses(indices, found)
    before, after = scene.file_cameras[0], solution.cameras[0]
    if options.refine_lens:
        refined = refined.with_lenses([after])
    missing = len(scene.train_indices) - len(indices)
    note = f"{missing} training views see too few tracks and keep their poses" if missing else ""
    variances = np.einsum("nii->ni", np.array(solution.covariances)[solution.registered])
    figures = {
        "views": len(indices),
        "points": len(solution.points),
        "error_px": float(solution.median),
        "turned_degrees": float(np.median(changes.degrees)),
        "moved": float(np.median(changes.distances)),
        "sigma_degrees": float(np.degrees(np.median(np.sqrt(variances[:, 3:].sum(axis=1))))),
        "sigma_moved": float(np.median(np.sqrt(variances[:, :3].sum(axis=1)))),
    }
    if options.refine_lens and has_focal_length(before):
        focal = find_focal_params(before)
        figures["focal_percent"] = 100 * float(
            np.mean(after.params[focal] / before.params[focal]) - 1
        )
    if not options.refine_lens and _are_as_good_as_tracks(figures):
        note = (
            f"Tracks of features differ from the given poses by {figures['turned_degrees']:.2g} "
            f"degrees and {figures['moved']:.2g} units, and err by about "
            f"{figures['sigma_degrees']:.2g} and {figures['sigma_moved']:.2g} themselves: the "
            "given poses, which are as good, were kept."
        )
        return TracksResult(scene, figures, [], note)
    return TracksResult(refined, figures, indices, note)


def _are_as_good_as_tracks(figures: dict[str, Any]) -> bool:
    """Returns whether the given poses err no more than tracks predict of their own.

    Errors of both are independent, so their squared difference is up to twice the tracks' variance.
    """
    turned = figures["turned_degrees"] / max(figures["sigma_degrees"], 1e-12)
    moved = figures["moved"] / max(figures["sigma_moved"], 1e-12)
    return bool((turned**2 + moved**2) / 2 <= 2.0)


def _adjust_tracks(scene: Scene, options: TrainOptions, show: OnProgress) -> Solution:
    """Finds features and matches of the training views and adjusts their bundle."""
    views = [scene.views[index] for index in scene.train_indices]
    if len(views) < _FEWEST_VIEWS:
        raise InputError(f"{len(views)} training views are too few")
    cameras: list[Camera] = [scene.file_cameras[view.camera_index] for view in views]
    settings = PosesOptions(threads=options.threads, seed=options.seed)
    names = [view.name for view in views]
    photographs = Photographs(
        scene.path, names, [view.image_path for view in views], [view.mask_path for view in views],
        list(cameras),
    )  # fmt: skip

    def on_progress(stage: str, done: int, total: int, text: str) -> None:
        show(stage, done, total)

    features = collect_features(photographs, settings, on_progress, lambda text: None)
    raw = match_images(names, features, settings, on_progress)
    poses = [view.camera_from_world for view in views]
    free = find_refinable_params(cameras[0]) if options.refine_lens else None
    # Through a wrong lens few matches agree: a first, loose round finds a better one.
    loose = dataclasses.replace(settings, max_error=_LOOSER * settings.max_error)
    for round_settings in [loose, settings] if options.refine_lens else [settings]:
        images = Images(names, cameras, features)
        verified = verify_matches(images, raw, round_settings)
        if not verified:
            raise InputError("no two images have matches that agree through their lens")
        solution = adjust_poses(
            images, verified, poses, settings,
            lambda done, total, *_: show("poses", int(done), int(total)),
            Adjustment(free, center_sigma=math.inf),
        )  # fmt: skip
        poses = solution.fill_poses(poses)
        cameras = list(solution.cameras)
    return solution
