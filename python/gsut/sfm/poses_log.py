"""What a run of `gsut poses` tells on its way, and what a user should know of its result."""

from __future__ import annotations

import collections
import dataclasses
import os
from collections.abc import Callable
from typing import Any

from gsut.data import some_names
from gsut.run import Stopwatch
from gsut.sfm.correspondences import OnProgress
from gsut.sfm.options import PosesOptions
from gsut.sfm.poses_verdict import LensDoubt
from gsut.sfm.rig import RigFit
from gsut.sfm.solution import Solution
from gsut.sfm.time_left import PosesWork

# Share of the matches that must end in points, or the lens is doubted: see matches_in_points.
_FEW_AGREE = 0.6
# The same with a rolling shutter, or the scene has bent (Albl et al., "Degeneracies in rolling
# shutter SfM", ECCV 2016): 0.34 to 0.75 in three such sets of views of helmet_distorted_rs, 0.86
# and more in eight sets that were right (10 to 20 views).
_FEW_AGREE_ROLLING = 0.8


# Of a mapper's time: growing, more where it is simpler to finish, by a power of the images' share;
# and of the rest so much is over after each of the steps that finish, the first of a kind, the
# second ... By the processor seconds of twelve runs of six captures.
_GROWING, _GROWING_UNKNOWN, _GROWING_ROLLING, _GROWTH_POWER = 0.41, 0.33, 0.45, 1.15
_FINISHED = {
    "settling": (0.14, 0.27, 0.38),
    "longer tracks": (0.39, 0.60),
    "final adjustment": (0.91,),
    "covariances": (1.0,),
}
_PARTS = 1000  # of a stage that a mapper fills


class PosesLog:
    """What a run tells on its way: progress, notes, and the time of each stage."""

    def __init__(
        self,
        on_progress: OnProgress | None = None,
        notes_to: Callable[[str], None] | None = None,
        on_expected: Callable[[dict[str, float]], None] | None = None,
    ) -> None:
        self.notes: list[str] = []
        self.watch = Stopwatch()
        self._on_progress, self._notes_to = on_progress, notes_to
        self._on_expected = on_expected
        self._work: PosesWork | None = None
        self._threads = 1
        self._most: dict[str, int] = {}

    def note(self, *texts: str) -> None:
        for text in texts:
            self.notes.append(text)
            if self._notes_to is not None:
                self._notes_to(text)

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """Never goes back in a stage: a mapper that begins again is still in the same one."""
        if stage == "shutter" and stage not in self._most:
            self.learn(lines=True)
        self._most[stage] = max(done, self._most.get(stage, 0))
        if self._on_progress is not None:
            self._on_progress(stage, self._most[stage], total, text)

    def expect(self, work: PosesWork, options: PosesOptions) -> None:
        """Tells what the stages will take."""
        self._work, self._threads = work, options.threads or len(os.sched_getaffinity(0))
        self.learn()

    def learn(self, **known: Any) -> None:
        """The same, now that these fields of `PosesWork` are known."""
        if self._work is not None:
            self._work = dataclasses.replace(self._work, **known)
            if self._on_expected is not None:
                self._on_expected(self._work.seconds(self._threads))

    def on_pairs(self, stage: str) -> Callable[[int, int], None]:
        return lambda done, total: self.show(stage, done, total, f"{total} pairs")

    def on_share(self, stage: str) -> Callable[[float, str], None]:
        return lambda share, text: self.show(stage, round(_PARTS * share), _PARTS, text)

    def on_images(self, stage: str) -> Callable[[int, int, int, str], None]:
        """Of a mapper, see `_FINISHED`."""
        seen: collections.Counter[str] = collections.Counter()
        growing = _GROWING
        if self._work is not None and not self._work.known:
            growing = _GROWING_UNKNOWN
        if self._work is not None and self._work.rolling:
            growing = _GROWING_ROLLING

        def show(done: int, total: int, points: int, step: str) -> None:
            if step in _FINISHED:
                seen[step] += 1
                finished = _FINISHED[step][min(seen[step], len(_FINISHED[step])) - 1]
                share = growing + (1 - growing) * finished
            else:
                share = growing * (done / max(1, total)) ** _GROWTH_POWER
            words = f"{done} of {total} images, {points:,} points"
            self.show(stage, round(_PARTS * share), _PARTS, words)

        return show


def solution_notes(
    solution: Solution,
    agreeing: float | None,
    fit: RigFit | None,
    doubt: LensDoubt | None = None,
    *,
    known: bool,
) -> list[str]:
    """What a user should know of the poses, one sentence each."""
    notes = list(fit.notes) if fit is not None else []
    if solution.num_registered < len(solution.names):
        notes.append(
            f"{solution.num_registered} of {len(solution.names)} images were registered; without a "
            f"pose: {some_names(solution.unregistered_names())}"
        )
    open_lens = doubt.words() if doubt is not None else None
    if open_lens is not None:
        notes.append(open_lens)
    if agreeing is None:
        return notes
    share = (
        f"only {100 * agreeing:.0f} % of the matches that agree pair by pair agree in all images "
        "together; "
    )
    if solution.shutter is not None and agreeing < _FEW_AGREE_ROLLING:
        lens = "the lens is not that of the images, or " if known else ""
        notes.append(
            share + lens + "the scene has bent with the motion during the readout, which few "
            "images held alike cannot tell apart: add images, some turned by 90 degrees about the "
            "axis of the lens, or give --readout-time for a video"
        )
    elif solution.shutter is None and known and agreeing < _FEW_AGREE:
        notes.append(
            share + "the lens is probably not that of the images: check it, or let it be "
            "estimated with --unknown-lens"
        )
    return notes
