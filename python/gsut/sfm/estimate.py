"""Photographs and a lens in, poses and points out: the stages of `gsut poses` in order."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError, Shutter
from gsut.data import some_names
from gsut.files import write_file
from gsut.sfm.features import Features, find_all_features, no_features
from gsut.sfm.inputs import Photographs, find_photographs
from gsut.sfm.lens_search import LensSearch, first_guess, search_lens
from gsut.sfm.matching import PairMatches, RawMatches, match_in_full, preview_pairs, verify
from gsut.sfm.options import PosesOptions
from gsut.sfm.output import FIGURES, TRANSFORMS, figures, write_dataset
from gsut.sfm.overlap import require_overlap
from gsut.sfm.pairs import choose_pairs
from gsut.sfm.readout import readout_time
from gsut.sfm.report import REPORT, write_report
from gsut.sfm.rig import COVARIANCE_OF, RigFit, refuse_beside_rig, solve_rig
from gsut.sfm.rig_file import Rig, read_rig, write_rig
from gsut.sfm.rig_images import find_rig_photographs
from gsut.sfm.solution import Solution, matches_in_points, solve
from gsut.sfm.stages import Stages

RIG = "rig.json"
# Share of the matches that must end in points, or the lens is doubted: see matches_in_points.
_FEW_AGREE = 0.6
# The same with a rolling shutter, or the scene has bent (Albl et al., "Degeneracies in rolling
# shutter SfM", ECCV 2016): 0.34 to 0.75 in three such sets of views of helmet_distorted_rs, 0.86
# and more in eight sets that were right (10 to 20 views).
_FEW_AGREE_ROLLING = 0.8
# Told (stage, done, total, text) as the work goes on.
OnProgress = Callable[[str, int, int, str], None]
# (photographs, features, pairs, options, on_progress) -> poses and points; lenses are known.
Mapper = Callable[
    [
        Photographs,
        list[Features],
        list[PairMatches],
        PosesOptions,
        Callable[[int, int, int, str], None],
    ],
    Solution,
]


@dataclasses.dataclass(frozen=True)
class PosesResult:
    """What `estimate_poses` found and wrote.

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


