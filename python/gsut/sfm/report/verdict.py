"""Judges how good poses are, and states what a user should know about them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from gsut.data import list_some
from gsut.judge.checks import NOT_GOOD, UNUSABLE, PosesQuality, judge_poses
from gsut.run import Verdict
from gsut.sfm.lens import describe_cameras
from gsut.sfm.mapping import Findings, Mapping
from gsut.sfm.matches import measure_pictures
from gsut.sfm.photographs import Features
from gsut.sfm.solution import Solution, measure_diagonal


def judge_solution(solution: Solution, features: Sequence[Features], found: Findings) -> Verdict:
    """Measures how good poses are, and judges that.

    Args:
        features: of all images.
        found: beside the poses.
    """
    camera = solution.cameras[0]
    alike = found.look_alikes
    return judge_poses(
        PosesQuality(
            **dataclasses.asdict(measure_pictures(features, solution.registered)),
            registered=solution.num_registered,
            points=len(solution.points),
            median_px=solution.median,
            diagonal_px=math.hypot(camera.width, camera.height),
            pose_errors_px=found.pose_errors_px or (0.0, 0.0),
            lens_sigma_px=found.lens_sigma_px,
            agreement=1.0 if found.agreement is None else found.agreement,
            contradicted=found.contradicted,
            contradicted_images=found.contradicted_images,
            focal_sigma=found.focal_sigma,
            lens_gap_px=found.lens_gap_px,
            focal_gap=found.focal_gap,
            readout_turn=solution.readout_turn,
            look_alikes="" if alike is None else alike.explain(),
        )
    )


def rate_poses(mapping: Mapping) -> int:
    """Rates poses by their probable errors, as the verdict does: 0: good, 1: usable, 2: poor."""
    errors = mapping.found.pose_errors_px or (0.0, 0.0)
    most, many = (px / measure_diagonal(mapping.solved.cameras) for px in errors)
    return int(most > NOT_GOOD) + int(many > UNUSABLE)


def list_notes(mapping: Mapping) -> list[str]:
    """Lists what a user should know of the poses, one sentence each."""
    solution, found = mapping.solved, mapping.found
    notes = describe_cameras(mapping)
    notes += found.rig.notes if found.rig is not None else []
    elsewhere = {name for model in found.models for name in model.registered_names}
    without = [name for name in solution.unregistered_names if name not in elsewhere]
    if without:
        notes.append(
            f"{len(solution.names) - len(without)} of {len(solution.names)} images were "
            f"registered; without a pose: {list_some(without)}"
        )
    return notes
