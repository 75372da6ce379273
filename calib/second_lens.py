"""Other models for the same boards: up to which field angle they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import gsut
from calib import solve_mrcal, solve_opencv
from calib.board import Board
from calib.errors import SolveError
from calib.halves import AGREEMENT_DEGREES, agreement_angle
from calib.mrcal_process import have_mrcal
from calib.solution import CameraSolution
from calib.trust import Trust, judge
from calib.uncertainty import safe_uncertainty_map

OTHERS = ("fisheye", "opencv8", "splined")
# Times the lens' residuals above which another lens does not describe the camera at all.
_HOPELESS = 3.0


@dataclass
class SecondLens:
    """Another lens of the same boards, and where it agrees within AGREEMENT_DEGREES.

    Args:
        lens, solver: which. rms_2d_px: its residuals.
        compared_to: radians up to which both lenses are to be believed by themselves.
        agrees_to: radians up to which the rays agree, for points far away.
        agrees_near_to: the same for points as far away as the boards were.
        distance: of the boards' corners, the median, in the board's unit.
    """

    lens: str
    solver: str
    rms_2d_px: float
    compared_to: float
    agrees_to: float
    agrees_near_to: float
    distance: float


def solve_others(camera: CameraSolution, trust: Trust, board: Board) -> list[SecondLens]:
    """Solves the boards with every other kind of lens that is at hand, and compares.

    Lenses that do not fit, or that are refused, say nothing and are left out.
    """
    found = []
    for lens in OTHERS:
        if lens == camera.lens or (lens == "splined" and not have_mrcal()):
            continue
        solver = solve_opencv if lens == "fisheye" or not have_mrcal() else solve_mrcal
        try:
            other = solver.solve_camera(camera.photographs, board, lens)
            second = compare_with(camera, trust, other, board)
        except (SolveError, gsut.InputError):
            continue
        if second is not None:
            found.append(second)
    return found


def compare_with(
    camera: CameraSolution, trust: Trust, other: CameraSolution, board: Board
) -> SecondLens | None:
    """Compares two lenses inside the field in which both are trusted by themselves; None where the
    other is none to compare with."""
    if other.rms_2d_px > _HOPELESS * camera.rms_2d_px:
        return None
    sigma, _ = safe_uncertainty_map(other, board)
    judged = judge(other, board, sigma)
    if judged.refusal:
        return None
    limit = min(trust.valid_angle, judged.valid_angle)
    distance = float(np.median(np.linalg.norm(camera.points(board), axis=-1)))
    return SecondLens(
        other.lens,
        other.solver,
        other.rms_2d_px,
        limit,
        agreement_angle(camera, other, limit),
        agreement_angle(camera, other, limit, distance),
        distance,
    )


def cut_where_lenses_differ(
    trust: Trust, halves_agree_to: float | None, others: list[SecondLens], name: str
) -> None:
    """Ends the trusted field where the odd and the even photographs, or another kind of lens, say
    something else by more than AGREEMENT_DEGREES.

    Args:
        trust: is changed. halves_agree_to: radians, or None: no two halves.
        others: from `solve_others`. name: of the camera.
    """
    degrees = np.degrees
    before = trust.valid_angle
    if halves_agree_to is not None and halves_agree_to < before:
        trust.valid_angle = halves_agree_to
        trust.notes.append(
            f"{name}: cut at {degrees(halves_agree_to):.0f} degrees: beyond, the lenses of the odd "
            f"and of the even photographs differ by more than {AGREEMENT_DEGREES} degree: more "
            "boards are needed there, or the lens moved"
        )
    for other in others:
        if not other.agrees_to < min(before, other.compared_to):
            continue
        text = (
            f"{name}: cut at {degrees(other.agrees_to):.0f} degrees: beyond, {other.lens} by "
            f"{other.solver}, which fits the same boards ({other.rms_2d_px:.3f} px), differs by "
            f"more than {AGREEMENT_DEGREES} degree for things far away"
        )
        if other.agrees_near_to > other.agrees_to:
            text += (
                f", though at the boards' own distance of {other.distance:.2g} both agree to "
                f"{degrees(other.agrees_near_to):.0f}: show the board from further away too"
            )
        trust.notes.append(text)
        trust.valid_angle = min(trust.valid_angle, other.agrees_to)
    if before > 0 and trust.valid_angle <= 0:
        trust.refusal = (
            f"the lens of {name} cannot be told from these boards: others fit them too, and differ "
            f"by more than {AGREEMENT_DEGREES} degree even near the axis: take more photographs, "
            "with the board tilted and near every edge"
        )
