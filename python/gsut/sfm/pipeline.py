"""Photographs and a lens in, poses and points out: the stages of `gsut poses` in order."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError, Shutter, SolveError
from gsut.data.images import read_header
from gsut.data.rigs import Rig, read_rig, write_rig
from gsut.files import write_file
from gsut.output_folder import claim_folder
from gsut.sfm.core import (
    Features,
    OnProgress,
    PairMatches,
    Photographs,
    PosesLog,
    PosesOptions,
    Solution,
    Stages,
    ToldApart,
    collect_features,
    digest,
    find_look_alikes,
    find_photographs,
    further_models,
    match_images,
    matches_in_points,
    require_central,
    require_overlap,
    set_threads,
    solve,
    tell_apart,
    times_of,
    verify,
    why_nothing,
)
from gsut.sfm.finish import finish_solution
from gsut.sfm.lens import Zoom, compare_lens, find_zooms, guess_lenses, search_zooms, zooms_notes
from gsut.sfm.report import (
    FIGURES,
    figures,
    is_finished,
    poses_verdict,
    read_figures,
    solution_notes,
    write_dataset,
    write_models,
    write_report,
)
from gsut.sfm.rig import (
    COVARIANCE_OF,
    RigFit,
    find_rig_photographs,
    refuse_beside_rig,
    solve_rig,
    write_lens_pair,
)
from gsut.sfm.shutter import probably_rolling
from gsut.sfm.time_left import PosesWork

RIG = "rig.json"
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
    """What `find_poses` found and wrote.

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


