"""Scores lenses by how well they predict boards that their solve has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.boards import Board, Photograph
from calib.camera import CameraSolution, Observation
from calib.errors import SolveError
from calib.solve import compute_residuals, fit_poses

_FOLDS = 5  # each solve sees four fifths of the boards, close to all of them
Solver = Callable[[Sequence[Photograph]], CameraSolution]


@dataclass
class HeldOut:
    """How well one lens predicts boards that its solve had not seen.

    Args:
        lens: its name. errors: (V, corners) pixels, NaN where never predicted.
        parameters: number of the lens' parameters. problem: why it was not scored, or "".
        rms_px, standard_error_px: over boards; see `compare`. chosen: whether it was chosen.
    """

    lens: str
    errors: np.ndarray
    parameters: int = 0
    problem: str = ""
    rms_px: float = float("nan")
    standard_error_px: float = float("nan")
    chosen: bool = False


def hold_out(
    lens: str, full: CameraSolution, photographs: Sequence[Photograph], board: Board, solve: Solver
) -> HeldOut:
    """Solves _FOLDS times without every _FOLDS-th photograph, and predicts those.

    To predict a board, its six pose parameters are fitted with the lens held: what remains is the
    error of the lens and the noise of the corners.

    Args:
        lens: name for the report. full: the solve with all photographs, where poses start.
        photographs: of one camera, with corners. board: the chessboard.
        solve: makes the lens from photographs.
    """
    count = len(photographs)
    result = HeldOut(lens, np.full((count, board.corners), np.nan), len(full.params))
    for fold in range(min(_FOLDS, count)):
        unseen = list(range(fold, count, _FOLDS))
        seen = [photograph for i, photograph in enumerate(photographs) if i not in unseen]
        try:
            camera = solve(seen)
            points = board.locate_corners(camera.warp)
            good = ~full.outliers  # displaced corners would pull the pose
            fitted = [
                Observation(0, k, photographs[i].corners[good[i]], points[good[i]])
                for k, i in enumerate(unseen)
            ]
            everything = [
                Observation(0, k, photographs[i].corners, points) for k, i in enumerate(unseen)
            ]
            still = np.zeros((1, 6))
            _, poses = fit_poses([camera], fitted, still, full.camera_from_board[unseen])
            for i, left in zip(
                unseen, compute_residuals([camera], everything, still, poses), strict=True
            ):
                result.errors[i] = np.linalg.norm(left, axis=1)
        except SolveError as error:
            result.problem = str(error)
            return result
    return result


def compare(candidates: Sequence[HeldOut], outliers: Sequence[np.ndarray]) -> str:
    """Scores the candidates, marks the chosen one and explains the choice in a sentence.

    The best has the smallest root mean square error over unseen boards. The choice is the lens with
    the fewest parameters that is not worse than the best by more than one standard error of their
    difference, board by board. Corners that half of the lenses call outliers are errors of the
    detector and left out.

    Args:
        candidates: from `hold_out`, all of the same photographs.
        outliers: (V, corners) of each candidate's full solve.

    Raises:
        SolveError: no candidate could be scored.
    """
    scored = [candidate for candidate in candidates if not candidate.problem]
    if not scored:
        raise SolveError(f"no lens fits these boards: {candidates[0].problem}")
    use = np.mean(list(outliers), axis=0) < 0.5
    squares = {}
    for candidate in scored:
        errors = np.where(use, candidate.errors, np.nan)
        squares[candidate.lens] = np.nanmean(errors**2, axis=1)
        mean = float(np.mean(squares[candidate.lens]))
        candidate.rms_px = float(np.sqrt(mean))
        spread = np.std(squares[candidate.lens], ddof=1) / np.sqrt(len(errors))
        candidate.standard_error_px = float(spread / (2 * candidate.rms_px))
    best = min(scored, key=lambda candidate: candidate.rms_px)
    chosen = best
    for candidate in sorted(scored, key=lambda c: c.parameters):
        difference = squares[candidate.lens] - squares[best.lens]
        error = np.std(difference, ddof=1) / np.sqrt(len(difference))
        if candidate is best or np.mean(difference) <= error:
            chosen = candidate
            break
    chosen.chosen = True
    return _explain_choice(scored, best, chosen)


def _explain_choice(scored: Sequence[HeldOut], best: HeldOut, chosen: HeldOut) -> str:
    figures = ", ".join(
        f"{c.lens} {c.rms_px:.3f} px" for c in sorted(scored, key=lambda c: c.rms_px)
    )
    if chosen is best:
        why = f"{chosen.lens} predicts unseen boards best"
    else:
        why = (
            f"{chosen.lens} predicts unseen boards as well as {best.lens} within one standard "
            f"error, with {chosen.parameters} parameters instead of {best.parameters}"
        )
    return f"{why} (RMS on boards held out: {figures})"
