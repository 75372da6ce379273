"""What a run of `gsut poses` tells on its way, and what a user should know of its result."""

from __future__ import annotations

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


# Of a mapper's time: growing, by a power of the images' share, and the steps that finish, of which
# there are about so many before the last.
_GROWING, _GROWTH_POWER = 0.5, 1.5
_FINISHING = ("settling", "longer tracks")
_FINISHING_STEPS = 4
_LAST = "final adjustment"
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
        """Of a mapper: growing takes half of the time, and finishing the rest."""
        finished = 0

        def show(done: int, total: int, points: int, step: str) -> None:
            nonlocal finished
            finished += step in _FINISHING
            share = _GROWING * (done / max(1, total)) ** _GROWTH_POWER
            if step == _LAST:
                share = 1.0
            elif finished:
                share = _GROWING + (1 - _GROWING) * finished / (_FINISHING_STEPS + finished)
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