def find_poses(
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
    on_expected: Callable[[dict[str, float]], None] | None = None,
) -> PosesResult:
    """Camera poses and sparse points of photographs, without COLMAP, through any lens.

    Killed at any moment, the same call goes on from the last stage that was finished (features of
    each image, matches). Unreadable images are left out and named in the notes.

    Args:
        images: folder of photographs, or a dataset (its poses are not looked at).
        out: output folder: transforms.json, points3D.ply, sparse/0 (COLMAP text), poses.json and
            report.html. Images stay where they are. Images that do not connect with these are
            models of their own in model_2, model_3 ...
        camera: lens file, or a dataset whose lens is used; None: the lens file beside the images,
            or the dataset's own; if there is none the lens is estimated. A known lens is held.
            Else the name of a lens of the database (see `find_lenses`), which is estimated from
            there; how far it ended from it is in the notes and in poses.json ("lens_start").
        unknown_lens: estimate the lens even where one lies beside the images.
        fov_degrees: rough horizontal field of view, for an unknown lens; None: several are tried.
        options: every setting of the search; None: the defaults.
        mapper: makes poses of verified pairs where the lens is known; None: incremental, with
            bundle adjustment.
        rig: file of a rig (see `gsut.data.read_rig`): images then holds one folder a camera, the
            images of one frame share one pose of the rig, and all is in its unit. rig.json, the
            rig as it was used, is written too.
        refine_rig: the cameras' poses on the rig are adjusted; its size stays.
        on_progress: told (stage, done, total, text); never fewer done than before in a stage.
        notes_to: told each note as it arises (an image left out, say).
        on_expected: told the stages' seconds, in order, at first and whenever more is known.

    Returns:
        The output folder, poses with points, and figures.

    Raises:
        InputError: too few images, wrong lens, a file that cannot be written, or `out` holds what
            `gsut poses` did not write.
        SolveError: nothing could be reconstructed: no overlap, images all the same, or a camera
            that only turned; says which.
    """
    options = options or PosesOptions()
    log = PosesLog(on_progress, notes_to, on_expected)
    photographs, on_rig = _inputs(Path(images), camera, rig, unknown_lens, mapper, options)
    shutter = _shutter(photographs, options, mapper)
    claimed = claim_folder(out, "poses", images)  # held to the end
    folder = claimed.path
    key = _key(photographs, options, fov_degrees)
    stages = Stages(folder, key)
    log.expect(_work(photographs, options, shutter, on_rig is not None), options.threads)
    with set_threads(options.threads):
        features = collect_features(photographs, options, log.show, log.note, stages)
        log.watch.record_lap("features")
        log.learn(features=float(np.mean([len(f) for f in features])))
        if not (known := photographs.lenses_known):
            photographs = guess_lenses(photographs, fov_degrees)
        raw = match_images(
            photographs.names, features, options, log.show, photographs.frames, stages
        )
        log.learn(pairs=len(raw.pairs), matches=sum(map(len, raw.matches)))
        pairs: list[PairMatches] = []
        if known:
            pairs = verify(
                features, photographs.lenses, raw, options, log.on_pairs("verifying"), shutter
            )
            require_overlap(photographs.names, features, pairs, known=True)
        log.watch.record_lap("matching")
        extra: dict[str, Any] = {"lens": "known" if known else "estimated"}
        fit: RigFit | None = None
        flags: np.ndarray | None = None
        zooms: list[Zoom] = []
        if on_rig is not None:
            solution, fit = solve_rig(
                photographs, features, pairs, options, log.on_images("mapping"),
                log.on_images("rig"), rig=on_rig, adjust=refine_rig,
            )  # fmt: skip
        elif known:
            run = mapper or functools.partial(_map_incrementally, shutter=shutter)
            solution = run(photographs, features, pairs, options, log.on_images("mapping"))
            if mapper is None:
                zooms = find_zooms(solution, features, raw, options)
        else:
            search, zooms = search_zooms(
                photographs, features, raw, options, fov_degrees, log, shutter
            )
            solution, pairs, extra["lens_search"] = search.solution, search.pairs, search.rows
            flags = search.flags
        told, models = _apart(
            photographs, solution, features, pairs, options, flags, log, bool(rig or mapper),
        )  # fmt: skip
        solution, pairs = told.solution, told.pairs
        done = finish_solution(
            photographs, solution, features, pairs, options, flags, log, extra, folder
        )
        solution, doubt, fit = done.solution, done.doubt, fit or done.rig
        log.watch.record_lap("mapping")
    extra["matches_in_points"] = agreeing = None if mapper else matches_in_points(solution, pairs)
    log.note(*compare_lens(photographs, solution.cameras[0], options, extra))
    log.note(*zooms_notes(zooms), *write_models(models, photographs, folder))
    extra["models"] = [int(model.num_registered) for model in models]
    log.note(*solution_notes(solution, agreeing, fit, doubt, known=known))
    verdict = poses_verdict(solution, features, agreeing, doubt, len(zooms), told.doubt)
    extra |= {"verdict": verdict.as_dict(), "made_from": digest(key), **told.figures()}
    values = _write(folder, solution, photographs, fit, extra, log)
    stages.remove()
    return PosesResult(folder, solution, values)


def _inputs(
    images: Path,
    camera: str | os.PathLike[str] | None,
    rig: str | os.PathLike[str] | None,
    unknown_lens: bool,
    mapper: Mapper | None,
    options: PosesOptions,
) -> tuple[Photographs, Rig | None]:
    """The photographs with their lenses, as far as they are known, and the rig."""
    if rig is not None:
        others = {"camera": camera, "unknown-lens": unknown_lens, "photometric": mapper}
        refuse_beside_rig(options, others)
        on_rig = read_rig(rig)
        photographs = find_rig_photographs(images, on_rig)
        require_central(photographs.lenses)
        return photographs, on_rig
    photographs = find_photographs(
        images, None if camera is None else Path(camera), with_lens=not unknown_lens
    )
    if unknown_lens:
        photographs = dataclasses.replace(photographs, cameras=[None] * len(photographs))
    require_central([camera for camera in photographs.cameras if camera is not None])
    return photographs, None


def _work(
    photographs: Photographs, options: PosesOptions, shutter: Shutter | None, on_rig: bool
) -> PosesWork:
    """What there is to do, as far as the files say it."""
    header = read_header(photographs.paths[0])
    video = shutter is None and options.shutter == "auto" and bool(photographs.flows)
    return PosesWork(
        len(photographs), min(header.width * header.height / 1e6, options.max_megapixels),
        photographs.lenses_known, rolling=shutter is not None,
        video=video,
        lines=video and probably_rolling(photographs.flows, header.width, header.height),
        rig=on_rig or photographs.frames is not None,
    )  # fmt: skip


