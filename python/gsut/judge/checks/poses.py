"""Checks of camera poses: how many were found, how well they fit, what leaves them open."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from gsut.data import list_some
from gsut.judge.checks.check import DIAGONAL, GOOD_PX, USABLE_PX, Check, judge
from gsut.judge.checks.pictures import MANY, PICTURE_CHECKS, PictureQuality
from gsut.judge.preference import MEDIAN_DEVIATION
from gsut.run import Verdict

# Share of matches that agree with poses and lenses, below which one of these is wrong; repeated
# things lower it too.
FEW_AGREE = 0.4
# Share of the images without a pose, or of the pairs that poses reject, above which a result is
# usable at most. Where things repeat, right poses reject pairs, of few matches.
_SOME_LOST = 0.05
_MANY_LOST = 0.4  # share of the images without a pose above which it is poor
_FEWEST = 6  # images with a pose: with fewer, hardly anything would show that poses are wrong
# Root mean square turn of images during their readout, in radians, that is more than any motion: by
# it the scene has bent (Albl et al., "Degeneracies in rolling shutter SfM", ECCV 2016).
IMPOSSIBLE_TURN = 0.2

_ESTIMATE_LENS = "let the lens be estimated: --unknown-lens"
_GIVE_LENS = (
    "give the lens by --camera (gsut calibrate finds it), or walk in a curve and turn and tilt the "
    "camera, a little from picture to picture"
)
_ADD_BETWEEN = "take more pictures between them, each showing two thirds of the one before"
_ADD_LINKS = "add pictures between those that are connected and the others"
_ADD_TURNED = "add images, some turned by 90 degrees about the axis of the lens"


@dataclasses.dataclass(frozen=True)
class PosesQuality(PictureQuality):
    """What the verdict on poses depends on, beside what the images are like.

    Attributes:
        registered, points: numbers of images with a pose and of points.
        median_px: median residual in pixels; diagonal_px: the images' diagonal.
        pose_errors_px: probable errors of relative poses, by leaving out images or points: pixels
            that nine and six in ten pairs of images stay below; 0 if not measured.
        lens_sigma_px: standard deviation of the lens over a picture; None: that of `focal_sigma`.
        lens_gap_px, focal_gap: difference of the lens that the images determine from a given one,
            over a picture and relative of the focal length; 0: none beyond doubt.
        agreement: share of the matches that observe one point; 1 if not measured.
        contradicted: share of the pairs of images whose matches the poses reject as a whole.
        contradicted_images: share of each image's matches that are in such pairs, by its name, the
            largest first.
        focal_sigma: standard deviation of the focal length over it; None: the lens was given.
        readout_turn: root mean square turn of the images during their readout, in radians; None:
            a global shutter.
        look_alikes: a sentence on places taken for one another; empty: none.
    """

    registered: int
    points: int
    median_px: float
    diagonal_px: float
    pose_errors_px: tuple[float, float]
    agreement: float
    focal_sigma: float | None
    lens_sigma_px: float | None = None
    lens_gap_px: float = 0.0
    focal_gap: float = 0.0
    contradicted: float = 0.0
    contradicted_images: Mapping[str, float] = dataclasses.field(default_factory=dict)
    readout_turn: float | None = None
    look_alikes: str = ""

    @property
    def scale(self) -> float:
        """Returns the pixels of a picture with the diagonal `DIAGONAL` for one of these."""
        return DIAGONAL / self.diagonal_px

    @property
    def rejected(self) -> float:
        """Returns the largest share of an image's matches in rejected pairs, if these are many."""
        lost = max(self.contradicted_images.values(), default=0.0)
        return lost if self.contradicted > _SOME_LOST else 0.0

    @property
    def lens_px(self) -> float:
        """Returns by how many pixels the probable error of the lens shifts a picture."""
        if self.lens_sigma_px is not None:
            return self.scale * self.lens_sigma_px / MEDIAN_DEVIATION
        return convert_focal_error((self.focal_sigma or 0.0) / MEDIAN_DEVIATION)

    @property
    def error_px(self) -> float:
        """Returns the pixels that lens and poses are probably off.

        Of nine in ten pairs of images, as a good result needs it; from USABLE_PX on, of six in ten.
        """
        most, many = (self.scale * px for px in self.pose_errors_px)
        return max(min(most, USABLE_PX), many, self.lens_px)

    @property
    def is_lens_open(self) -> bool:
        """Returns whether the lens is farther off than poses, which a wrong lens bends too."""
        return self.lens_px > self.scale * self.pose_errors_px[1]


