"""Estimates the poses that matches connect: of SIFT, and of learned features where needed."""

from __future__ import annotations

import contextlib

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.judge.checks import UNUSABLE
from gsut.sfm.learned import add_learned_features
from gsut.sfm.lens import search_lenses
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import FEW_IMAGES, are_connected, explain_failure, require_overlap
from gsut.sfm.rig import solve_rig
from gsut.sfm.solution import measure_diagonal, solve_poses
from gsut.sfm.starts import (
    leave_out_contradicted,
    measure_halves,
    register_left_out,
    try_other_starts,
)


def map_connected(mapping: Mapping) -> Mapping:
    """Estimates poses and points, by learned features too where those of SIFT do not suffice.

    They leave images out, or either half of them gives a few images other poses. What fails though
    all images are connected, as of a camera that only turned, more matches do not mend.
    """
    failure: SolveError | None = None
    plain, absent, notes = mapping, np.ones(len(mapping.photographs), bool), mapping.log.notes
    before = list(notes)
    try:
        plain = register_left_out(_map_photographs(mapping))
        absent = ~plain.solved.registered
    except SolveError as error:
        if are_connected(mapping.pairs, len(absent)):
            raise
        failure = error
    off = 0.0
    if failure is None and len(absent) <= FEW_IMAGES and _measure_spread(plain, 1) > UNUSABLE:
        off = _measure_spread(plain)  # one draw of the halves suffices where it is small
    is_weak = off > UNUSABLE
    wanted = absent & np.array([len(each) > 0 for each in mapping.features])  # those that were read
    more = add_learned_features(mapping, wanted) if is_weak or wanted.any() else None
    if more is not None:
        after, notes[:] = list(notes), before
        with contextlib.suppress(SolveError):
            joined = register_left_out(_map_photographs(more))
            # Of a structure that took a wrong turn right images are contradicted.
            joined = register_left_out(try_other_starts(joined))
            joined = leave_out_contradicted(joined)
            gained = joined.solved.num_registered - np.count_nonzero(~absent)
            if gained > 0 or (is_weak and gained == 0 and _measure_spread(joined) < off):
                found = np.flatnonzero(absent & joined.solved.registered)
                names = [mapping.photographs.names[i] for i in found]
                did = f"connected {list_some(names)}" if names else "hold the poses, SIFT's did not"
                joined.log.note(f"learned features (XFeat) {did}")
                noise = joined.solved.learned_noise
                return joined.add_findings({"learned": names, "learned_noise": noise})
        notes[:] = after
    if failure is not None:
        raise failure
    return plain


def _measure_spread(mapping: Mapping, *most_draws: int) -> float:
    """Measures by what share of the diagonal nine in ten pairs of images stay apart in halves."""
    halves = measure_halves(mapping, *most_draws)
    return 0.0 if halves is None else halves[0] / measure_diagonal(mapping.solved.cameras)


def _map_photographs(mapping: Mapping) -> Mapping:
    """Estimates poses and points: on a rig, through known lenses, or together with the lens."""
    if mapping.found.figures["lens"] == "estimated":
        mapping = search_lenses(mapping)
    else:
        require_overlap(mapping.images, mapping.pairs, is_lens_known=True)
    if mapping.rig is not None:
        return solve_rig(mapping)
    if mapping.solution is not None:
        return mapping
    try:
        solution = solve_poses(
            mapping.images, mapping.pairs, mapping.options,
            mapping.log.follow_steps("mapping"),
        )  # fmt: skip
    except SolveError as error:
        advice = "let the lens be estimated: --unknown-lens"
        raise explain_failure(error, mapping.features, mapping.pairs, advice) from None
    return mapping.replace(solution=solution)
