"""Judges camera poses by how many were found, how well they fit, and what the pictures are like."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from gsut.run.verdicts.verdict import Fault, Verdict

# Limits below which a result is usable at most, and below which it is poor.
_REGISTERED = (0.95, 0.6)  # share of the images with a pose
_FEWEST = 6  # images with a pose: with fewer, hardly anything would show that poses are wrong
# Error of poses over the diagonal that nine in ten pairs of images stay below where they are good,
# and six in ten where they are usable: 2 and 6 pixels of 350.
_ERROR = (0.0057, 0.017)
# Share of the verified matches that observe one point, below which a given lens is doubted: the
# right one mostly has more, and a wrong one leaves a third; and below which poses are poor.
FEW_AGREE = 0.4
_HARDLY_AGREE = 0.25
# Share of the pairs of images whose verified matches the poses reject as a whole, above which a
# result is usable at most, and above which poor: right poses reject hardly any.
_CONTRADICTED = (0.05, 0.15)
# Root mean square turn of images during their readout, in radians: more than hands turn a camera,
# and more than any motion; the scene has then bent (Albl et al., "Degeneracies in rolling shutter
# SfM", ECCV 2016).
_READOUT_TURN = (0.087, 0.2)
# Share of the matches that agree below which a scene with such turns has bent.
_AGREEING_FAST = 0.87
# Median residual over the diagonal above which a result is usable at most, and above which poor.
_RESIDUAL = (1.0e-3, 2.5e-3)
# Relative error of the focal length above which a result is usable at most, and above which poor:
# it shifts a picture of 350 pixels' diagonal by 2 and 6 pixels (root mean square).
FOCAL_LIMITS = (0.02, 0.06)
_FOCAL_SHIFT = _ERROR[0] / FOCAL_LIMITS[0]  # of a picture over its diagonal, for the same error
_SEPARATE_PLACES = (
    "put the pictures of each place into a folder of their own, or add pictures of the way from "
    "one to the other, and put up something that sets them apart"
)
_ESTIMATE_LENS = "let the lens be estimated: --unknown-lens"
_ADD_BETWEEN = "take more pictures between them, each showing two thirds of the one before"
_ADD_TURNED = "add images, some turned by 90 degrees about the axis of the lens"
_MEND_GLOBAL = (
    "give --shutter rolling if the camera moved fast, or put up something that sets places apart "
    "which look alike"
)


@dataclasses.dataclass(frozen=True)
class PosesQuality:
    """What the verdict on poses depends on.

    Attributes:
        images, registered, points: numbers of images, of those with a pose, and of points.
        held_by_few: number of the images with a pose that few points hold.
        median_px: median residual in pixels; diagonal_px: the images' diagonal.
        halves_px: half of the difference of poses adjusted with either half of the points, pixels
            that nine and six in ten pairs of images stay below; 0 if not measured.
        agreement: share of the matches that observe one point, or None.
        focal_gap: relative difference of the focal length that the images determine from that of a
            given lens; 0: none beyond doubt.
        contradicted: share of the pairs of images whose matches the poses reject as a whole.
        focal_sigma: standard deviation of the focal length over it; None: the lens was given.
        readout_turn: root mean square turn of the images during their readout, in radians; None:
            a global shutter.
        motion: a sentence on a motion that determines too little; empty: none.
        only_turned: whether that motion is a turn on the spot.
        look_alikes: a sentence on places taken for one another, or None.
        pictures: faults of the pictures themselves.
    """

    images: int
    registered: int
    points: int
    median_px: float
    diagonal_px: float
    halves_px: tuple[float, float]
    agreement: float | None
    focal_sigma: float | None
    held_by_few: int = 0
    focal_gap: float = 0.0
    contradicted: float = 0.0
    readout_turn: float | None = None
    motion: str = ""
    only_turned: bool = False
    look_alikes: str | None = None
    pictures: Sequence[Fault] = ()


def judge_poses(quality: PosesQuality) -> Verdict:
    """Judges how good poses are, with the reasons and what to do next."""
    q = quality
    sigma = q.focal_sigma or 0.0
    doubt = count_exceeded(sigma, FOCAL_LIMITS)  # by the error that is about as likely as not
    lost = _count_missed(q.registered / max(1, q.images), _REGISTERED)
    agreement = 1.0 if q.agreement is None else q.agreement
    is_given = q.focal_sigma is None
    turn = q.readout_turn or 0.0
    mend_poses = _MEND_GLOBAL if q.readout_turn is None else _ADD_TURNED
    mend_few = _ESTIMATE_LENS if is_given and q.readout_turn is None else mend_poses
    faults = [  # causes before what they lead to
        Fault(
            2 if q.only_turned else min(doubt, 1) if q.motion else 0,
            q.motion.split(":")[0],
            q.motion.rpartition(": ")[2],
            is_visible=not q.only_turned,
        ),
        *([] if q.look_alikes is None else [Fault(2, q.look_alikes, _SEPARATE_PLACES)]),
        *q.pictures,
        *_judge_registered(q, lost),
        Fault(
            count_exceeded(turn, _READOUT_TURN),
            f"images seem to turn by {math.degrees(turn):.0f} degrees while they are read",
            _ADD_TURNED,
        ),
        Fault(
            count_exceeded(q.contradicted, _CONTRADICTED),
            f"the poses reject all matches of {100 * q.contradicted:.0f} % of the pairs of images",
            mend_poses,
        ),
        Fault(
            _count_missed(agreement, (FEW_AGREE, _HARDLY_AGREE)),
            f"only {100 * (q.agreement or 0):.0f} % of the matches agree in all images together",
            mend_few,
            is_visible=True,
        ),
        Fault(
            count_exceeded(abs(q.focal_gap), FOCAL_LIMITS),
            f"the focal length differs by {100 * q.focal_gap:+.0f} % from that of the given lens",
            _ESTIMATE_LENS,
        ),
        Fault(
            doubt,
            "the focal length is "
            + ("not determined" if 2 * sigma > 1 else f"known only to {200 * sigma:.1f} %"),
            "give the lens by --camera or --fov, or turn the camera more while you walk",
            is_visible=True,
        ),
        Fault(
            count_exceeded(q.median_px / q.diagonal_px, _RESIDUAL),
            f"points are off by {q.median_px:.2f} px",
            "give --shutter rolling if the camera moved fast, or the lens by --camera",
            is_visible=True,
        ),
        _compare_halves(q, doubt, mend_few if agreement < FEW_AGREE else _ADD_BETWEEN),
    ]  # fmt: skip
    what = (
        f"poses of {q.registered} of {q.images} images, {q.points:,} points, off by "
        f"{q.median_px:.2f} px in the median"
    )
    return Verdict.from_faults(what, faults, "gsut train")


def _judge_registered(q: PosesQuality, lost: int) -> list[Fault]:
    """Finds what it means that images have no pose, or one that few points hold."""
    sure = _count_missed((q.registered - q.held_by_few) / max(1, q.images), _REGISTERED)
    return [
        Fault(
            lost,
            f"{q.images - q.registered} of {q.images} images could not be connected with the "
            "others",
            "add pictures between those that are connected and the others",
        ),
        Fault(
            sure if sure > lost else 0,
            f"{q.held_by_few} of {q.images} images are held by few points",
            "add pictures between them and the others",
        ),
        Fault(
            2 * (q.registered < _FEWEST),
            f"only {q.registered} views",
            "take 60 pictures or more, walking around what you want to see",
        ),
    ]


def _compare_halves(q: PosesQuality, doubt: int, advice: str) -> Fault:
    """Finds how far either half of the points and the focal length leave the poses open.

    The halves are adjusted through one lens, so that they do not show its error.

    Args:
        doubt: severity of the focal length's error alone, which is another fault.
    """
    by_lens = _FOCAL_SHIFT * (q.focal_sigma or 0.0) * q.diagonal_px
    off = [math.hypot(px, by_lens) for px in q.halves_px]
    unsure = [px > limit * q.diagonal_px for px, limit in zip(off, _ERROR, strict=True)]
    severity = 2 if unsure[1] else int(unsure[0])
    if not math.isfinite(q.halves_px[0]):
        what = "either half of the points loses images"
    elif severity <= doubt:  # the focal length says it
        severity, what = 0, ""
    elif by_lens > q.halves_px[0]:
        what = f"the focal length and either half of the points leave poses {off[0]:.1f} px open"
    else:
        what = f"either half of the points gives poses {off[0]:.1f} px off"
    return Fault(severity, what, advice, is_visible=True)


def has_bent(readout_turn: float | None, agreement: float | None) -> bool:
    """Returns whether motion during the readout has probably bent the scene; see `PosesQuality`."""
    most, impossible = _READOUT_TURN
    if readout_turn is None or agreement is None:
        return False
    return readout_turn > impossible or (readout_turn > most and agreement < _AGREEING_FAST)


def _count_missed(value: float, limits: tuple[float, float]) -> int:
    """Returns how many of the limits a value misses."""
    return int(value < limits[0]) + int(value < limits[1])


def count_exceeded(value: float, limits: tuple[float, float]) -> int:
    """Returns how many of the limits a value exceeds."""
    return int(value > limits[0]) + int(value > limits[1])