def estimate_poses(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    camera: str | os.PathLike[str] | None = None,
    unknown_lens: bool = False,
    fov_degrees: float | None = None,
    options: PosesOptions | None = None,
    mapper: Mapper | None = None,
    rig: str | os.PathLike[str] | None = None,
    refine_rig: bool = False,
    on_progress: OnProgress | None = None,
    notes_to: Callable[[str], None] | None = None,
) -> PosesResult:
    """Camera poses and sparse points of photographs, without COLMAP, through any lens.

    Killed at any moment, the same call goes on from the last stage that was finished (features of
    each image, matches). Unreadable images are left out and named in the notes.

    Args:
        images: folder of photographs, or a dataset (its poses are not looked at).
        out: output folder: transforms.json, points3D.ply, sparse/0 (COLMAP text), poses.json and
            report.html. Images stay where they are.
        camera: lens file, or a dataset whose lens is used; None: the lens file beside the images,
            or the dataset's own; if there is none the lens is estimated.
        unknown_lens: estimate the lens even where one lies beside the images.
        fov_degrees: rough horizontal field of view, for an unknown lens; None: several are tried.
        options: every setting of the search; None: the defaults.
        mapper: makes poses of verified pairs where the lens is known; None: incremental, with
            bundle adjustment.
        rig: file of a rig (see `rig_file.read_rig`): images then holds one folder a camera, images
            of one moment share one pose of the rig, and all is in its unit. rig.json, the rig as
            it was used, is written too.
        refine_rig: the cameras' poses on the rig are adjusted; its size stays.
        on_progress: told (stage, done, total, text).
        notes_to: told each note as it arises (an image left out, say).

    Returns:
        The output folder, poses with points, and figures.

    Raises:
        InputError: too few images, wrong lens, or a file that cannot be written.
        SolveError: nothing could be reconstructed: no overlap, images all the same, or a camera
            that only turned; says which.
    """
    options = options or PosesOptions()
    show = on_progress or (lambda stage, done, total, text: None)
    folder = Path(out)
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        if notes_to is not None:
            notes_to(text)

    on_rig: Rig | None = None
    if rig is not None:
        others = {"camera": camera, "unknown-lens": unknown_lens, "photometric": mapper}
        refuse_beside_rig(options, others)
        on_rig = read_rig(rig)
        photographs = find_rig_photographs(Path(images), on_rig)
    else:
        photographs = find_photographs(Path(images), None if camera is None else Path(camera))
    if unknown_lens:
        photographs = dataclasses.replace(photographs, cameras=[None] * len(photographs))
    known = all(c is not None for c in photographs.cameras)
    folder.mkdir(parents=True, exist_ok=True)
    stages = Stages(folder, _key(photographs, options, fov_degrees))
    seconds: dict[str, float] = {}
    cpu_seconds: dict[str, float] = {}  # of all threads
    watch = time.perf_counter(), time.process_time()

    def lap(stage: str) -> None:
        nonlocal watch
        now = time.perf_counter(), time.process_time()
        seconds[stage] = seconds.get(stage, 0.0) + now[0] - watch[0]
        cpu_seconds[stage] = cpu_seconds.get(stage, 0.0) + now[1] - watch[1]
        watch = now

    before = _core.num_threads()
    if options.threads:
        _core.set_num_threads(options.threads)
    try:
        shutter = _shutter(photographs, options)
        if shutter is not None and mapper is not None:
            raise InputError(
                "--photometric takes every image for one pose, and these have a rolling shutter: "
                "leave it out, or give --shutter global"
            )
        features = _features(photographs, options, stages, show, note)
        lap("features")
        if not known:
            photographs = first_guess(photographs, fov_degrees)
        raw = _matches(photographs, features, options, stages, show)
        lenses = [camera for camera in photographs.cameras if camera is not None]
        pairs = verify(
            features, lenses, raw, options,
            lambda done, total: show("verifying", done, total, f"{total} pairs"), shutter,
        )  # fmt: skip
        lap("matching")
        require_overlap(photographs.names, features, pairs)
        search: LensSearch | None = None
        fit: RigFit | None = None
        if known:
            run = mapper or functools.partial(_incremental, shutter=shutter)
            told = functools.partial(_told, show)
            if on_rig is not None:
                solution, fit = solve_rig(
                    photographs, features, pairs, options, told("mapping"), told("rig"),
                    rig=on_rig, adjust=refine_rig,
                )  # fmt: skip
            else:
                solution = run(photographs, features, pairs, options, told("mapping"))
        else:
            search = search_lens(
                photographs, features, pairs, raw, options, fov_degrees, show, shutter
            )
            solution = search.solution
        lap("mapping")
    finally:
        _core.set_num_threads(before if options.threads else 0)
    for text in fit.notes if fit is not None else []:
        note(text)
    if solution.num_registered < len(photographs):
        note(
            f"{solution.num_registered} of {len(photographs)} images were registered; without a "
            f"pose: {some_names(solution.unregistered_names())}"
        )
    agreeing = None
    if mapper is None:
        agreeing = matches_in_points(solution, pairs if search is None else search.pairs)
        for text in _doubts(agreeing, known=known, rolling=shutter is not None):
            note(text)
    for text in write_dataset(solution, photographs, folder):
        note(text)
    extra: dict[str, Any] = {"lens": "known" if known else "estimated", "cpu_seconds": cpu_seconds}
    if search is not None:
        extra["lens_search"] = search.rows
    extra["matches_in_points"] = agreeing
    extra["shutter"] = solution.shutter.direction if solution.shutter else "global"
    if solution.shutter is not None:
        found = readout_time(photographs.names, solution)
        extra["readout"] = {
            "given": options.readout_time,
            "estimated": found.time if found else None,
            "explained": found.explained if found else None,
        }
    if fit is not None:
        extra.update(rig=fit.figures, covariance_of=COVARIANCE_OF)
        write_rig(fit.rig, folder / RIG)
    lap("writing")
    cpu_seconds["total"] = sum(cpu_seconds.values())
    values = figures(solution, seconds, notes, extra)
    write_report(folder, solution, values)
    write_file(folder / FIGURES, json.dumps(values, indent=1) + "\n")
    stages.remove()
    return PosesResult(folder, solution, values)


