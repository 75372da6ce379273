"""From a job to lens files and a report: the whole way, one step a line."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib import solve_opencv
from calib.board import Board, Photograph, assign_cameras, natural_key
from calib.choose import choose_lens, solve_camera
from calib.corner_files import write_board_picture, write_vnl
from calib.corners import FEWEST_BOARDS, find_boards, turned
from calib.cross_validation import HeldOut
from calib.errors import BoardError, MisfitError, SolveError
from calib.halves import agreement_angle, compare_lenses, solve_halves
from calib.job import Job
from calib.lens_files import write_lens
from calib.mrcal_process import require_mrcal
from calib.report_json import report_values, write_report_json
from calib.report_page import write_report_page
from calib.result import Result
from calib.rig import solve_rig, unify_turns
from calib.second_lens import cut_where_lenses_differ, solve_others
from calib.solution import CameraSolution
from calib.solve_mrcal_rig import solve_rig_together
from calib.trust import Trust, judge
from calib.uncertainty import safe_uncertainty_map

CORNERS_FOLDER, CORNERS_FILE = "corners", "corners.vnl"


def calibrate(job: Job) -> Result:
    """Finds the boards, solves, judges, and writes lens files, report.json and report.html.

    Raises:
        BoardError: the photographs are not what a calibration needs.
        SolveError: no lens, or none to be trusted; then report.json says why.
    """
    start = time.perf_counter()
    board, folder = job.chessboard(), job.out.parent
    if job.lens != "auto" and job.solver_for(job.lens) == "mrcal":
        require_mrcal()  # before the corners: finding them may take minutes
    paths = sorted(job.images, key=lambda path: natural_key(str(path)))
    photographs = assign_cameras(paths, job.cameras)
    find_boards(photographs, board, job.progress)
    write_vnl(folder / CORNERS_FILE, photographs)
    for group in _by_camera(photographs):
        _drop_misfits(group, board)
    notes = _left_out(photographs)
    seen = [[p for p in group if p.corners is not None] for group in _by_camera(photographs)]

    held_out: dict[str, list[HeldOut]] = {}
    lens = job.lens
    if lens == "auto":
        lens, reasons = choose_lens(job, seen, board, held_out)
        notes += reasons
    cameras = [solve_camera(job, group, board, lens) for group in seen]
    rig_rms = None
    if len(cameras) > 1:
        turn = unify_turns(cameras, board)
        for photograph in turn:
            photograph.corners = turned(photograph.corners, board)
        if turn:
            cameras = [solve_camera(job, group, board, lens) for group in seen]
        if all(camera.solver == "mrcal" for camera in cameras):
            cameras, rig_rms, rig_notes = solve_rig_together(cameras, board)
        else:
            rig_rms, rig_notes = solve_rig(cameras, board)
        notes += rig_notes

    trusts = []
    for camera in cameras:
        sigma, problem = safe_uncertainty_map(camera, board)
        notes += [f"{camera.name}: no uncertainty: {problem}"] if problem else []
        trusts.append(judge(camera, board, sigma))
    halves, second_lenses = [], []
    for camera, trust in zip(cameras, trusts, strict=True):
        pair = solve_halves(camera, lambda part: solve_camera(job, part, board, lens))
        agree_to = agreement_angle(*pair, trust.valid_angle) if pair else None
        second_lenses.append([] if trust.refusal else solve_others(camera, trust, board))
        cut_where_lenses_differ(trust, agree_to, second_lenses[-1], camera.name)
        halves.append(compare_lenses(*pair, trust.valid_angle) if pair else None)
        notes += trust.notes
    pictures = _draw(folder / CORNERS_FOLDER, photographs, cameras, board)
    result = Result(
        job=job,
        board=board,
        photographs=photographs,
        cameras=cameras,
        trusts=trusts,
        held_out=held_out,
        halves=halves,
        second_lenses=second_lenses,
        lens_files=[],
        pictures=pictures,
        rig_rms_px=rig_rms,
        seconds=0.0,
        notes=notes,
    )
    if not result.refusals:
        for camera, trust in zip(cameras, trusts, strict=True):
            path = _lens_path(job.out, camera, len(cameras))
            notes += write_lens(path, camera, trust, _origin(camera, trust, board))
            result.lens_files.append(path)
    result.seconds = time.perf_counter() - start
    write_report_json(folder, report_values(result))
    write_report_page(folder, result)
    if result.refusals:
        raise SolveError(
            f"{'; '.join(result.refusals)} (no lens was written; see {folder / 'report.html'})"
        )
    return result


def _drop_misfits(photographs: Sequence[Photograph], board: Board) -> None:
    """Leaves out boards that a fisheye lens of the others does not fit: wrongly found ones.

    Raises:
        BoardError: too few are left.
    """
    found = [photograph for photograph in photographs if photograph.corners is not None]
    while len(found) >= FEWEST_BOARDS:
        try:
            solve_opencv.solve_camera(found, board, "fisheye")
            return
        except MisfitError as error:
            for index in error.indices:
                found[index].corners = None
                found[index].reason = "its corners do not fit the lens of the other boards"
            found = [photograph for photograph in found if photograph.corners is not None]
        except SolveError:
            return  # not a fisheye; the chosen lens decides
    raise BoardError(
        f"too few boards: {len(found)} of {len(photographs)} images of {photographs[0].camera} fit "
        f"one lens, at least {FEWEST_BOARDS} are needed: is --board right, and was the zoom fixed?"
    )


def _by_camera(photographs: Sequence[Photograph]) -> list[list[Photograph]]:
    names = dict.fromkeys(photograph.camera for photograph in photographs)
    return [[p for p in photographs if p.camera == name] for name in names]


def _left_out(photographs: Sequence[Photograph]) -> list[str]:
    return [f"{p.path}: left out: {p.reason}" for p in photographs if p.corners is None]


def _draw(
    folder: Path,
    photographs: Sequence[Photograph],
    cameras: Sequence[CameraSolution],
    board: Board,
) -> list[Path]:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BoardError(f"{folder}: cannot be made ({error.strerror})") from None
    outliers = {
        id(photograph): camera.outliers[index]
        for camera in cameras
        for index, photograph in enumerate(camera.photographs)
    }
    return [write_board_picture(folder, p, board, outliers.get(id(p))) for p in photographs]


def _lens_path(out: Path, camera: CameraSolution, count: int) -> Path:
    return out if count == 1 else out.with_name(f"{out.stem}-{camera.name}{out.suffix}")


def _origin(camera: CameraSolution, trust: Trust, board: Board) -> str:
    return (
        f"gsut calibrate: {camera.lens} lens by {camera.solver}, {len(camera.photographs)} "
        f"photographs of a {board} board\n"
        f"RMS {camera.rms_2d_px:.4f} px (2-D), {camera.rms_axis_px:.4f} px (an axis); "
        f"{int(camera.outliers.sum())} outliers\n"
        f"trusted to {np.degrees(trust.valid_angle):.1f} degrees from the axis; boards reached "
        f"{np.degrees(trust.reach):.1f}"
    )
