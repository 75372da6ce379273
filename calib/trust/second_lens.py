"""Compares a lens with other models of the same boards: up to which field angle they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import gsut
from calib.boards import Board
from calib.camera import CameraSolution, to_gsut_camera
from calib.errors import SolveError
from calib.solve import has_mrcal, solve_by_mrcal, solve_by_opencv
from calib.trust.halves import AGREEMENT_DEGREES, find_agreement_angle
from calib.trust.trust import HOPELESS, Trust, judge
from calib.trust.uncertainty import map_uncertainty_if_possible, spread_pixels

OTHERS = ("fisheye", "opencv8", "splined")
_LEAST_SHARE = 0.02  # of the image's pixels that must be trusted: readers call less no lens


@dataclass
class SecondLens:
    """Another lens of the same boards, and where it agrees within AGREEMENT_DEGREES.

    Args:
        lens, solver: their names. rms_2d_px: its residuals.
        compared_to: radians up to which each lens is trusted by itself.
        agrees_to: radians up to which the rays agree, for distant points.
        agrees_near_to: the same for points at the distance of the boards.
        distance: the median of the boards' corners, in the board's unit.
    """

    lens: str
    solver: str
    rms_2d_px: float
    compared_to: float
    agrees_to: float
    agrees_near_to: float
    distance: float


def solve_others(camera: CameraSolution, trust: Trust, board: Board) -> list[SecondLens]:
    """Solves for every other kind of lens that is available, and compares.

    Lenses that do not fit, or that are refused, are no evidence and are left out.
    """
    found = []
    for lens in OTHERS:
        if lens == camera.lens or (lens == "splined" and not has_mrcal()):
            continue
        solve = solve_by_opencv if lens == "fisheye" or not has_mrcal() else solve_by_mrcal
        try:
            other = solve(camera.photographs, board, lens)
            second = compare_with(camera, trust, other, board)
        except (SolveError, gsut.InputError):
            continue
        if second is not None:
            found.append(second)
    return found


def compare_with(
    camera: CameraSolution, trust: Trust, other: CameraSolution, board: Board
) -> SecondLens | None:
    """Compares two lenses inside the field in which each is trusted by itself.

    Returns None if the other lens does not fit or is refused.
    """
    if other.rms_2d_px > HOPELESS * camera.rms_2d_px:
        return None
    sigma, _ = map_uncertainty_if_possible(other, board)
    judged = judge(other, board, sigma)
    if judged.refusal:
        return None
    limit = min(trust.valid_angle, judged.valid_angle)
    distance = float(np.median(np.linalg.norm(camera.locate_corners(board), axis=-1)))
    return SecondLens(
        other.lens,
        other.solver,
        other.rms_2d_px,
        limit,
        find_agreement_angle(camera, other, limit),
        find_agreement_angle(camera, other, limit, distance),
        distance,
    )


def cut_where_lenses_differ(
    trust: Trust, halves_agree_to: float | None, others: list[SecondLens], name: str
) -> None:
    """Ends the trusted field where two lenses of the same boards begin to differ.

    The two are the lenses of odd and even photographs, or this lens and one of another kind; the
    limit is AGREEMENT_DEGREES.

    Args:
        trust: is changed. halves_agree_to: radians; None: there are no two halves.
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
        trust.refusal = _refuse_lens(name)


def refuse_narrow_field(trust: Trust, camera: CameraSolution) -> None:
    """Refuses a lens of whose image so little can be trusted that its file would hold none.

    Args:
        trust: is changed.
        camera: its lens.
    """
    if trust.refusal:
        return
    lens = to_gsut_camera(camera).with_valid_field_angle(trust.valid_angle)
    pixels = spread_pixels(camera.width, camera.height).reshape(-1, 2)
    if lens.unproject(pixels)[1].mean() < _LEAST_SHARE:
        trust.refusal = _refuse_lens(camera.name)


def _refuse_lens(name: str) -> str:
    return (
        f"these boards do not determine the lens of {name}: others fit them too, and differ by "
        f"more than {AGREEMENT_DEGREES} degree even near the axis: take more photographs, all with "
        "one camera at one zoom and focus, with the board tilted and near every edge"
    )
