"""Finds poses of a video without bundle adjustment: a scene of Gaussians grows image by image.

The first images are solved by their features. From then on each image gets the pose from which the
Gaussians look like it (`refine_pose`), and where they do not yet, new Gaussians are placed along
the pixels' rays, at the distance of triangulated points near them. This is CF-3DGS (Fu et al.,
2024) with bearings through the exact lens in place of a depth network. Errors add up along the way,
so that bundle adjustment of features is more accurate if it succeeds.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

from gsut._core import InputError, SolveError
from gsut.run import read_checkpoint, write_checkpoint
from gsut.sfm import PosesLog, PosesOptions, PosesResult, run_mapping, start_mapping
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import require_overlap
from gsut.sfm.photographs import Images
from gsut.sfm.rig import adjust_rig_near_places
from gsut.sfm.solution import OnStep, solve_poses
from gsut.sfm.world import place_on_earth
from gsut.training.video_scene import Video, VideoScene

# Numbers of first images to solve by features, tried in turn: the fewest that give a structure.
_FIRST_IMAGES = (8, 12, 16, 24, 40)
# Rounds over all poses at the end.
_ROUNDS = 3
# Images between writes of the state.
_KEEP_EVERY = 5

_STATE = "growth.npz"  # the stage file, written every few images


def find_video_poses(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    camera: str | os.PathLike[str] | None = None,
    options: PosesOptions | None = None,
    log: PosesLog | None = None,
) -> PosesResult:
    """Estimates poses of the images of a video by their colours, in order of names.

    If interrupted, the same call continues from the last images that were kept, to the same bits.

    Args:
        images, out, camera, options, log: see `find_poses`; the lens must be known and have one
            centre. Pairs are sequential where the options leave them open.

    Returns:
        Poses with the covariances of `refine_pose`, a lower bound; triangulated points.

    Raises:
        InputError: a lens is unknown or has more than one centre, or a rolling shutter.
        SolveError: the first images give no structure.
    """
    options = options or PosesOptions()
    if options.pairs == "auto":
        options = dataclasses.replace(options, pairs="sequential")
    mapping = start_mapping(images, camera, options, log)
    if mapping.shutter is not None:
        raise InputError(
            "--photometric takes every image for one pose, and these have a rolling shutter: "
            "leave it out, or give --shutter global"
        )
    if not mapping.photographs.are_lenses_known:
        raise InputError("--photometric needs a known lens with one centre; give it by --camera")
    return run_mapping(images, out, mapping, _grow_poses)


def _grow_poses(mapping: Mapping, folder: Path) -> Mapping:
    """Registers the images one by one; returns the run with the solution.

    Args:
        folder: holds the state.
    """
    photographs, on_step = mapping.photographs, mapping.log.follow_steps("mapping")
    require_overlap(mapping.images, mapping.pairs, is_lens_known=True)
    video = Video(photographs, photographs.lenses, mapping.features, mapping.pairs, mapping.options)
    kept = _read_kept(folder / _STATE)
    if kept is None:
        growth = VideoScene(video, _solve_first(video, on_step))
        growth.begin()
    else:
        growth = VideoScene(video, kept["first"])
        growth.load_state_dict(kept)

    def show(step: str, to_keep: bool) -> None:
        if to_keep:
            write_checkpoint(folder / _STATE, growth.state_dict())
        on_step(len(growth.posed), len(photographs), len(growth.points.positions), step)

    show("grow", kept is None)
    while growth.next < len(photographs):
        growth.add_next()
        show("grow", growth.next % _KEEP_EVERY == 0)
    while growth.rounds < _ROUNDS:
        growth.refine_all()
        show("all poses", True)
    grown = mapping.replace(solution=growth.make_solution()).add_findings({"shutter": "global"})
    return place_on_earth(grown, adjust_rig_near_places)


def _read_kept(path: Path) -> dict[str, Any] | None:
    """Reads the stored state; None if there is none or the file is damaged, which starts anew."""
    try:
        return read_checkpoint(path) if path.exists() else None
    except InputError:
        return None


def _solve_first(video: Video, on_step: OnStep) -> dict[str, Any]:
    """Solves the first images by their features; returns their poses and how they were found."""
    failure: SolveError | None = None
    for wanted in _FIRST_IMAGES:
        count = min(wanted, len(video.cameras))
        try:
            names = video.photographs.names[:count]
            images = Images(names, video.cameras[:count], video.features[:count])
            own = [pair for pair in video.pairs if pair.second < count]
            found = solve_poses(images, own, video.options, on_step)
            if found.num_registered == count:
                return {
                    "poses": found.camera_from_world,
                    "initial_pair": list(found.initial_pair),
                    "restarts": found.restarts,
                }
        except SolveError as error:
            failure = error
        if count == len(video.cameras):
            break
    raise SolveError(
        f"the first {count} images give no structure to begin with"
        + (f" ({failure})" if failure else "; not all of them could be registered")
        + ": begin the video where the camera moves sideways past something with texture"
    )