def _write(
    folder: Path,
    solution: Solution,
    photographs: Photographs,
    fit: RigFit | None,
    extra: dict[str, Any],
    log: PosesLog,
) -> dict[str, Any]:
    """Writes everything; returns the content of poses.json."""
    for text in write_dataset(solution, photographs, folder):
        log.note(text)
    if fit is not None:
        extra = {**extra, "rig": fit.figures, "covariance_of": COVARIANCE_OF}
        if fit.figures.get("found"):
            write_lens_pair(fit)
        write_rig(fit.rig, folder / RIG)
    log.watch.record_lap("writing")
    seconds, cpu_seconds = (
        {stage: times[clock] for stage, times in log.watch.seconds.items()} for clock in (0, 1)
    )
    cpu_seconds["total"] = sum(cpu_seconds.values())
    values = figures(solution, seconds, log.notes, {**extra, "cpu_seconds": cpu_seconds})
    write_report(folder, solution, values)
    write_file(folder / FIGURES, json.dumps(values, indent=1) + "\n")
    return values


def _map_incrementally(
    photographs: Photographs,
    features: list[Features],
    pairs: list[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    *,
    shutter: Shutter | None,
) -> Solution:
    try:
        return solve(
            photographs.names, photographs.lenses, features, pairs, options, on_progress,
            shutter=shutter,
        )  # fmt: skip
    except SolveError as error:
        otherwise = "let the lens be estimated: --unknown-lens"
        raise why_nothing(error, features, pairs, otherwise) from None


def _apart(
    photographs: Photographs,
    solution: Solution,
    features: list[Features],
    pairs: list[PairMatches],
    options: PosesOptions,
    flags: np.ndarray | None,
    log: PosesLog,
    as_it_is: bool,
) -> tuple[ToldApart, list[Solution]]:
    """The solution without joins of places that look alike, and further models.

    Args:
        photographs, solution, features, pairs, options, log: see `find_poses`.
        flags: of the parameters of an estimated lens, or None.
        as_it_is: the solution is only looked at, and stays.
    """
    times = times_of(photographs.names, photographs.frames)
    if as_it_is:
        doubt = find_look_alikes(solution, times, options.window)
        return ToldApart(solution, pairs, doubt=doubt), []

    def again(kept: list[PairMatches]) -> Solution:
        return solve(
            solution.names, solution.cameras, features, kept, options, log.on_images("mapping"),
            lens_free=flags, lens_settled=flags is not None, shutter=solution.shutter,
        )  # fmt: skip

    told = tell_apart(solution, pairs, again, times, options.window)
    log.note(*told.words())
    whole, models = further_models(told.solution, features, told.pairs, options)
    return dataclasses.replace(told, solution=whole), models


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
        "profile": photographs.profile.name if photographs.profile else None,
        **({} if photographs.frames is None else {"frames": photographs.frames.tolist()}),
    }


def _shutter(
    photographs: Photographs, options: PosesOptions, mapper: Mapper | None
) -> Shutter | None:
    """The rolling shutter of the images, or None."""
    if options.shutter == "global":
        return None
    shutter = photographs.shutter
    if shutter is None and (options.shutter == "rolling" or options.readout_time is not None):
        shutter = Shutter(options.readout_direction)
    if shutter is not None and mapper is not None:
        raise InputError(
            "--photometric takes every image for one pose, and these have a rolling shutter: "
            "leave it out, or give --shutter global"
        )
    return shutter


def done_already(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    camera: str | os.PathLike[str] | None = None,
    unknown_lens: bool = False,
    fov_degrees: float | None = None,
    options: PosesOptions | None = None,
) -> dict[str, Any] | None:
    """The content of poses.json if `find_poses` has finished there with the same arguments.

    Raises:
        InputError: as `find_poses`.
    """
    folder, options = Path(out), options or PosesOptions()
    if not is_finished(folder):
        return None
    photographs, _ = _inputs(Path(images), camera, None, unknown_lens, None, options)
    figures = read_figures(folder)
    same = figures.get("made_from") == digest(_key(photographs, options, fov_degrees))
    return figures if same else None