def convert_focal_error(error: float) -> float:
    """Converts a relative error of the focal length to pixels of a picture, root mean square.

    It moves a pixel by its share of the distance from the middle, whose square is on average a
    twelfth of the squared diagonal.
    """
    return DIAGONAL / math.sqrt(12) * abs(error)


def _describe_error(q: PosesQuality) -> str:
    """Describes which of lens and poses is open."""
    sigma, px = q.focal_sigma or 0.0, q.pose_errors_px[0]
    if q.is_lens_open:
        if convert_focal_error(sigma) < GOOD_PX:
            return f"the lens is probably {q.lens_px / q.scale:.1f} px off"
        known = f"known only to {200 * sigma:.1f} %" if 2 * sigma <= 0.5 else "not determined"
        return f"the focal length is {known}"
    if not math.isfinite(px):
        return "without some of the points or images others lose their pose"
    return f"without some of the points or images poses are {px:.1f} px off"


def _choose_step_on_error(q: PosesQuality) -> str:
    if q.is_lens_open:
        return _GIVE_LENS
    return _choose_step_on_matches(q) if q.agreement < FEW_AGREE else _ADD_BETWEEN


def _choose_step_on_matches(q: PosesQuality) -> str:
    """Names a step where matches do not fit the poses."""
    if q.readout_turn is not None:
        return _ADD_TURNED
    if q.focal_sigma is None and q.agreement < FEW_AGREE:
        return _ESTIMATE_LENS
    return (
        "put up something that sets places apart which look alike, or give --shutter rolling if "
        "the camera moved fast"
    )


POSES_CHECKS: tuple[Check[PosesQuality], ...] = (
    Check(
        "look-alikes", lambda q: bool(q.look_alikes), 0, 0, lambda q: q.look_alikes,
        "put the pictures of each place into a folder of their own, or add pictures of the way "
        "from one to the other, and put up something that sets them apart",
    ),
    *PICTURE_CHECKS,
    Check(
        "images without a pose", lambda q: (q.images - q.registered) / max(1, q.images), _SOME_LOST,
        _MANY_LOST,
        lambda q: f"{q.images - q.registered} of {q.images} images could not be connected with the "
        "others",
        _ADD_LINKS,
    ),
    Check(
        "number of views", lambda q: _FEWEST - q.registered, 0, 0,
        lambda q: f"only {q.registered} views",
        "take 60 pictures or more, walking around what you want to see", is_visible=True,
    ),
    Check(
        "rejected pairs", lambda q: q.rejected, MANY, MANY,
        lambda q: f"the poses reject all matches of {100 * q.contradicted:.0f} % of the pairs of "
        "images, above all of " + list_some(
            [name for name, lost in q.contradicted_images.items() if lost > MANY]
        ),
        _choose_step_on_matches,
    ),
    Check(
        "given lens", lambda q: q.scale * q.lens_gap_px, GOOD_PX, USABLE_PX,
        lambda q: f"the lens differs by {q.lens_gap_px:.0f} px over the picture, its focal length "
        f"by {100 * q.focal_gap:+.0f} %, from the given one",
        _ESTIMATE_LENS,
    ),
    Check(
        "open error", lambda q: q.error_px, GOOD_PX, USABLE_PX,
        _describe_error, _choose_step_on_error, is_visible=True,
    ),
)  # fmt: skip


def judge_poses(quality: PosesQuality) -> Verdict:
    """Judges how good poses are, with the reasons and what to do next."""
    what = (
        f"poses of {quality.registered} of {quality.images} images, {quality.points:,} points, off "
        f"by {quality.median_px:.2f} px in the median"
    )
    return judge(POSES_CHECKS, quality, what, "gsut train")
