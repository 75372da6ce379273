"""Checks of a trained scene, in words for somebody who does not know PSNR."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gsut.judge.checks.check import Check, find_faults
from gsut.run import SceneOptions, TrainOptions, Verdict
from gsut.run.options import PRESETS
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
SHIFT_GAIN = 0.03
# Shares of the pixels that detail leaves out -> what these show.
_LEFT_OUT = {"unseen": "no training view saw", "moving": "moved"}
# Share of the pictures, as somebody far away takes, from which what moved is named.
MOVING = 0.02
# The same from which it is named as a possible cause.
_MAY_MOVE = 0.001
# Gain by corrected colours, in dB, from which differing exposure deserves a note.
_COLORS_DB = 2.0


@dataclasses.dataclass(frozen=True)
class TrainingQuality:
    """What the cause of a soft scene depends on.

    Attributes:
        detail, shifted: of held-out views, see `evaluate`.
        train: detail of training views; None: no other views were measured.
        moving: share of the training pixels that show what moved.
        patch: share of a training view in which far less detail is right than elsewhere, beside
            what moved.
        outside: detail of training views outside it.
        repeat: the training, as a command that repeats it with one change.
        accused: what the check before the training says is wrong; None: nothing.
    """

    detail: float
    shifted: float
    train: float | None
    moving: float
    patch: float
    outside: float
    repeat: NextCommand
    accused: Mapping[str, str] | None

    def has_moved(self) -> bool:
        """Returns whether what moved spoils the scene: most of what moves slowly is not found."""
        return self.moving >= MOVING or (self.moving >= _MAY_MOVE and self.patch > 0)

    def is_lost_between(self) -> bool:
        """Returns whether held-out views lose more than training views have lost."""
        return self.train is not None and self.train - self.detail > 1 - self.train

    def count_lost(self, condition: bool = True) -> float:
        """Returns the share of the detail that is lost, under a condition; else 0."""
        return condition * (1 - self.detail)


@dataclasses.dataclass(frozen=True)
class NextCommand:
    """The command that repeats a training, or the whole scene it is of, with one change."""

    data: str
    out: str
    options: TrainOptions
    division: Sequence[str]
    scene: Mapping[str, Any] | None

    @property
    def is_short(self) -> bool:
        """Reports whether the longest preset makes more steps than the training made."""
        return self.options.preset != "best" and self.options.steps < PRESETS["best"]["steps"]

    def make_longer(self) -> str:
        words, but = ["--preset", "best"], ["preset", "steps"]
        if not self.is_short:
            words, but = ["--steps", str(2 * self.options.steps)], ["steps"]
        if self.scene is None:
            return self.write(words, *but)
        inputs = self.scene["inputs"]
        kept = SceneOptions.from_key(self.scene).list_words(*but)
        return format_command(["gsut", "scene", *inputs, "-o", self.out, *kept, *words])

    def write(self, words: Sequence[str], *but: str) -> str:
        """Writes the training with more words, but for options that these change."""
        if self.scene is not None:
            but = (*but, "test_names")  # chosen for it, as those of another training are
        kept = [*self.division, *self.options.list_words(*but)]
        return format_command(["gsut", "train", self.data, "-o", self.out, *kept, *words])


def _name_wrong(q: TrainingQuality, unknown: str) -> str:
    """Names which of poses and lens the check before accused, or says `unknown`."""
    if q.accused is None:
        return unknown
    what = "lens is" if q.accused["subject"] == "lens" else "poses are"
    return f"the {what} wrong: {q.accused['what']}"


def _choose_step_on_wrong(q: TrainingQuality) -> str:
    """Names a step against wrong poses or a wrong lens."""
    repeat = q.repeat
    if q.accused is not None and q.accused["subject"] == "lens":
        return f"{q.accused['advice']}; then {repeat.write([])}"
    then = repeat.write(["--refine-poses"], "refine_poses")
    if q.accused is not None and repeat.options.refine_poses:  # that has not mended it
        then = format_command(["gsut", "poses", repeat.data, "-o", f"{repeat.out}-poses"])
    return f"{format_command(['gsut', 'doctor', repeat.data])}, then {then}"


def _describe_moved(q: TrainingQuality) -> str:
    where = f" in a patch of {100 * q.patch:.0f} % of the pictures" if q.patch > 0 else ""
    rest = f"{100 * q.outside:.0f} % of the detail of training views is right"
    return f"something moved{where}, and of the rest {rest}"


def _describe_between(q: TrainingQuality) -> str:
    train = q.train or 0.0
    sharp = "sharp" if train >= GOOD else "far sharper"
    cause = "between them are too few photographs"
    cause += ", or something moved" if q.moving >= _MAY_MOVE else ""
    return f"training views are {sharp} ({100 * train:.0f} % of their detail): {cause}"


def _describe_soft(q: TrainingQuality) -> str:
    return f"training views are soft, too ({100 * (q.train or 0.0):.0f} % of their detail)"


# The first that explains the lost detail is the cause.
TRAINING_CHECKS: tuple[Check[TrainingQuality], ...] = (
    Check(
        "shift", lambda q: q.count_lost(q.shifted > q.detail + SHIFT_GAIN), 1 - GOOD, 1 - POOR,
        lambda q: f"renders stand beside their photographs (shifted, {100 * q.shifted:.0f} % of "
        f"the detail is right): {_name_wrong(q, 'poses or the lens are wrong')}",
        _choose_step_on_wrong,
    ),
    Check(
        "movers", lambda q: q.count_lost(q.has_moved()), 1 - GOOD, 1 - POOR, _describe_moved,
        "photograph again while nothing moves",
    ),
    Check(
        "between photographs", lambda q: q.count_lost(q.is_lost_between()), 1 - GOOD, 1 - POOR,
        _describe_between,
        lambda q: "photograph more from between the places there are"
        + (", while nothing moves" if q.moving >= _MAY_MOVE else ""),
    ),
    Check(
        "length", lambda q: q.count_lost(q.train is None or q.repeat.is_short), 1 - GOOD, 1 - POOR,
        lambda q: ("" if q.train is None else f"{_describe_soft(q)}: ")
        + "steps and Gaussians are few",
        lambda q: q.repeat.make_longer(),
    ),
    Check(
        "detail", lambda q: q.count_lost(), 1 - GOOD, 1 - POOR,
        lambda q: f"{_describe_soft(q)}, after many steps: "
        + _name_wrong(q, "that looks like wrong poses or a wrong lens"),
        _choose_step_on_wrong,
    ),
)  # fmt: skip


def _list_notes(metrics: Mapping[str, Any]) -> Iterator[str]:
    """Yields what is said beside the cause, and lowers nothing."""
    moving, corrected = metrics.get("moving_train", 0.0), metrics.get("psnr_color_corrected")
    if moving > MOVING:
        yield (
            f"{100 * moving:.1f} % of the training pixels show what moved past, or what no other "
            "photograph shows, and were left out"
        )
    least = metrics["detail_min"]
    if _name_level(least) != _name_level(metrics["detail_median"]):
        yield f"{metrics['least_detailed']} is worst, with {100 * least:.0f} % of its detail"
    if corrected is not None and corrected - metrics["psnr"] > _COLORS_DB:
        yield (
            f"brightness or colours differ from the photographs ({corrected:.1f} dB with colours "
            "corrected): exposure, white balance, or fog in a sky"
        )


def judge_training(
    metrics: dict[str, Any],
    data: str,
    run: str,
    options: TrainOptions | None = None,
    division: Sequence[str] = (),
    accused: Mapping[str, str] | None = None,
    scene: Mapping[str, Any] | None = None,
) -> Verdict:
    """Judges a training by how much of the detail of its held-out views is right.

    Args:
        metrics: of metrics.json: psnr, psnr_color_corrected, detail_median, detail_min,
            least_detailed, detail_shifted_median, detail_train, unseen, moving, moving_train,
            patch_train, detail_outside_train, steps, evaluated_on, refinement.
        data, run: the dataset's and the run's path, for the next command.
        options: that the run was made with, which the next command keeps; None: the defaults.
        division: words of the command line that divided it into blocks.
        accused: what the check before the training says is wrong: subject, "poses" or "lens",
            what and advice; None: nothing.
        scene: "inputs" and settings of the `gsut scene` that trained; None: `gsut train` did.
    """
    if metrics.get("psnr") is None:
        return Verdict("usable", "no view was held out, so nothing was measured")
    detail, options = metrics["detail_median"], options or TrainOptions()
    was_refined = accused is not None and getattr(options, f"refine_{accused['subject']}")
    mending = [_describe_mending(metrics, accused["what"])] if accused and was_refined else []
    quality = TrainingQuality(
        detail=detail,
        shifted=metrics.get("detail_shifted_median", detail),
        train=metrics.get("detail_train"),
        moving=metrics.get("moving_train", 0.0),
        patch=metrics.get("patch_train", 0.0),
        outside=metrics.get("detail_outside_train", metrics.get("detail_train", 0.0)),
        repeat=NextCommand(data, f"{run}-2", options, division, scene),
        accused=None if was_refined and _find_tracks(metrics)["refined"] else accused,
    )
    causes = find_faults(TRAINING_CHECKS, quality)[:1]
    reasons = [*(fault.what for fault in causes), *mending, *_list_notes(metrics)]
    advice = causes[0].advice if causes else format_command(["gsut", "view", run])
    level = Verdict.LEVELS[causes[0].severity if causes else 0]
    return Verdict(level, _describe(metrics), tuple(reasons), advice)


def _find_tracks(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what tracks of features did to poses and lens; "refined": in how many views."""
    return {"refined": 0, **metrics.get("refinement", {}).get("tracks", {})}


def _describe_mending(metrics: Mapping[str, Any], wrong: str) -> str:
    """Describes what refinement did to what the check before found wrong."""
    tracks, found = _find_tracks(metrics), f"the check before the training found that {wrong}"
    if not tracks["refined"]:
        return f"{found}; that was not mended: {tracks.get('note', 'nothing was refined')}"
    focal = tracks.get("focal_percent")
    lens = "" if focal is None else f", the focal length changed by {focal:+.1f} %"
    return (
        f"{found}; tracks of features mended that: the poses of {tracks['refined']} views turned "
        f"by {tracks['turned_degrees']:.2g} degrees and moved by {tracks['moved']:.2g} units "
        f"(median){lens}, and observations are {tracks['error_px']:.2f} px off"
    )


def _describe(metrics: Mapping[str, Any]) -> str:
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
        f"right in the median view (PSNR {metrics['psnr']:.1f} dB{''.join(apart)})"
    )


def _name_level(detail: float) -> str:
    """Names the level of a share of the detail."""
    return "good" if detail >= GOOD else "usable" if detail >= POOR else "poor"
