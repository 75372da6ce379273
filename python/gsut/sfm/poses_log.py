"""What a run of `gsut poses` tells on its way, and what a user should know of its result."""

from __future__ import annotations

import collections
from collections.abc import Callable

from gsut.data import some_names
from gsut.run import Stopwatch
from gsut.sfm.correspondences import OnProgress
from gsut.sfm.poses_verdict import LensDoubt
from gsut.sfm.rig import RigFit
from gsut.sfm.solution import Solution

# Share of the matches that must end in points, or the lens is doubted: see matches_in_points.
_FEW_AGREE = 0.6
# The same with a rolling shutter, or the scene has bent (Albl et al., "Degeneracies in rolling
# shutter SfM", ECCV 2016): 0.34 to 0.75 in three such sets of views of helmet_distorted_rs, 0.86
# and more in eight sets that were right (10 to 20 views).
_FEW_AGREE_ROLLING = 0.8


# Of a mapper's time: growing, by a power of the images' share; and so much is over after each of
# the steps that finish, the first of a kind, the second ... By the processor seconds of fifty
# photographs and of a film of 63 frames.
_GROWING, _GROWTH_POWER = 0.36, 1.1
_FINISHED = {
    "settling": (0.43, 0.50, 0.57),
    "longer tracks": (0.58, 0.69),
    "final adjustment": (0.92,),
    "covariances": (1.0,),
}
_PARTS = 1000  # of a stage that a mapper fills


class PosesLog:
    """What a run tells on its way: progress, notes, and the time of each stage."""

    def __init__(
        self,
        on_progress: OnProgress | None = None,
        notes_to: Callable[[str], None] | None = None,
    ) -> None:
        self.notes: list[str] = []
        self.watch = Stopwatch()
        self._on_progress, self._notes_to = on_progress, notes_to
        self._most: dict[str, int] = {}

    def note(self, text: str) -> None:
        self.notes.append(text)
        if self._notes_to is not None:
            self._notes_to(text)

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """Never goes back in a stage: a mapper that begins again is still in the same one."""
        self._most[stage] = max(done, self._most.get(stage, 0))
        if self._on_progress is not None:
            self._on_progress(stage, self._most[stage], total, text)

    def on_pairs(self, stage: str) -> Callable[[int, int], None]:
        return lambda done, total: self.show(stage, done, total, f"{total} pairs")

    def on_share(self, stage: str) -> Callable[[float, str], None]:
        return lambda share, text: self.show(stage, round(_PARTS * share), _PARTS, text)

    def on_images(self, stage: str) -> Callable[[int, int, int, str], None]:
        """Of a mapper, see `_FINISHED`."""
        seen: collections.Counter[str] = collections.Counter()

        def show(done: int, total: int, points: int, step: str) -> None:
            if step in _FINISHED:
                seen[step] += 1
                share = _FINISHED[step][min(seen[step], len(_FINISHED[step])) - 1]
            else:
                share = _GROWING * (done / max(1, total)) ** _GROWTH_POWER
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
