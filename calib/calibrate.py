"""Runs a calibration from the job to lens files and a report, one step a line."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calib.boards import (
    FEWEST_BOARDS,
    Board,
    Photograph,
    assign_cameras,
    find_boards,
    split_numbers,
    turn_corners,
    write_board_picture,
    write_vnl,
)
from calib.camera import CameraSolution
from calib.errors import BoardError, MisfitError, SolveError
from calib.job import Job
from calib.report import Result, write_lens, write_report_json, write_report_page
from calib.solve import require_mrcal, solve_by_opencv, solve_rig, solve_rig_together, unify_turns
from calib.trust import (
    HeldOut,
    Trust,
    choose_lens,
    compare_lenses,
    cut_where_lenses_differ,
    find_agreement_angle,
    judge,
    map_uncertainty_if_possible,
    refuse_narrow_field,
    solve_camera,
    solve_halves,
    solve_others,
)

CORNERS_FOLDER = "corners"  # pictures of the photographs with their corners
CORNERS_FILE = "corners.vnl"  # the corners as mrcal reads them


def calibrate(job: Job) -> Result:
    """Finds the boards, solves, judges the lenses, and writes lens files and reports.

    Raises:
        BoardError: the photographs do not allow a calibration.
        SolveError: there is no lens, or none that can be trusted; then report.json says why.
    """
    start = time.perf_counter()
    # libjpeg and OpenCV would write into the progress bar.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    board, folder = job.parse_board(), job.out.parent
    if job.lens != "auto" and job.choose_solver(job.lens) == "mrcal":
        require_mrcal()  # before the search for corners, which may take minutes
    paths = sorted(job.images, key=lambda path: split_numbers(str(path)))
    photographs = assign_cameras(paths, job.cameras)
    find_boards(photographs, board, job.progress)
    write_vnl(folder / CORNERS_FILE, photographs)
    for group in _group_by_camera(photographs):
        _drop_misfits(group, board)
    notes = _list_left_out(photographs)
    seen = [[p for p in group if p.corners is not None] for group in _group_by_camera(photographs)]

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
            photograph.corners = turn_corners(photograph.corners, board)
        if turn:
            cameras = [solve_camera(job, group, board, lens) for group in seen]
        if all(camera.solver == "mrcal" for camera in cameras):
            cameras, rig_rms, rig_notes = solve_rig_together(cameras, board)
        else:
            rig_rms, rig_notes = solve_rig(cameras, board)
        notes += rig_notes

    trusts = []
    for camera in cameras:
        sigma, problem = map_uncertainty_if_possible(camera, board)
        notes += [f"{camera.name}: no uncertainty: {problem}"] if problem else []
        trusts.append(judge(camera, board, sigma))
    halves, second_lenses = [], []
    for camera, trust in zip(cameras, trusts, strict=True):
        pair = solve_halves(camera, lambda part: solve_camera(job, part, board, lens))
        agree_to = find_agreement_angle(*pair, trust.valid_angle) if pair else None
        second_lenses.append([] if trust.refusal else solve_others(camera, trust, board))
        cut_where_lenses_differ(trust, agree_to, second_lenses[-1], camera.name)
        refuse_narrow_field(trust, camera)
        halves.append(compare_lenses(*pair, trust.valid_angle) if pair else None)
        notes += trust.notes
    pictures = _draw_boards(folder / CORNERS_FOLDER, photographs, cameras, board)
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
            path = _name_lens_file(job.out, camera, len(cameras))
            notes += write_lens(path, camera, trust, _describe_origin(camera, trust, board))
            result.lens_files.append(path)
    result.seconds = time.perf_counter() - start
    write_report_json(folder, result)
    write_report_page(folder, result)
    if result.refusals:
        raise SolveError(
            f"{'; '.join(result.refusals)} (no lens was written; see {folder / 'report.html'})"
        )
    return result


def _drop_misfits(photographs: Sequence[Photograph], board: Board) -> None:
    """Leaves out wrongly found boards: those that the fisheye lens of the others does not fit.

    Raises:
        BoardError: too few boards are left.
    """
    found = [photograph for photograph in photographs if photograph.corners is not None]
    while len(found) >= FEWEST_BOARDS:
        try:
            solve_by_opencv(found, board, "fisheye")
            return
        except MisfitError as error:
            for index in error.indices:
                found[index].corners = None
                found[index].reason = "its corners do not fit the lens of the other boards"
            found = [photograph for photograph in found if photograph.corners is not None]
        except SolveError:
            return  # the lens is no fisheye: the chosen lens decides
    raise BoardError(
        f"too few boards: {len(found)} of {len(photographs)} images of {photographs[0].camera} fit "
        f"one lens, at least {FEWEST_BOARDS} are needed: is --board right, and was the zoom fixed?"
    )


def _group_by_camera(photographs: Sequence[Photograph]) -> list[list[Photograph]]:
    names = dict.fromkeys(photograph.camera for photograph in photographs)
    return [[p for p in photographs if p.camera == name] for name in names]


def _list_left_out(photographs: Sequence[Photograph]) -> list[str]:
    return [f"{p.path}: left out: {p.reason}" for p in photographs if p.corners is None]


def _draw_boards(
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


def _name_lens_file(out: Path, camera: CameraSolution, count: int) -> Path:
    return out if count == 1 else out.with_name(f"{out.stem}-{camera.name}{out.suffix}")


def _describe_origin(camera: CameraSolution, trust: Trust, board: Board) -> str:
    return (
        f"gsut calibrate: {camera.lens} lens by {camera.solver}, {len(camera.photographs)} "
        f"photographs of a {board} board\n"
        f"RMS {camera.rms_2d_px:.4f} px (2-D), {camera.rms_axis_px:.4f} px (an axis); "
        f"{int(camera.outliers.sum())} outliers\n"
        f"trusted to {np.degrees(trust.valid_angle):.1f} degrees from the axis; boards reached "
        f"{np.degrees(trust.reach):.1f}"
    )
