"""From a job to lens files and a report: the whole way, one step a line."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import gsut
from calib import solve_mrcal, solve_opencv
from calib.board import Board, Photograph, assign_cameras, natural_key
from calib.corner_files import write_board_picture, write_vnl
from calib.corners import find_boards, turned
from calib.cross_validation import HeldOut, compare, hold_out
from calib.errors import BoardError, SolveError
from calib.halves import Halves, agreement_angle, compare_halves
from calib.job import Job
from calib.lens_files import write_lens
from calib.mrcal_process import have_mrcal, require_mrcal
from calib.report_json import report_values, write_report_json
from calib.report_page import write_report_page
from calib.rig import solve_rig, unify_turns
from calib.solution import CameraSolution
from calib.trust import Trust, judge
from calib.uncertainty import safe_uncertainty_map

# Times the best lens' residuals above which a lens is not worth five more solves.
_HOPELESS = 3.0
CORNERS_FOLDER, CORNERS_FILE = "corners", "corners.vnl"


@dataclass
class Result:
    """Everything that a calibration found out; what the reports show.

    second_lens: of each camera, the name of another lens and the radians to which both agree.
    """

    job: Job
    board: Board
    photographs: list[Photograph]
    cameras: list[CameraSolution]
    trusts: list[Trust]
    held_out: dict[str, list[HeldOut]]
    halves: list[Halves | None]
    second_lens: list[tuple[str, float] | None]
    lens_files: list[Path]
    pictures: list[Path]
    rig_rms_px: float | None
    seconds: float
    notes: list[str] = field(default_factory=list)

    @property
    def refusals(self) -> list[str]:
        """Why lenses must not be used."""
        return [trust.refusal for trust in self.trusts if trust.refusal]


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
    notes = _left_out(photographs)
    seen = [[p for p in group if p.corners is not None] for group in _by_camera(photographs)]

    held_out: dict[str, list[HeldOut]] = {}
    lens = job.lens
    if lens == "auto":
        lens, reasons = _choose(job, seen, board, held_out)
        notes += reasons
    cameras = [_solve(job, group, board, lens) for group in seen]
    rig_rms = None
    if len(cameras) > 1:
        turn = unify_turns(cameras, board)
        for photograph in turn:
            photograph.corners = turned(photograph.corners, board)
        if turn:
            cameras = [_solve(job, group, board, lens) for group in seen]
        rig_rms, rig_notes = solve_rig(cameras, board)
        notes += rig_notes

    trusts = []
    for camera in cameras:
        sigma, problem = safe_uncertainty_map(camera, board)
        notes += [f"{camera.name}: no uncertainty: {problem}"] if problem else []
        trusts.append(judge(camera, board, sigma))
        notes += trusts[-1].notes
    halves = [
        compare_halves(camera, trust, board, lambda part: _solve(job, part, board, lens))
        for camera, trust in zip(cameras, trusts, strict=True)
    ]
    second = [
        _second_lens(job, camera, trust, board)
        for camera, trust in zip(cameras, trusts, strict=True)
    ]
    pictures = _draw(folder / CORNERS_FOLDER, photographs, cameras, board)
    result = Result(
        job=job,
        board=board,
        photographs=photographs,
        cameras=cameras,
        trusts=trusts,
        held_out=held_out,
        halves=halves,
        second_lens=second,
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


def _solve(job: Job, photographs: Sequence[Photograph], board: Board, lens: str) -> CameraSolution:
    if job.solver_for(lens) == "opencv":
        return solve_opencv.solve_camera(photographs, board, lens)
    knots = job.knot_degrees
    if lens == "splined" and knots is None and job.lens == "auto":
        knots = solve_mrcal.COARSE_KNOTS_DEGREES
    return solve_mrcal.solve_camera(photographs, board, lens, knots)


def _choose(
    job: Job,
    seen: Sequence[Sequence[Photograph]],
    board: Board,
    held_out: dict[str, list[HeldOut]],
) -> tuple[str, list[str]]:
    """The lens for all cameras: where they disagree, the one with more parameters."""
    lenses, notes = _candidates(job)
    chosen: list[HeldOut] = []
    for group in seen:
        name = group[0].camera
        results, outliers = _try_lenses(job, lenses, group, board)
        reason = compare(results, outliers)
        held_out[name] = results
        chosen.append(next(result for result in results if result.chosen))
        notes.append(f"{name}: {reason}")
        notes += [f"{name}: {r.lens} was not considered: {r.problem}" for r in results if r.problem]
    return max(chosen, key=lambda result: result.parameters).lens, notes


def _candidates(job: Job) -> tuple[list[str], list[str]]:
    lenses = ["fisheye", "opencv4", "opencv8", "splined"]
    notes = []
    if job.solver != "auto":
        able = {"opencv": solve_opencv.LENS_NAMES, "mrcal": solve_mrcal.LENS_NAMES}[job.solver]
        lenses = [lens for lens in lenses if lens in able]
        if job.solver == "mrcal":
            require_mrcal()
    elif not have_mrcal():
        lenses = ["fisheye"]
        notes.append("mrcal is not installed: only the fisheye lens was tried")
    if job.out.suffix.lower() != ".cameramodel" and "splined" in lenses:
        lenses.remove("splined")
        notes.append(f"splined was not considered: {job.out.suffix} files cannot hold it")
    return lenses, notes


def _try_lenses(
    job: Job, lenses: Sequence[str], group: Sequence[Photograph], board: Board
) -> tuple[list[HeldOut], list[np.ndarray]]:
    """Cross-validation of each lens that fits at all, and the outliers of those scored."""
    full: dict[str, CameraSolution] = {}
    problems: dict[str, str] = {}
    for lens in lenses:
        try:
            full[lens] = _solve(job, group, board, lens)
            refusal = judge(full[lens], board, np.full((1, 1), np.nan)).refusal
            if refusal:
                problems[lens] = refusal
        except SolveError as error:
            problems[lens] = str(error)
    best = min((solution.rms_2d_px for solution in full.values()), default=0.0)
    results, outliers = [], []
    for lens in lenses:
        if lens not in problems and full[lens].rms_2d_px > _HOPELESS * best:
            problems[lens] = f"its residuals of {full[lens].rms_2d_px:.2f} px rule it out"
        if lens in problems:
            results.append(HeldOut(lens, np.empty((0, 0)), problem=problems[lens]))
            continue

        def solve(part: Sequence[Photograph], lens: str = lens) -> CameraSolution:
            return _solve(job, part, board, lens)

        results.append(hold_out(lens, full[lens], group, board, solve))
        if not results[-1].problem:
            outliers.append(full[lens].outliers)
    return results, outliers


def _second_lens(
    job: Job, camera: CameraSolution, trust: Trust, board: Board
) -> tuple[str, float] | None:
    """Another kind of lens, and the radians to which it agrees; None where it does not fit."""
    other = "opencv8" if camera.lens == "fisheye" else "fisheye"
    try:
        solver = solve_opencv if other == "fisheye" or not have_mrcal() else solve_mrcal
        second = solver.solve_camera(camera.photographs, board, other)
        if second.rms_2d_px > _HOPELESS * camera.rms_2d_px:
            return None
        return other, agreement_angle(camera, second, trust.valid_angle)
    except (SolveError, gsut.InputError):
        return None


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
