"""States what a user should know about the poses that were found."""

from __future__ import annotations

from gsut.data import list_some
from gsut.sfm.core import Solution
from gsut.sfm.lens import LensDoubt
from gsut.sfm.rig import RigFit

# Share of the matches that must end in points, or the lens is doubted: see matches_in_points.
_FEW_AGREE = 0.6
# The same with a rolling shutter, or the scene has bent (Albl et al., "Degeneracies in rolling
# shutter SfM", ECCV 2016): 0.34 to 0.75 in three such sets of views of helmet_distorted_rs, 0.86
# and more in eight sets that were right (10 to 20 views).
_FEW_AGREE_ROLLING = 0.8


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
            f"pose: {list_some(solution.unregistered_names())}"
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
