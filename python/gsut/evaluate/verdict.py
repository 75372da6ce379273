"""How good a trained scene is, in words for somebody who does not know PSNR."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Any

from gsut.run import TrainOptions, Verdict
from gsut.run.options import PRESETS

_GOOD_DB, _POOR_DB = 27.0, 22.0
# What renders look like beside photographs, from so many dB of PSNR on.
_LOOKS = (
    (32.0, "hard to tell from the photographs"),
    (28.0, "sharp, with small differences"),
    (24.0, "recognisable, fine detail is soft"),
    (20.0, "blurred or doubled in places"),
    (0.0, "smeared, only coarse shapes are right"),
)
_FEW_STEPS = 400
_NO_BETTER_DB = 3.0  # training views that fit no better than this over held-out ones
_OVERFITTED_DB = 6.0
_COLORS_DB = 2.0
_WORST_DB = 8.0


def train_verdict(
    metrics: dict[str, Any],
    data: str,
    run: str,
    options: TrainOptions | None = None,
    division: Sequence[str] = (),
) -> Verdict:
    """The verdict of a training.

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
    what += "; 20 dB is smeared, 25 dB soft, 30 dB sharp, 35 dB nearly the photograph)"
    level = "good" if psnr >= _GOOD_DB else "usable" if psnr >= _POOR_DB else "poor"
    reasons = list(_reasons(metrics, psnr))
    again = _Again(data, f"{run}-2", options or TrainOptions(), division)
    return Verdict(level, what, tuple(reasons), _advice(level, reasons, again, run))


_POSES = "that looks like wrong poses or a wrong lens"
_STEPS = "steps are few"


def _reasons(metrics: dict[str, Any], psnr: float) -> list[str]:
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
class _Again:
    """The command that makes a run as another was made, but for what it shall have otherwise."""

    data: str
    out: str
    options: TrainOptions
    division: Sequence[str]

    def with_poses(self) -> str:
        return self._with(["--refine-poses"], "refine_poses")

    def longer(self) -> str:
        best, steps = PRESETS["best"]["steps"], self.options.steps
        if steps < best:
            return self._with(["--preset", "best"], "preset", "steps")
        return self._with(["--steps", str(2 * steps)], "steps")

    def _with(self, words: Sequence[str], *but: str) -> str:
        kept = [*self.division, *self.options.list_words(*but)]
        return shlex.join(["gsut", "train", self.data, "-o", self.out, *kept, *words])


def _advice(level: str, reasons: list[str], again: _Again, run: str) -> str:
    if any(_POSES in reason for reason in reasons):
        return f"{shlex.join(['gsut', 'doctor', again.data])}, then {again.with_poses()}"
    if level == "good":
        return shlex.join(["gsut", "view", run])
    if any("held-out ones" in reason for reason in reasons):
        return "photograph more from between the places there are"
    return again.longer()
