"""Places a rig's images with one pose a frame, and writes the rig as it was used."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers, invert_pose
from gsut.data.rigs import Rig, write_rig
from gsut.files import to_file_name
from gsut.lens import save_camera
from gsut.sfm.mapping import Mapping, RigFit
from gsut.sfm.photographs import make_no_features
from gsut.sfm.rig.description import add_uncertainty, describe_rig, list_rig_notes
from gsut.sfm.rig.motion import find_body_motion, list_readings
from gsut.sfm.rig.observability import estimate_mount_uncertainty
from gsut.sfm.rig.start import place_rig
from gsut.sfm.solution import (
    CENTER,
    Adjustment,
    LensFlag,
    LensFlags,
    ReadoutMotion,
    RigConstraint,
    Solution,
    StatedPlaces,
    adjust_poses,
    solve_left_out,
    solve_poses,
)

RIG = "rig.json"


def solve_rig(mapping: Mapping) -> Mapping:
    """Estimates poses and points in the rig's unit, with one pose of the rig a frame.

    First each image by itself, through its own lens, unless the search of an unknown lens placed
    them. Then the rig's pose at each frame from the images placed, the scale from its baselines,
    and all images' poses from the rig's; then bundle adjustment of all observations with one pose a
    frame, and of unknown lenses. Frames without a placed image are placed by the points found;
    those that do not connect become models of their own.

    Returns:
        The run with the solution, flags of the lenses, the fit of the rig and further models.

    Raises:
        SolveError: nothing could be reconstructed; no frame has two placed images, so nothing
            sets the scale; or images contradict the rig.
    """
    rig, options = mapping.rig, mapping.options
    assert rig is not None
    if mapping.solution is None:
        # With tracks extended as at the end: short tracks fit any poses, and residuals show little.
        alone = solve_poses(
            mapping.images, mapping.pairs, options, mapping.log.follow_steps("mapping")
        )
        mapping = mapping.replace(solution=alone)
    mapping = mapping.replace(lens_free=_free_centers(mapping.lens_free))
    placed = [put_on_rig(mapping, rig, options.refine_rig)]
    placed += _place_further_frames(mapping, rig, placed[0][0])
    placed.sort(key=lambda each: -each[0].num_registered)
    (solution, fit), *others = placed
    models = [other for other, _ in others]
    return mapping.replace(solution=solution).add_findings(rig=fit, models=models)


def _free_centers(lens_free: LensFlags) -> LensFlags:
    """Frees the principal points of estimated lenses, which the rig's turns determine.

    By itself a principal point and a turn of the camera change images nearly alike.
    """
    if lens_free is None or isinstance(lens_free, np.ndarray):
        return lens_free
    freed: dict[int, np.ndarray] = {}
    for flags in lens_free:
        if flags is not None and id(flags) not in freed:
            own = flags.copy()
            own[list(CENTER)] = LensFlag.FREE
            freed[id(flags)] = own
    return [None if flags is None else freed[id(flags)] for flags in lens_free]


def _place_further_frames(
    mapping: Mapping, rig: Rig, first: Solution
) -> list[tuple[Solution, RigFit]]:
    """Places the frames without an image in the first model, in models of their own.

    A model needs a frame with two images, which set its scale.
    """
    frames, options = mapping.photographs.frames, mapping.options
    assert frames is not None
    left = ~np.isin(frames, frames[first.registered])
    images = dataclasses.replace(mapping.images, cameras=first.cameras)
    known = mapping.replace(
        photographs=mapping.photographs.with_cameras(first.cameras), lens_free=None
    )
    found = []
    for alone, pairs in solve_left_out(images, left, mapping.pairs, options):
        own = known.replace(solution=alone, pairs=pairs)
        try:
            solution, fit = put_on_rig(own, rig, options.refine_rig)
        except SolveError:
            continue
        left &= ~np.isin(frames, frames[solution.registered])
        found.append((solution, fit))
    return found


def put_on_rig(
    mapping: Mapping, rig: Rig, adjust: bool, *, rate_sigma: float = 1.0
) -> tuple[Solution, RigFit]:
    """Estimates one pose of the rig a frame, from images placed one by one.

    Args:
        mapping: with the solution of the images one by one.
        adjust: adjust the cameras' poses on the rig too.
        rate_sigma: share of itself that the motion of the rig during a readout may differ by from
            that of the images one by one; 0: exact.

    Raises:
        SolveError: see `solve_rig`.
    """
    alone, photographs = mapping.solved, mapping.photographs
    assert photographs.frames is not None and photographs.rig_cameras is not None
    start = place_rig(
        alone.camera_from_world, alone.registered, photographs.frames, photographs.rig_cameras,
        rig, np.bincount(alone.observations[:, 1], minlength=len(photographs)),
    )  # fmt: skip
    first = rig.camera_from_reference[0]
    constraint = RigConstraint(
        photographs.frames, photographs.rig_cameras - 1,
        rig.camera_from_reference[1:] @ invert_pose(first), start.known, adjust,
    )  # fmt: skip
    solution = _adjust_bodies(
        mapping, constraint, list(start.camera_from_world),
        find_body_motion(alone, start.scale, constraint, rate_sigma),
    )  # fmt: skip
    solution = dataclasses.replace(
        solution, initial_pair=alone.initial_pair, restarts=alone.restarts
    )
    mounts = solution.camera_from_body
    assert mounts is not None
    now = rig
    if adjust:
        found = np.concatenate([first[None], mounts @ first])
        now = dataclasses.replace(rig, camera_from_reference=found)
    if rig.unknown_lenses:
        of_camera = [int(np.argmax(photographs.rig_cameras == k)) for k in range(len(rig))]
        lenses = tuple(solution.cameras[image] for image in of_camera)
        now = dataclasses.replace(now, cameras=lenses)
    seconds = mapping.found.figures.get("readout", {}).get("seconds")
    if rig.readings:
        seconds = max((r.seconds for r in rig.readings if r and r.seconds), default=None)
    readings = list_readings(solution, photographs.rig_cameras, seconds)
    now = dataclasses.replace(now, readings=readings)
    figures = describe_rig(photographs, (rig, now), start, alone, solution)
    if adjust:
        uncertainty = estimate_mount_uncertainty(solution, constraint)
        add_uncertainty(figures, uncertainty)
    return solution, RigFit(now, figures, list_rig_notes(rig, figures))


def adjust_rig_near_places(
    mapping: Mapping, solution: Solution, places: StatedPlaces, lens_free: LensFlags
) -> Solution:
    """Adjusts the poses of a rig, whose cameras stay on it as they are, near stated places.

    Args:
        mapping: with the rig in the unit of the places.
        solution: in the world of the places.
        places: of the images' own cameras.
        lens_free: see `Adjustment`.

    Raises:
        SolveError: too few points agree with the poses.
    """
    photographs, fit = mapping.photographs, mapping.found.rig
    assert photographs.frames is not None and photographs.rig_cameras is not None
    assert fit is not None
    camera_from_body = fit.rig.camera_from_reference @ invert_pose(fit.rig.camera_from_reference[0])
    own = camera_from_body[photographs.rig_cameras]
    poses, centers = np.tile(np.eye(4), (len(own), 1, 1)), np.full((len(own), 3), np.nan)
    known = np.zeros(len(own), bool)
    away = find_centers(solution.camera_from_world) - places.centers
    for frame in np.unique(photographs.frames[solution.registered]):
        images = np.flatnonzero(photographs.frames == frame)
        seen = images[solution.registered[images]]
        body = invert_pose(own[seen[0]]) @ solution.camera_from_world[seen[0]]
        poses[images], known[images] = own[images] @ body, True
        stated = seen[np.isfinite(away[seen]).all(axis=1)]
        if len(stated):
            centers[images] = find_centers(body[None])[0] - away[stated].mean(axis=0)
    constraint = RigConstraint(
        photographs.frames, photographs.rig_cameras - 1, camera_from_body[1:], known
    )
    held = _adjust_bodies(
        mapping.replace(solution=solution, lens_free=lens_free), constraint,
        list(poses), find_body_motion(solution, 1.0, constraint, ReadoutMotion.sigma),
        StatedPlaces(centers, places.sigma),
    )  # fmt: skip
    return dataclasses.replace(held, initial_pair=solution.initial_pair, restarts=solution.restarts)


def _adjust_bodies(
    mapping: Mapping,
    constraint: RigConstraint,
    poses: list[np.ndarray],
    motion: ReadoutMotion | None,
    places: StatedPlaces | None = None,
) -> Solution:
    """Adjusts poses, points and free lenses with one pose a frame; see `put_on_rig`.

    Args:
        places: of the bodies, or None.
    """
    alone = mapping.solved
    features = [
        own if is_usable else make_no_features()
        for own, is_usable in zip(mapping.features, _find_usable_images(mapping), strict=True)
    ]
    images = dataclasses.replace(
        mapping.images, cameras=alone.cameras, features=features, lines=alone.lines
    )
    solution = adjust_poses(
        images, mapping.pairs, poses, mapping.options, mapping.log.follow_steps("rig"),
        Adjustment(mapping.lens_free, rig=constraint, motion=motion, places=places),
    )  # fmt: skip
    # An image that observes no point may be of another place: it gets no pose from its frame.
    observed = np.bincount(solution.observations[:, 1], minlength=len(features)) > 0
    return dataclasses.replace(solution, registered=solution.registered & observed)


def _find_usable_images(mapping: Mapping) -> np.ndarray:
    """Returns (N,) bool, the images with a verified match and a lens.

    Of the others, features near a point's projection would be chance.
    """
    usable = np.zeros(len(mapping.photographs), bool)
    for pair in mapping.pairs:
        usable[[pair.first, pair.second]] = True
    for group in mapping.photographs.groups:  # a lens through which no image could be placed
        usable[group.images] &= mapping.solved.registered[group.images].any()
    return usable


def write_rig_fit(fit: RigFit, folder: Path) -> None:
    """Writes the rig as it was used, and beside it each lens that was estimated.

    Raises:
        InputError: a file cannot be written.
    """
    files = list(fit.rig.lens_files)
    for number in fit.rig.unknown_lenses:
        lens = fit.rig.cameras[number]
        assert lens is not None
        path = folder / f"{to_file_name(fit.rig.names[number])}.yaml"
        save_camera(lens, path)
        files[number] = (path, None)
    write_rig(dataclasses.replace(fit.rig, lens_files=tuple(files)), folder / RIG)
