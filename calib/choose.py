"""`--lens auto`: solves with every lens, drops those that cannot be right, compares the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib import solve_mrcal, solve_opencv
from calib.board import Board, Photograph
from calib.cross_validation import HeldOut, compare, hold_out
from calib.errors import SolveError
from calib.job import Job
from calib.mrcal_process import have_mrcal, require_mrcal
from calib.solution import CameraSolution
from calib.trust import judge

# Times the best lens' residuals above which a lens is not worth five more solves.
_HOPELESS = 3.0
# Part of the angle that boards reached to which a candidate must be usable.
_COVERED = 0.8


def solve_camera(
    job: Job, photographs: Sequence[Photograph], board: Board, lens: str
) -> CameraSolution:
    """One camera with one lens, by the job's solver."""
    if job.solver_for(lens) == "opencv":
        return solve_opencv.solve_camera(photographs, board, lens)
    knots = job.knot_degrees
    if lens == "splined" and knots is None and job.lens == "auto":
        knots = solve_mrcal.COARSE_KNOTS_DEGREES
    return solve_mrcal.solve_camera(photographs, board, lens, knots)


def choose_lens(
    job: Job,
    seen: Sequence[Sequence[Photograph]],
    board: Board,
    held_out: dict[str, list[HeldOut]],
) -> tuple[str, list[str]]:
    """One lens for all cameras of the rig: the boards of all cameras vote together.

    Args:
        job: what to do. seen: photographs with corners, of each camera. board: the chessboard.
        held_out: gets the results of each camera, by its name.

    Returns:
        The lens, and notes with the reason.

    Raises:
        SolveError: no lens fits.
    """
    lenses, notes = _candidates(job)
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


def _candidates(job: Job) -> tuple[list[str], list[str]]:
    lenses = ["fisheye", "opencv4", "opencv8", "splined"]
    notes = []
    if job.solver == "mrcal":
        require_mrcal()
        lenses = list(solve_mrcal.LENS_NAMES)
    elif job.solver == "opencv":
        lenses = list(solve_opencv.LENS_NAMES)
    elif not have_mrcal():
        lenses = list(solve_opencv.LENS_NAMES)
        notes.append("mrcal is not installed: only OpenCV's lenses were tried")
    if job.out.suffix.lower() != ".cameramodel" and "splined" in lenses:
        lenses.remove("splined")
        notes.append(f"splined was not considered: {job.out.suffix} files cannot hold it")
    return lenses, notes


def _try_lenses(
    job: Job, lenses: Sequence[str], group: Sequence[Photograph], board: Board
) -> tuple[list[HeldOut], list[np.ndarray]]:
    """Cross-validation of each lens that can be right, and the outliers of each full solve."""
    full: dict[str, CameraSolution] = {}
    problems: dict[str, str] = {}
    for lens in lenses:
        try:
            full[lens] = solve_camera(job, group, board, lens)
            problem = _too_narrow(full[lens], board)
            if problem:
                problems[lens] = problem
        except SolveError as error:
            problems[lens] = str(error)
    best = min((solution.rms_2d_px for solution in full.values()), default=0.0)
    results, outliers = [], []
    for lens in lenses:
        if lens not in problems and full[lens].rms_2d_px > _HOPELESS * best:
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


def _too_narrow(camera: CameraSolution, board: Board) -> str:
    """Why a lens that cannot be used over the field of its boards is no candidate, or "" """
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
