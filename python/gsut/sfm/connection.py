"""Estimates the poses that matches connect: of SIFT, and of learned features where needed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.sfm.learned import add_learned_features
from gsut.sfm.lens import search_lenses
from gsut.sfm.mapping import Mapping, PosesLog
from gsut.sfm.matches import FEW_IMAGES, are_connected, explain_failure, require_overlap
from gsut.sfm.rig import solve_rig
from gsut.sfm.starts import (
    leave_out_contradicted,
    register_left_out,
    try_other_starts,
)


def map_connected(mapping: Mapping) -> Iterator[Mapping]:
    """Yields the structure of SIFT, then that with learned features, in case the first is poor.

    The second is the first one where it connects more images, and follows where up to FEW_IMAGES
    photographs have as many. What fails though all images are connected, as of a camera that only
    turned, more matches do not mend.

    Raises:
        SolveError: there is neither.
    """
    failure: SolveError | None = None
    trial, plain = mapping.log.copy_quietly(), mapping
    absent = np.ones(len(mapping.photographs), bool)
    try:
        plain = _map_by_best_start(mapping)
        absent = ~plain.solved.registered
    except SolveError as error:
        if are_connected(mapping.pairs, len(absent)):
            raise
        failure = error
    count, is_few = np.count_nonzero(~absent), len(absent) <= FEW_IMAGES
    wanted = absent & np.array([len(each) > 0 for each in mapping.features])  # those that were read
    joined = _map_learned(mapping, absent, wanted, trial) if wanted.any() else None
    if joined is None or joined.solved.num_registered <= count:
        if failure is not None:
            raise failure
        yield plain
    if is_few and not wanted.any():
        joined = _map_learned(mapping, absent, wanted, trial)
    if joined is not None and joined.solved.num_registered > count - is_few:
        yield joined


def _map_learned(
    mapping: Mapping, absent: np.ndarray, wanted: np.ndarray, log: PosesLog
) -> Mapping | None:
    """Estimates poses and points by learned features too; None if there are none, or that fails.

    Args:
        absent: (N,) bool, images that SIFT leaves out. wanted: those of them that could be read.
        log: receives the notes.
    """
    more = add_learned_features(mapping, wanted)
    if more is None:
        return None
    with contextlib.suppress(SolveError):
        joined = leave_out_contradicted(_map_by_best_start(more.replace(log=log)))
        found = np.flatnonzero(absent & joined.solved.registered)
        names = [mapping.photographs.names[i] for i in found]
        did = f"connected {list_some(names)}" if names else "hold the poses, SIFT's did not"
        log.note(f"learned features (XFeat) {did}")
        noise = joined.solved.learned_noise
        return joined.add_findings({"learned": names, "learned_noise": noise})
    return None


def _map_by_best_start(mapping: Mapping) -> Mapping:
    """Estimates poses and points, also from other starts, which may see images left out before."""
    mapping = register_left_out(_map_photographs(mapping))
    return register_left_out(try_other_starts(mapping))


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
        solution = mapping.solve(mapping.images, mapping.pairs)
    except SolveError as error:
        advice = "let the lens be estimated: --unknown-lens"
        raise explain_failure(error, mapping.features, mapping.pairs, advice) from None
    return mapping.replace(solution=solution)
