"""Chooses the lens for `--lens auto`: solves with all, drops impossible ones, compares the rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.boards import Board, Photograph
from calib.camera import CameraSolution
from calib.errors import SolveError
from calib.job import Job
from calib.solve import (
    COARSE_KNOTS_DEGREES,
    MRCAL_LENSES,
    OPENCV_LENSES,
    has_mrcal,
    require_mrcal,
    solve_by_mrcal,
    solve_by_opencv,
)
from calib.trust.cross_validation import HeldOut, compare, hold_out
from calib.trust.trust import HOPELESS, judge

_COVERED = 0.8  # share of the angle that boards reached, up to which a candidate must be usable


def solve_camera(
    job: Job, photographs: Sequence[Photograph], board: Board, lens: str
) -> CameraSolution:
    """Solves for one camera with one lens, by the job's solver."""
    if job.choose_solver(lens) == "opencv":
        return solve_by_opencv(photographs, board, lens)
    knots = COARSE_KNOTS_DEGREES if job.lens == "auto" else None  # of a splined lens
    return solve_by_mrcal(photographs, board, lens, knots)


def choose_lens(
    job: Job,
    seen: Sequence[Sequence[Photograph]],
    board: Board,
    held_out: dict[str, list[HeldOut]],
) -> tuple[str, list[str]]:
    """Chooses one lens for all cameras of the rig: the boards of all cameras decide together.

    Args:
        job: what to do. seen: photographs with corners, of each camera. board: the chessboard.
        held_out: receives the results of each camera, by its name.

    Returns:
        The lens, and notes that explain the choice.

    Raises:
        SolveError: no lens fits.
    """
    lenses, notes = _list_candidates(job)
    outliers: list[list[np.ndarray]] = []
    for group in seen:
        name = group[0].camera
        held_out[name], dropped = _try_lenses(job, lenses, group, board)
        outliers.append(dropped)
        notes += [f"{name}: {r.lens} was dropped: {r.problem}" for r in held_out[name] if r.problem]
    together = []
    for index, lens in enumerate(lenses):
        each = [held_out[group[0].camera][index] for group in seen]
        problem = next((result.problem for result in each if result.problem), "")
        errors = np.empty((0, 0)) if problem else np.concatenate([r.errors for r in each])
        parameters = max(result.parameters for result in each)
        together.append(HeldOut(lens, errors, parameters, problem))
    scored = [index for index, result in enumerate(together) if not result.problem]
    reason = compare(
        together, [np.concatenate([dropped[index] for dropped in outliers]) for index in scored]
    )
    chosen = next(result.lens for result in together if result.chosen)
    for group, dropped in zip(seen, outliers, strict=True):
        results = held_out[group[0].camera]
        compare(
            [results[index] for index in scored], [dropped[index] for index in scored]
        )  # for the figures of this camera alone
        for result in results:
            result.chosen = result.lens == chosen
    return chosen, [reason, *notes]


def _list_candidates(job: Job) -> tuple[list[str], list[str]]:
    lenses = ["fisheye", "opencv4", "opencv8", "splined"]
    notes = []
    if job.solver == "mrcal":
        require_mrcal()
        lenses = list(MRCAL_LENSES)
    elif job.solver == "opencv":
        lenses = list(OPENCV_LENSES)
    elif not has_mrcal():
        lenses = list(OPENCV_LENSES)
        notes.append("mrcal is not installed: only OpenCV's lenses were tried")
    if job.out.suffix.lower() != ".cameramodel" and "splined" in lenses:
        lenses.remove("splined")
        notes.append(f"splined was not considered: {job.out.suffix} files cannot hold it")
    return lenses, notes


def _try_lenses(
    job: Job, lenses: Sequence[str], group: Sequence[Photograph], board: Board
) -> tuple[list[HeldOut], list[np.ndarray]]:
    """Scores each lens that may be right on unseen boards; adds each full solve's outliers."""
    full: dict[str, CameraSolution] = {}
    problems: dict[str, str] = {}
    for lens in lenses:
        try:
            full[lens] = solve_camera(job, group, board, lens)
            problem = _explain_narrowness(full[lens], board)
            if problem:
                problems[lens] = problem
        except SolveError as error:
            problems[lens] = str(error)
    best = min((solution.rms_2d_px for solution in full.values()), default=0.0)
    results, outliers = [], []
    for lens in lenses:
        if lens not in problems and full[lens].rms_2d_px > HOPELESS * best:
            problems[lens] = f"its residuals of {full[lens].rms_2d_px:.2f} px rule it out"
        none = np.zeros((len(group), board.corners), bool)
        outliers.append(full[lens].outliers if lens in full else none)
        if lens in problems:
            results.append(HeldOut(lens, np.empty((0, 0)), problem=problems[lens]))
            continue

        def solve(part: Sequence[Photograph], lens: str = lens) -> CameraSolution:
            return solve_camera(job, part, board, lens)

        results.append(hold_out(lens, full[lens], group, board, solve))
    return results, outliers


def _explain_narrowness(camera: CameraSolution, board: Board) -> str:
    """Explains why a lens cannot be used over the field of its boards; "" if it can."""
    trust = judge(camera, board, np.full((1, 1), np.nan))
    if trust.refusal:
        return trust.refusal
    if trust.domain <= trust.reach:
        return (
            f"it folds or has a pole at {np.degrees(trust.domain):.1f} degrees, inside the field "
            f"that the boards reached ({np.degrees(trust.reach):.1f} degrees)"
        )
    if trust.valid_angle < _COVERED * trust.reach:
        return (
            f"boards reached {np.degrees(trust.reach):.1f} degrees, but not all around: it could "
            f"be trusted to {np.degrees(trust.valid_angle):.1f} only"
        )
    return ""
