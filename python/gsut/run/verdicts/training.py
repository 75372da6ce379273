"""Judges a trained scene, in words for somebody who does not know PSNR."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Any

from gsut.run.options import PRESETS, TrainOptions
from gsut.run.verdicts.verdict import Verdict

# PSNR in dB of held-out views from which a scene is good, and below which it is poor.
_GOOD_DB = 27.0
_POOR_DB = 22.0
# PSNR in dB -> what renders look like beside photographs from there on.
_LOOKS = (
    (32.0, "almost like the photographs"),
    (28.0, "sharp, with small differences"),
    (24.0, "recognisable, fine detail is soft"),
    (20.0, "blurred or doubled in places"),
    (0.0, "smeared, only coarse shapes are right"),
)
# Landmarks of the same scale, for the reader of a verdict.
_SCALE = ((20, "is smeared"), (25, "soft"), (30, "sharp"), (35, "nearly the photograph"))
# Below this number of steps a poor result is not yet the data's fault.
_FEW_STEPS = 400
# Training views that fit no better than this above held-out ones mean wrong poses or a wrong lens.
_NO_BETTER_DB = 3.0
# Training views that fit better than this above held-out ones mean too few photographs.
_OVERFITTED_DB = 6.0
# Gain by corrected colours from which differing exposure deserves a note.
_COLORS_DB = 2.0
# Distance of the worst view below the mean from which it deserves a note.
_WORST_DB = 8.0


def judge_training(
    metrics: dict[str, Any],
    data: str,
    run: str,
    options: TrainOptions | None = None,
    division: Sequence[str] = (),
) -> Verdict:
    """Judges a training by its held-out views.

    Args:
        metrics: of metrics.json: psnr, psnr_train, psnr_color_corrected, psnr_min, worst_view,
            ssim, steps, evaluated_on.
        data, run: the dataset's and the run's path, for the next command.
        options: that the run was made with, which the next command keeps; None: the defaults.
        division: words of the command line that divided it into blocks.
    """
    psnr = metrics.get("psnr")
    if psnr is None:
        return Verdict("usable", "no view was held out, so nothing was measured")
    looks = next(text for least, text in _LOOKS if psnr >= least or least == 0.0)
    what = f"renders of {metrics['evaluated_on']} are {looks} (PSNR {psnr:.1f} dB"
    what += f"; {', '.join(f'{least} dB {words}' for least, words in _SCALE)})"
    level = "good" if psnr >= _GOOD_DB else "usable" if psnr >= _POOR_DB else "poor"
    reasons = _list_reasons(metrics, psnr)
    repeat = _NextCommand(data, f"{run}-2", options or TrainOptions(), division)
    return Verdict(level, what, tuple(reasons), _give_advice(level, reasons, repeat, run))


_POSES = "that looks like wrong poses or a wrong lens"
_STEPS = "steps are few"


def _list_reasons(metrics: dict[str, Any], psnr: float) -> list[str]:
    found = []
    train, corrected = metrics.get("psnr_train"), metrics.get("psnr_color_corrected")
    if psnr < _GOOD_DB and metrics["steps"] < _FEW_STEPS:
        found.append(f"{metrics['steps']} {_STEPS}")
    elif psnr < _POOR_DB and train is not None and train < psnr + _NO_BETTER_DB:
        found.append(f"training views fit no better, at {train:.1f} dB: {_POSES}")
    if train is not None and psnr < _GOOD_DB and train > psnr + _OVERFITTED_DB:
        found.append(
            f"training views fit at {train:.1f} dB: there are too few photographs around the "
            "held-out ones, or the poses of these are wrong"
        )
    if corrected is not None and corrected > psnr + _COLORS_DB:
        found.append(
            f"exposure or white balance differ between the photographs ({corrected:.1f} dB with "
            "colours corrected)"
        )
    worst = metrics.get("psnr_min")
    if worst is not None and worst < psnr - _WORST_DB:
        found.append(f"{metrics['worst_view']} is far worse than the others, {worst:.1f} dB")
    return found


@dataclasses.dataclass(frozen=True)
class _NextCommand:
    """The command that repeats a training with one change."""

    data: str
    out: str
    options: TrainOptions
    division: Sequence[str]

    def with_poses(self) -> str:
        return self._write(["--refine-poses"], "refine_poses")

    def make_longer(self) -> str:
        best, steps = PRESETS["best"]["steps"], self.options.steps
        if steps < best:
            return self._write(["--preset", "best"], "preset", "steps")
        return self._write(["--steps", str(2 * steps)], "steps")

    def _write(self, words: Sequence[str], *but: str) -> str:
        kept = [*self.division, *self.options.list_words(*but)]
        return shlex.join(["gsut", "train", self.data, "-o", self.out, *kept, *words])


def _give_advice(level: str, reasons: list[str], repeat: _NextCommand, run: str) -> str:
    if any(_POSES in reason for reason in reasons):
        return f"{shlex.join(['gsut', 'doctor', repeat.data])}, then {repeat.with_poses()}"
    if level == "good":
        return shlex.join(["gsut", "view", run])
    if any("held-out ones" in reason for reason in reasons):
        return "photograph more from between the places there are"
    return repeat.make_longer()
