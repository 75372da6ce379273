"""Estimates the poses of photographs: the stages of `gsut poses` in order."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import Shutter, SolveError
from gsut.bounds import name_wrong_kinds
from gsut.data.images import read_header
from gsut.data.rigs import Rig
from gsut.data.scene import capture_state
from gsut.judge.checks import NOT_GOOD
from gsut.output_folder import claim_folder
from gsut.sfm.connection import map_connected
from gsut.sfm.gyroscope import correct_by_turns, find_focal_by_turns, use_gyroscope
from gsut.sfm.lens import (
    free_center,
    guess_lenses,
    judge_lens,
    require_motion,
)
from gsut.sfm.mapping import Mapping, PosesLog
from gsut.sfm.matches import (
    WINDOW,
    PairMatches,
    find_frame_numbers,
    match_images,
    verify_matches,
)
from gsut.sfm.photographs import (
    PosesOptions,
    Stages,
    collect_features,
    digest_key,
    find_photographs,
    mask_fixed_pixels,
    require_central,
)
from gsut.sfm.report import is_finished, rate_poses, read_figures, write_poses
from gsut.sfm.rig import (
    adjust_rig_near_places,
    find_image_lines,
    find_lens_pair,
    find_rig_photographs,
    find_rig_shutter,
    require_features,
)
from gsut.sfm.shutter import find_shutter, is_probably_rolling
from gsut.sfm.solution import (
    Adjustment,
    Solution,
    find_further_models,
    measure_agreement,
    measure_contradiction,
    measure_diagonal,
    separate_look_alikes,
    solve_poses,
)
from gsut.sfm.starts import (
    compare_halves,
    leave_out_contradicted,
    leave_out_look_alikes,
    register_left_out,
    try_other_starts,
)
from gsut.sfm.world import (
    add_markers,
    find_control,
    place_by_control,
    place_by_markers,
    place_on_earth,
)


@dataclasses.dataclass(frozen=True)
class PosesResult:
    """The poses that `find_poses` found and wrote.

    Args:
        path: the output folder.
        solution: poses and points.
        figures: the content of poses.json.
    """

    path: Path
    solution: Solution
    figures: dict[str, Any]

    def __repr__(self) -> str:
        images = f"{self.solution.num_registered} of {len(self.solution.registered)} images"
        return f"PosesResult({str(self.path)!r}, {images})"


@name_wrong_kinds
def find_poses(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    camera: str | os.PathLike[str] | Rig | None = None,
    options: PosesOptions | None = None,
    log: PosesLog | None = None,
) -> PosesResult:
    """Estimates camera poses and sparse points of photographs, without COLMAP, through any lens.

    If interrupted, the same call resumes from the last stage that was finished (features of each
    image, matches). Unreadable images are left out and named in the notes.

    Args:
        images: folder of photographs, or a dataset (its poses are ignored).
        out: output folder: transforms.json, points3D.ply, sparse/0 (COLMAP text), poses.json and
            report.html. Images stay where they are. Images that do not connect with these are
            models of their own in model_2, model_3 ...
        camera: lens file, or a dataset whose lens is used; None: the lens file beside the images,
            or the dataset's own; if there is none the lens is estimated. A known lens is held. The
            name of a lens of the database (see `find_lenses`) is where the estimation starts. Of a
            rig (see `gsut.poses.read_rig`) images holds one folder a camera, the images of one
            frame share one pose of the rig, and all lengths are in its unit; the rig as it was used
            is written to rig.json.
        options: every setting of the search; None: the defaults.
        log: receives progress, notes and expected times.

    Returns:
        The output folder, poses with points, and figures.

    Raises:
        InputError: too few images, wrong lens, a file that cannot be written, or `out` holds what
            `gsut poses` did not write.
        SolveError: nothing could be reconstructed: no overlap, images all the same, or a camera
            that only turned; says which.
    """
    return run_mapping(images, out, start_mapping(images, camera, options, log), _map)


def run_mapping(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    mapping: Mapping,
    find: Callable[[Mapping], Mapping],
) -> PosesResult:
    """Finds features and matches, then poses, and writes everything.

    Args:
        images, out: see `find_poses`.
        mapping: as `start_mapping` returns it.
        find: returns the run with a solution, of one with matches, which are verified where lenses
            are known.

    Raises:
        InputError, SolveError: see `find_poses`.
    """
    with claim_folder(out, "poses", images) as claimed:
        stages = Stages(claimed.path, _make_key(mapping, claimed.path))
        if not mapping.options.keep_all_pixels:
            masked = mask_fixed_pixels(mapping.photographs, claimed.path, mapping.log.note)
            mapping = mapping.replace(photographs=masked)
        with _set_threads(mapping.options.threads):
            mapping = find(_find_matches(mapping, stages))
            mapping.log.watch.record_lap("mapping")
        values = write_poses(mapping, claimed.path, stages.digest)
        stages.remove()
        return PosesResult(claimed.path, mapping.solved, values)


def _map(mapping: Mapping) -> Mapping:
    """Finds poses, points and what is not known of lenses and shutter.

    What a stage may change beside its findings is said behind it, here and in `_find_unknowns`.
    """
    require_motion(mapping)
    mapping = _choose_structure(mapping)
    mapping = place_on_earth(mapping, adjust_rig_near_places)  # solution
    mapping = place_by_control(mapping)  # solution, features
    mapping = place_by_markers(mapping)  # solution
    return _measure_agreement(mapping)


def _choose_structure(mapping: Mapping) -> Mapping:
    """Finds a structure, and where its poses are not good also one with learned features.

    That is taken where it has the same images (SIFT may refuse some) and its poses rate better.
    """
    structures = map_connected(mapping)
    best = _find_unknowns(next(structures))
    rating = rate_poses(best)
    for start in structures if rating else ():
        with contextlib.suppress(SolveError):
            rival = _find_unknowns(start)
            is_same = np.array_equal(rival.solved.registered, best.solved.registered)
            if is_same and rate_poses(rival) < rating:
                best = rival
    if best.log is not mapping.log:
        mapping.log.take_notes(best.log)
    return best.replace(log=mapping.log)


def _find_unknowns(mapping: Mapping) -> Mapping:
    """Finds what the first structure leaves open."""
    connected = mapping.solution
    mapping = correct_by_turns(mapping)  # pairs, solution, turns
    mapping = _separate_places(mapping)  # pairs, solution
    if mapping.solution is not connected:
        mapping = register_left_out(try_other_starts(mapping))  # pairs, solution
    with contextlib.suppress(SolveError):  # too little would be left
        mapping = leave_out_contradicted(mapping)  # pairs, raw matches, solution
    mapping = find_shutter(mapping)  # solution
    mapping = free_center(mapping)  # lens_free, solution
    mapping = use_gyroscope(mapping)  # turns, solution
    mapping = find_focal_by_turns(mapping)  # solution
    mapping = judge_lens(mapping)  # pairs, solution: where the focal length is stated
    mapping = find_lens_pair(mapping)  # lens_free, solution
    mapping = find_rig_shutter(mapping)  # solution
    return compare_halves(mapping)  # findings alone


def _measure_agreement(mapping: Mapping) -> Mapping:
    """Adds to the findings how far matches agree with the poses, and pairs contradict them."""
    solution, pairs = mapping.solved, mapping.pairs
    limit = NOT_GOOD * measure_diagonal(solution.cameras)
    share, lost = measure_contradiction(solution, mapping.features, pairs, limit)
    return mapping.add_findings(
        agreement=measure_agreement(solution, pairs).share,
        contradicted=share,
        contradicted_images={
            solution.names[i]: float(lost[i]) for i in np.argsort(-lost) if lost[i] > 0
        },
    )


def read_finished(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    camera: str | os.PathLike[str] | None = None,
    options: PosesOptions | None = None,
) -> dict[str, Any] | None:
    """Reads poses.json if `find_poses` has finished in `out` with the same arguments, else None.

    Raises:
        InputError: see `find_poses`.
    """
    if not is_finished(Path(out)):
        return None
    key = _make_key(start_mapping(images, camera, options, None), Path(out))
    figures = read_figures(Path(out))
    return figures if figures.get("made_from") == digest_key(key) else None


def start_mapping(
    images: str | os.PathLike[str],
    camera: str | os.PathLike[str] | Rig | None,
    options: PosesOptions | None,
    log: PosesLog | None,
) -> Mapping:
    """Finds the photographs, with their lenses as far as these are known, rig and shutter.

    Args:
        images, camera, options, log: see `find_poses`.

    Raises:
        InputError: see `find_poses`.
    """
    options = options or PosesOptions()
    if isinstance(camera, Rig):
        camera = camera.forget_lenses() if options.unknown_lens else camera
        photographs = find_rig_photographs(Path(images), camera)
    else:
        lens = None if camera is None else Path(camera)
        photographs = find_photographs(Path(images), lens, with_lens=not options.unknown_lens)
    if options.control is not None:
        find_control(options.control, photographs.names)
    require_central(lens for lens in photographs.cameras if lens is not None)
    rig = camera if isinstance(camera, Rig) else None
    shutter, lines = photographs.shutter, None
    if rig is not None and photographs.rig_cameras is not None:
        shutter, lines = find_image_lines(rig, photographs.rig_cameras)
    if options.shutter == "global":
        shutter, lines = None, None
    if options.shutter == "rolling" or options.readout_time is not None:
        shutter = shutter or Shutter(options.readout_direction)
    return Mapping(photographs, options, log or PosesLog(), rig, shutter, lines)


@contextlib.contextmanager
def _set_threads(count: int) -> Iterator[None]:
    """Sets the number of threads for the duration of the block; 0 uses all cores."""
    before = _core.num_threads()
    if count:
        _core.set_num_threads(count)
    try:
        yield
    finally:
        _core.set_num_threads(before if count else 0)


def _make_key(mapping: Mapping, out: Path) -> dict[str, Any]:
    """Lists all that features, matches and poses depend on, as JSON values.

    Args:
        mapping: with the photographs and options.
        out: the folder to which the paths of the photographs are relative.
    """
    photographs, folder = mapping.photographs, os.path.realpath(out)

    def describe(paths: Iterable[Path]) -> list[list[Any]]:
        return [[os.path.relpath(path, folder), *row] for path, *row in capture_state(list(paths))]

    different = list(dict.fromkeys(mask for mask in photographs.masks if mask is not None))
    states = dict(zip(different, describe(different), strict=True))
    frames, control = photographs.frames, mapping.options.control
    return {
        "version": _core.__version__,
        "files": describe(photographs.paths),
        "masks": [mask and states[mask] for mask in photographs.masks],
        "lenses": [repr(camera) for camera in photographs.cameras],
        "shutter": photographs.shutter.direction if photographs.shutter else None,
        "options": dataclasses.asdict(mapping.options),
        "profile": photographs.profile.name if photographs.profile else None,
        **({} if control is None else {"control": describe([Path(control)])}),
        **({} if frames is None else {"frames": frames.tolist()}),
    }


def _find_matches(mapping: Mapping, stages: Stages) -> Mapping:
    """Finds features and matches; verifies the matches where the lenses are known."""
    photographs, options, log = mapping.photographs, mapping.options, mapping.log
    _expect_stages(mapping)
    features = collect_features(photographs, options, log.show, log.note, stages)
    if mapping.rig is not None:
        require_features(photographs, features)
    log.watch.record_lap("features")
    is_lens_known = photographs.are_lenses_known
    mapping = add_markers(mapping.replace(features=features))
    photographs, features = mapping.photographs, mapping.features
    raw = match_images(photographs.names, features, options, log.show, photographs.frames, stages)
    mapping = mapping.replace(raw=raw)
    mapping = mapping.add_findings({"lens": "known" if is_lens_known else "estimated"})
    if is_lens_known:
        pairs = verify_matches(mapping.images, raw, options, log.follow_pairs("verifying"))
        mapping = mapping.replace(pairs=pairs)
    else:
        mapping = mapping.replace(photographs=guess_lenses(photographs, options.fov))
    log.watch.record_lap("matching")
    return mapping


def _expect_stages(mapping: Mapping) -> None:
    """Reports the stages, as far as the files show them."""
    photographs = mapping.photographs
    header = read_header(photographs.paths[0])
    is_video = mapping.shutter is None and mapping.options.shutter == "auto"
    conditions = {
        "lens": not photographs.are_lenses_known,
        "rig": photographs.frames is not None,
        "shutter": is_video and is_probably_rolling(photographs.flows, header.width, header.height),
    }
    stages = ("features", "matching", "lens", "mapping", "rig", "shutter", "writing")
    mapping.log.expect([stage for stage in stages if conditions.get(stage, True)])


def _separate_places(mapping: Mapping) -> Mapping:
    """Separates places that look alike, and reconstructs images that do not connect.

    On a rig looks for such places, but leaves the solution unchanged.
    """
    options, photographs, solution = mapping.options, mapping.photographs, mapping.solved
    times = find_frame_numbers(photographs.names, photographs.frames)
    if mapping.rig is not None:
        alike = separate_look_alikes(solution, mapping.pairs, None, times, WINDOW)[2]
        return mapping.add_findings(look_alikes=alike)

    def solve_again(kept: list[PairMatches]) -> Solution:
        images = dataclasses.replace(mapping.images, cameras=solution.cameras)
        adjustment = Adjustment(mapping.lens_free, lens_settled=mapping.lens_free is not None)
        on_step = mapping.log.follow_steps("mapping")
        return solve_poses(images, kept, options, on_step, adjustment)

    before = len(mapping.pairs)
    separated, pairs, look_alikes = separate_look_alikes(
        solution, mapping.pairs, solve_again, times, WINDOW
    )
    if len(pairs) < before:
        mapping.log.note(
            f"{before - len(pairs)} of {before} pairs of images were left out: they took "
            "places that look alike for one"
        )
    whole = mapping.replace(solution=separated, pairs=pairs)
    mapping = leave_out_look_alikes(whole, look_alikes)
    separated, pairs = mapping.solved, mapping.pairs
    if mapping is not whole:
        look_alikes = separate_look_alikes(separated, pairs, None, times, WINDOW)[2]
    first, models = find_further_models(separated, mapping.features, pairs, options)
    mapping = mapping.replace(solution=first, pairs=pairs)
    return mapping.add_findings(look_alikes=look_alikes, models=models)
