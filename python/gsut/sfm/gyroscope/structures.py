"""Corrects a structure that the recorded turns contradict: places taken for one, wrong poses."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import SolveError
from gsut.gaussians import measure_rotation_angles
from gsut.sfm.gyroscope.calibration import WRONG, TurnCalibration
from gsut.sfm.gyroscope.evidence import (
    calibrate_best,
    hold_near_record,
    keep_images,
    list_pairs,
    list_times,
)
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import LARGEST_OFFSET
from gsut.sfm.solution import Adjustment, Solution, compare_solutions, solve_poses


def correct_by_turns(mapping: Mapping) -> Mapping:
    """Corrects the structure by the recorded turns, where a record fits most of the poses.

    Poses that are left out, or wrong, are found again near the record by later stages.

    Returns:
        The run with pairs, solution and turns, as far as the record contradicts them.
    """
    turns = calibrate_best(mapping)
    if turns is None:
        return mapping
    separated = _leave_out_contradicted(mapping, turns)
    if separated is not mapping:
        turns = calibrate_best(separated)
    if turns is None or (turns.used.all() and separated.solved.registered.all()):
        return separated
    held = hold_near_record(separated, turns)
    return separated if held is None else held[0]


def _leave_out_contradicted(mapping: Mapping, turns: TurnCalibration) -> Mapping:
    """Maps again without pairs of images that turn otherwise than the camera did.

    They took places that look alike for one. The structure is kept if it explains the other matches
    and the turns better; see `gsut.judge.prefer`.
    """
    before, times = mapping.pairs, list_times(mapping)
    apart = times[[(pair.first, pair.second) for pair in before]]
    rotations = np.array([pair.second_from_first[:3, :3] for pair in before])
    off = measure_rotation_angles(rotations @ turns.find_turns(apart).transpose(0, 2, 1))
    wrong = off > np.maximum(WRONG * turns.estimate_sigmas(apart), LARGEST_OFFSET)
    if not wrong.any():
        return mapping
    kept = [pair for pair, is_wrong in zip(before, wrong, strict=True) if not is_wrong]
    try:
        rival = solve_poses(
            dataclasses.replace(mapping.images, cameras=mapping.solved.cameras), kept,
            mapping.options, mapping.log.follow_steps("mapping"),
            Adjustment(mapping.lens_free, lens_settled=mapping.lens_free is not None),
        )  # fmt: skip
    except SolveError:
        return mapping
    # Contradicted pairs show that places look alike, and say nothing of where these are; places
    # that nothing else joins to the others are no worse explained by models of their own.
    others = keep_images(mapping.solved, rival.registered)
    evidence = [_weigh_turns(mapping, each, turns) for each in (mapping.solved, rival)]
    better = compare_solutions(
        others, rival, mapping.features, kept, prior=evidence[1] - evidence[0]
    )
    if not better.is_rival:
        return mapping
    mapping.log.note(
        f"{int(wrong.sum())} of {len(before)} pairs of images were left out: the camera's record "
        "of its turns contradicts them, so they took places that look alike for one"
    )
    return mapping.replace(solution=rival, pairs=kept)


def _weigh_turns(mapping: Mapping, solution: Solution, turns: TurnCalibration) -> float:
    """Measures the log-likelihood of how images turn that follow each other in a structure."""
    pairs, times = list_pairs(mapping, solution)
    first, second = solution.camera_from_world[pairs.T, :3, :3]
    recorded = turns.find_turns(times)
    off = measure_rotation_angles(second @ first.transpose(0, 2, 1) @ recorded.transpose(0, 2, 1))
    return -0.5 * float(np.nansum((off / turns.estimate_sigmas(times)) ** 2))