def _doubts(agreeing: float, *, known: bool, rolling: bool) -> list[str]:
    """What so few matches that agree in all images together mean, if anything."""
    share = (
        f"only {100 * agreeing:.0f} % of the matches that agree pair by pair agree in all images "
        "together; "
    )
    if rolling and agreeing < _FEW_AGREE_ROLLING:
        lens = "the lens is not that of the images, or " if known else ""
        return [
            share + lens + "the scene has bent with the motion during the readout, which few "
            "images held alike cannot tell apart: add images, some turned by 90 degrees about the "
            "axis of the lens, or give --readout-time for a video"
        ]
    if known and agreeing < _FEW_AGREE:
        return [
            share + "the lens is probably not that of the images: check it, or let it be "
            "estimated with --unknown-lens"
        ]
    return []


def _incremental(
    photographs: Photographs,
    features: list[Features],
    pairs: list[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    *,
    shutter: Shutter | None,
) -> Solution:
    cameras = [c for c in photographs.cameras if c is not None]
    return solve(photographs.names, cameras, features, pairs, options, on_progress, shutter=shutter)


def _key(photographs: Photographs, options: PosesOptions, fov: float | None) -> dict[str, Any]:
    """All that features and matches depend on."""
    files = []
    for path in photographs.paths:
        state = path.stat()
        files.append([str(path.resolve()), state.st_size, state.st_mtime_ns])
    return {
        "version": _core.__version__,
        "files": files,
        "masks": [str(mask) for mask in photographs.masks],
        "lenses": [repr(camera) for camera in photographs.cameras],
        "shutter": photographs.shutter.direction if photographs.shutter else None,
        "options": dataclasses.asdict(options),
        "fov": fov,
        **({} if photographs.moments is None else {"moments": photographs.moments.tolist()}),
    }


def _shutter(photographs: Photographs, options: PosesOptions) -> Shutter | None:
    """The rolling shutter of the images, or None."""
    if options.shutter == "global":
        if options.readout_time is not None:
            raise InputError("--shutter global and --readout-time contradict each other: drop one")
        return None
    if photographs.shutter is not None:
        return photographs.shutter
    if options.shutter == "rolling" or options.readout_time is not None:
        return Shutter(options.readout_direction)
    return None


def _features(
    photographs: Photographs,
    options: PosesOptions,
    stages: Stages,
    show: OnProgress,
    note: Callable[[str], None],
) -> list[Features]:
    """Of all images, from the stage files where they are there; none of unreadable ones."""
    found = [stages.load_features(i) for i in range(len(photographs))]
    absent = [i for i, features in enumerate(found) if features is None]
    done = len(photographs) - len(absent)
    show("features", done, len(photographs), "")
    broken: list[int] = []
    first_error = ""

    def on_image(place: int, features: Features | None, error: Exception | None) -> None:
        nonlocal done, first_error
        index = absent[place]
        if features is None:
            broken.append(index)
            first_error = first_error or str(error)
            note(f"left out: {error}")
            features = no_features()
        else:
            stages.save_features(index, features)
        found[index] = features
        done += 1
        show("features", done, len(photographs), f"{len(features):,} in {photographs.names[index]}")

    find_all_features(
        [photographs.paths[i] for i in absent],
        [photographs.cameras[i] for i in absent],
        [photographs.masks[i] for i in absent],
        options,
        on_image,
    )
    features = [f for f in found if f is not None]
    if len(photographs) - len(broken) < 2:
        raise InputError(
            f"{len(photographs) - len(broken)} of {len(photographs)} images can be used, and poses "
            f"need at least 2 that overlap; {first_error}"
        )
    return features


def _matches(
    photographs: Photographs,
    features: list[Features],
    options: PosesOptions,
    stages: Stages,
    show: OnProgress,
) -> RawMatches:
    """Of all pairs that look alike, from the stage file where it is there."""
    kept = stages.load_matches()
    if kept is not None:
        return kept
    pairs = choose_pairs(photographs.names, features, options, photographs.moments)
    pairs = preview_pairs(
        features, pairs, options,
        lambda done, total: show("preview", done, total, f"{total} pairs"),
    )  # fmt: skip
    raw = match_in_full(
        features, pairs, options,
        lambda done, total: show("matching", done, total, f"{total} pairs"),
    )  # fmt: skip
    stages.save_matches(raw)
    return raw


def is_finished(out: Path) -> bool:
    """Whether a folder holds the result of a finished run."""
    return (out / FIGURES).is_file() and (out / TRANSFORMS).is_file() and (out / REPORT).is_file()


def _told(show: OnProgress, stage: str) -> Callable[[int, int, int, str], None]:
    """What a mapper tells, shown as a stage's progress."""
    return lambda done, total, points, step: show(stage, done, total, f"{points:,} points")
