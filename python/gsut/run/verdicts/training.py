"""Judges a trained scene, in words for somebody who does not know PSNR."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from gsut.run.options import PRESETS, TrainOptions
from gsut.run.verdicts.verdict import Fault, Verdict
from gsut.system import format_command

# Share of the detail from which a view is good: what a shift or a blur of 1 of 800 pixels leaves.
GOOD = 0.8
# Share below which a view is poor: what a shift of 4 pixels or a blur of 5 leaves.
POOR = 0.4
# Share of the detail -> what renders look like beside photographs from there on.
_LOOKS = (
    (0.95, "almost like the photographs"),
    (GOOD, "sharp, with small differences"),
    (0.6, "sharp in most places, blurred or doubled in others"),
    (POOR, "recognisable, sharp in some places only"),
    (0.0, "smeared, only coarse shapes are right"),
)
# Share of the detail that shifting held-out renders brings back from which poses or the lens are
# wrong: where they are right, a shift brings back nothing.
_SHIFT_GAIN = 0.03
# Shares of the pixels that detail leaves out -> what these show.
_LEFT_OUT = {"unseen": "no training view saw", "moving": "moved"}
# Share of the training pixels from which what moved is named.
_MOVING = 0.02
# The same from which it is named as a possible cause: most of what moves slowly is not found.
_MAY_MOVE = 0.001
# Gain by corrected colours from which differing exposure deserves a note.
_COLORS_DB = 2.0


def judge_training(
    metrics: dict[str, Any],
    data: str,
    run: str,
    options: TrainOptions | None = None,
    division: Sequence[str] = (),
    accused: Mapping[str, str] | None = None,
) -> Verdict:
    """Judges a training by how much of the detail of its held-out views is right.

    Args:
        metrics: of metrics.json: psnr, psnr_color_corrected, detail_median, detail_min,
            least_detailed, detail_shifted_median, detail_train, unseen, moving, moving_train,
            steps, evaluated_on.
        data, run: the dataset's and the run's path, for the next command.
        options: that the run was made with, which the next command keeps; None: the defaults.
        division: words of the command line that divided it into blocks.
        accused: what the check before the training says is wrong: subject, "poses" or "lens",
            what and advice; None: nothing.
    """
    psnr = metrics.get("psnr")
    if psnr is None:
        return Verdict("usable", "no view was held out, so nothing was measured")
    options = options or TrainOptions()
    repeat = _NextCommand(data, f"{run}-2", options, division)
    refinement = _describe_refinement(metrics, options, accused)
    if refinement and _has_refined(metrics):
        accused = None
    fault = _find_fault(metrics, repeat, accused)
    reasons = [*([] if fault is None else [fault.what]), *refinement]
    moving = metrics.get("moving_train", 0.0)
    if moving >= _MOVING:
        reasons.append(
            f"{100 * moving:.1f} % of the training pixels show what moved past, or what no other "
            "photograph shows, and were left out"
        )
    least = metrics["detail_min"]
    if _name_level(least) != _name_level(metrics["detail_median"]):
        reasons.append(
            f"{metrics['least_detailed']} is worst, with {100 * least:.0f} % of its detail"
        )
    corrected = metrics.get("psnr_color_corrected")
    if corrected is not None and corrected > psnr + _COLORS_DB:
        reasons.append(
            f"brightness or colours differ from the photographs ({corrected:.1f} dB with colours "
            "corrected): exposure, white balance, or fog in a sky"
        )
    advice = format_command(["gsut", "view", run]) if fault is None else fault.advice
    level = _name_level(metrics["detail_median"])
    return Verdict(level, _describe(metrics, psnr), tuple(reasons), advice)


def _has_refined(metrics: dict[str, Any]) -> bool:
    """Returns whether tracks of features gave new poses, and a new lens if requested."""
    return metrics.get("refinement", {}).get("tracks", {}).get("refined", 0) > 0


def _describe_refinement(
    metrics: dict[str, Any], options: TrainOptions, accused: Mapping[str, str] | None
) -> list[str]:
    """Describes what refinement did to what the check accused; [] if it was not to be refined."""
    if accused is None or not getattr(options, f"refine_{accused['subject']}"):
        return []
    tracks = metrics.get("refinement", {}).get("tracks", {})
    wrong = f"the check before the training found that {accused['what']}"
    if not _has_refined(metrics):
        return [f"{wrong}; that was not mended: {tracks.get('note', 'nothing was refined')}"]
    focal = tracks.get("focal_percent")
    lens = "" if focal is None else f", the focal length changed by {focal:+.1f} %"
    return [
        f"{wrong}; tracks of features mended that: the poses of {tracks['refined']} views turned "
        f"by {tracks['turned_degrees']:.2g} degrees and moved by {tracks['moved']:.2g} units "
        f"(median){lens}, and observations are {tracks['error_px']:.2f} px off"
    ]


def _describe(metrics: dict[str, Any], psnr: float) -> str:
    """Describes what renders look like, with the figures that say so."""
    detail = metrics["detail_median"]
    looks = next(text for least, text in _LOOKS if detail >= least)
    apart = [
        f"; {share} % of the pixels show what {what}, and are left out"
        for name, what in _LEFT_OUT.items()
        if (share := round(100 * metrics.get(name, 0.0)))
    ]
    return (
        f"renders of {metrics['evaluated_on']} are {looks}: {100 * detail:.0f} % of the detail is "
        f"right in the median view (PSNR {psnr:.1f} dB{''.join(apart)})"
    )


def _name_level(detail: float) -> str:
    """Names the level of a share of the detail."""
    return "good" if detail >= GOOD else "usable" if detail >= POOR else "poor"


def _find_fault(
    metrics: dict[str, Any], repeat: _NextCommand, accused: Mapping[str, str] | None
) -> Fault | None:
    """Finds what keeps a training from being good; None if it is.

    Where a shift of the whole picture brings detail back, poses or the lens are wrong. Else the
    larger loss decides: training views that are soft themselves do not show what they were given;
    where held-out views lose more against them, the photographs did not determine the scene in
    between.
    """
    detail, train = metrics["detail_median"], metrics.get("detail_train")
    if detail >= GOOD:
        return None
    wrong, mend = _describe_accused(repeat, accused)
    shifted = metrics.get("detail_shifted_median", detail)
    if shifted > detail + _SHIFT_GAIN:
        return Fault(
            1,
            f"renders stand beside their photographs (shifted, {100 * shifted:.0f} % of the detail "
            f"is right): {wrong or 'poses or the lens are wrong'}",
            mend,
        )
    if train is None:
        return Fault(1, "steps and Gaussians are few", repeat.make_longer())
    if train - detail > 1 - train:
        sharp = "sharp" if train >= GOOD else "far sharper"
        moving = metrics.get("moving_train", 0.0)
        cause = "between them are too few photographs"
        if moving >= _MOVING:
            cause = "something moved"
        elif moving >= _MAY_MOVE:
            cause += ", or something moved"
        still = ", while nothing moves" if moving >= _MAY_MOVE else ""
        return Fault(
            1,
            f"training views are {sharp} ({100 * train:.0f} % of their detail): {cause}",
            f"photograph more from between the places there are{still}",
        )
    soft = f"training views are soft, too ({100 * train:.0f} % of their detail)"
    if repeat.is_short:
        return Fault(1, f"{soft}: steps and Gaussians are few", repeat.make_longer())
    looks = wrong or "that looks like wrong poses or a wrong lens"
    return Fault(1, f"{soft}, after many steps: {looks}", mend)


def _describe_accused(repeat: _NextCommand, accused: Mapping[str, str] | None) -> tuple[str, str]:
    """Returns which of poses and lens the check named, "" for none, and what to do about both."""
    advice = f"{format_command(['gsut', 'doctor', repeat.data])}, then {repeat.with_poses()}"
    if accused is None:
        return "", advice
    if accused["subject"] == "poses":
        return f"the poses are wrong: {accused['what']}", advice
    mend = f"{accused['advice']}; then {repeat.as_it_was()}"
    return f"the lens is wrong: {accused['what']}", mend


@dataclasses.dataclass(frozen=True)
class _NextCommand:
    """The command that repeats a training with one change."""

    data: str
    out: str
    options: TrainOptions
    division: Sequence[str]

    def with_poses(self) -> str:
        """Refines the poses, or finds new ones where refining was not enough."""
        if self.options.refine_poses:
            return format_command(["gsut", "poses", self.data, "-o", f"{self.out}-poses"])
        return self._write(["--refine-poses"], "refine_poses")

    def as_it_was(self) -> str:
        return self._write([])

    @property
    def is_short(self) -> bool:
        """Reports whether the longest preset makes more steps than the training made."""
        return self.options.preset != "best" and self.options.steps < PRESETS["best"]["steps"]

    def make_longer(self) -> str:
        if self.is_short:
            return self._write(["--preset", "best"], "preset", "steps")
        return self._write(["--steps", str(2 * self.options.steps)], "steps")

    def _write(self, words: Sequence[str], *but: str) -> str:
        kept = [*self.division, *self.options.list_words(*but)]
        return format_command(["gsut", "train", self.data, "-o", self.out, *kept, *words])
