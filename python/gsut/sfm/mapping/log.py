"""Reports progress, notes and stages while poses are estimated."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

from gsut.run import SHARES, Stopwatch
from gsut.sfm.photographs import OnProgress
from gsut.sfm.solution import OnStep

_GROWING_SHARE = 0.5  # of mapping, until all images have a pose
_STEP_SHARE = 0.1  # of what is left of a stage that a finishing step takes


class PosesLog:
    """Keeps the notes and the time of each stage, and reports them with the progress.

    Args:
        on_progress: called with (stage, done, total, text); `done` never falls within a stage.
        on_note: called with each note as it arises.
        on_expected: called with the names of the stages, in order.
    """

    def __init__(
        self,
        on_progress: OnProgress | None = None,
        on_note: Callable[[str], None] | None = None,
        on_expected: Callable[[Sequence[str]], None] | None = None,
    ) -> None:
        self.notes: list[str] = []
        self.watch = Stopwatch()
        self._on_progress, self._on_note, self._on_expected = on_progress, on_note, on_expected
        self._most: dict[str, int] = {}

    def note(self, *texts: str) -> None:
        """Keeps and reports notes, one sentence each."""
        for text in texts:
            self.keep(text)
            if self._on_note is not None:
                self._on_note(text)

    def keep(self, text: str) -> None:
        """Keeps a note for the report alone: nothing need be done about it."""
        self.notes.append(text)

    def copy_quietly(self) -> PosesLog:
        """Returns a log of a trial, whose notes are not reported."""
        trial = copy.copy(self)
        trial.notes, trial._on_note = list(self.notes), None
        return trial

    def take_notes(self, trial: PosesLog) -> None:
        """Replaces the notes by those of a trial, and reports the new ones."""
        kept, found = [note for note in trial.notes if note in self.notes], trial.notes
        self.notes = kept
        self.note(*(note for note in found if note not in kept))

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """Reports progress, which never falls within a stage even if its work starts again."""
        self._most[stage] = max(done, self._most.get(stage, 0))
        if self._on_progress is not None:
            self._on_progress(stage, self._most[stage], total, text)

    def expect(self, stages: Sequence[str]) -> None:
        """Reports the stages that will follow."""
        if self._on_expected is not None:
            self._on_expected(stages)

    def follow_pairs(self, stage: str) -> Callable[[int, int], None]:
        """Returns a function that reports pairs done as the progress of a stage."""
        return lambda done, total: self.show(stage, done, total, f"{total} pairs")

    def show_share(self, stage: str, share: float, text: str) -> None:
        """Reports the share of a stage that is done."""
        self.show(stage, round(SHARES * share), SHARES, text)

    def follow_steps(self, stage: str) -> OnStep:
        """Returns a function that reports the steps of the solver as the progress of a stage."""
        share, before = 0.0, -1

        def show(done: int, total: int, points: int, step: str) -> None:
            nonlocal share, before
            share = max(share, _GROWING_SHARE * done / max(1, total))
            if done <= before:
                share += _STEP_SHARE * (1 - share)
            before = done
            self.show_share(stage, share, f"{done} of {total} images, {points:,} points")

        return show
