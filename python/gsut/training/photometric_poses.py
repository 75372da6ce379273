"""Finds poses of a video without bundle adjustment: a scene of Gaussians grows image by image.

The first images are solved by their features. From then on each image gets the pose from which the
Gaussians look like it (`refine_pose`), and where they do not yet, new Gaussians are placed along
the pixels' rays, at the distance of triangulated points near them. This is CF-3DGS (Fu et al.,
2024) with bearings through the exact lens in place of a depth network. Errors add up along the way,
so that bundle adjustment of features is more accurate if it succeeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError, SolveError
from gsut.run import RunFolder, read_checkpoint, write_checkpoint
from gsut.sfm import PosesOptions
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features, Images, Photographs
from gsut.sfm.solution import Solution, solve_poses
from gsut.training.video_scene import Video, VideoScene

# Numbers of first images to solve by features, tried in turn: the fewest that give a structure.
_FIRST_IMAGES = (8, 12, 16, 24, 40)
# Rounds over all poses at the end.
_ROUNDS = 3
# Images between writes of the state.
_KEEP_EVERY = 5

OnProgress = Callable[[int, int, int, str], None]


def grow_poses(
    photographs: Photographs,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_progress: OnProgress,
    *,
    keep: Path | None = None,
) -> Solution:
    """Registers the images of a video by their colours, in order of names.

    This is a mapper for `find_poses`.

    Args:
        photographs: of a video, with known lenses of one centre.
        features, pairs: of the images; verified.
        options: seed, max_error and min_angle.
        on_progress: called with (registered, images, points, step).
        keep: a file that holds the state, written every few images: if interrupted, the next call
            continues from there, to the same bits. The caller ensures that it belongs to these
            photographs and options. None: no file.

    Returns:
        Poses with the covariances of `refine_pose`, a lower bound; triangulated points.

    Raises:
        InputError: a lens is unknown or has more than one centre.
        SolveError: the first images give no structure.
    """
    cameras = [c for c in photographs.cameras if c is not None]
    if len(cameras) < len(photographs) or not all(c.is_central for c in cameras):
        raise InputError("--photometric needs a known lens with one centre; give it by --camera")
    video = Video(photographs, cameras, features, pairs, options)
    kept = None if keep is None else _read_kept(keep)
    if kept is None:
        growth = VideoScene(video, _solve_first(video, on_progress))
        growth.begin()
    else:
        growth = VideoScene(video, kept["first"])
        growth.load_state_dict(kept)

    def show(step: str, to_keep: bool) -> None:
        if keep is not None and to_keep:
            RunFolder(keep.parent).write(
                keep.name, lambda path: write_checkpoint(path, growth.state_dict())
            )
        on_progress(len(growth.posed), len(photographs), len(growth.points.positions), step)

    show("grow", kept is None)
    while growth.next < len(photographs):
        growth.add_next()
        show("grow", growth.next % _KEEP_EVERY == 0)
    while growth.rounds < _ROUNDS:
        growth.refine_all()
        show("all poses", True)
    return growth.make_solution()


def _read_kept(path: Path) -> dict[str, Any] | None:
    """Reads the stored state; None if there is none or the file is damaged, which starts anew."""
    try:
        return read_checkpoint(path) if path.exists() else None
    except InputError:
        return None


def _solve_first(video: Video, on_progress: OnProgress) -> dict[str, Any]:
    """Solves the first images by their features; returns their poses and how they were found."""
    failure: SolveError | None = None
    for wanted in _FIRST_IMAGES:
        count = min(wanted, len(video.cameras))
        try:
            names = video.photographs.names[:count]
            images = Images(names, video.cameras[:count], video.features[:count])
            own = [pair for pair in video.pairs if pair.second < count]
            found = solve_poses(images, own, video.options, on_progress)
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
