"""After mapping: the shutter of a video, the rig of two lenses, the world of the earth."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from gsut.sfm.core import Features, PairMatches, Photographs, PosesLog, PosesOptions, Solution
from gsut.sfm.lens import LensDoubt, lens_doubt
from gsut.sfm.rig import RigFit, find_lens_pair, scaled_rig
from gsut.sfm.shutter import VideoShutter, find_video_shutter, readout_time
from gsut.sfm.world import find_earth, moved_solution


@dataclasses.dataclass(frozen=True)
class Finished:
    """What `finish_solution` makes of a solution.

    Args:
        solution: the final one.
        doubt: what is open about an estimated lens; None: it was known.
        rig: found for two lenses of one camera, or None.
    """

    solution: Solution
    doubt: LensDoubt | None
    rig: RigFit | None


def finish_solution(
    photographs: Photographs,
    solution: Solution,
    features: list[Features],
    pairs: list[PairMatches],
    options: PosesOptions,
    flags: np.ndarray | None,
    log: PosesLog,
    extra: dict[str, Any],
    folder: Path,
) -> Finished:
    """The solution with the shutter of its video, on a rig where it is one, in the earth's world.

    Args:
        photographs, features, pairs, options: see `estimate_poses`.
        solution: as it was mapped.
        flags: of the parameters of an estimated lens, or None.
        log: told what was found. extra: of poses.json, added to.
        folder: where all will be written.
    """
    lines: VideoShutter | None = None
    unsaid = solution.shutter is None and options.shutter == "auto"
    if unsaid and photographs.flows:  # a video of whose shutter nothing was said
        lines = find_video_shutter(
            solution, features, pairs, options, photographs.flows, flags,
            log.on_readout, log.on_images("shutter"),
        )  # fmt: skip
        solution = lines.solution
        log.note(lines.words())
    doubt: LensDoubt | None = None
    if flags is not None:
        doubt = lens_doubt(solution, flags, pairs, options)
        extra["focal_sigma_percent"] = doubt.percent
    extra |= _shutter_figures(photographs, solution, options, lines)
    rig: RigFit | None = None
    # A rig takes its cameras for still while an image is read.
    if flags is not None and photographs.frames is not None and solution.shutter is None:
        solution, rig, words = find_lens_pair(
            solution, photographs, features, pairs, options, flags, folder,
            log.on_images("rig"),
        )  # fmt: skip
        log.note(words)
    log.show("writing", 0, 1, "")
    earth = find_earth(solution, photographs.orientations, photographs.places)
    if earth is None:
        return Finished(solution, doubt, rig)
    extra["earth"] = earth.figures
    for text in earth.notes:
        log.note(text)
    if rig is not None:
        rig = scaled_rig(rig, earth.scale)
    return Finished(moved_solution(solution, earth), doubt, rig)


def _shutter_figures(
    photographs: Photographs,
    solution: Solution,
    options: PosesOptions,
    lines: VideoShutter | None,
) -> dict[str, Any]:
    """Of poses.json."""
    if lines is not None:
        direction = solution.shutter.direction if solution.shutter else "global"
        return {"shutter": direction, "readout": lines.figures()}
    if solution.shutter is None:
        return {"shutter": "global"}
    found = readout_time(photographs.names, solution)
    return {
        "shutter": solution.shutter.direction,
        "readout": {
            "given": options.readout_time,
            "estimated": found.time if found else None,
            "explained": found.explained if found else None,
        },
    }
