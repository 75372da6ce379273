"""Writes everything that a run found: dataset, COLMAP text, points, rig, poses.json, report."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import Frame, list_some, write_transforms
from gsut.data.colmap import ColmapImage, ColmapModel, RigPlace, format_model_texts, hold_rigs
from gsut.data.points import format_points_ply
from gsut.data.poses import invert_pose
from gsut.files import read_json, register_reader, write_file
from gsut.run import Verdict
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import find_frame_numbers
from gsut.sfm.photographs import HELD_BY, Photographs
from gsut.sfm.report.page import REPORT, write_report
from gsut.sfm.report.verdict import judge_solution, list_notes
from gsut.sfm.rig import COVARIANCE_OF, write_rig_fit
from gsut.sfm.solution import FEATURE_VARIANCE, Solution
from gsut.sfm.world import find_stated_up

TRANSFORMS = "transforms.json"
POINTS = "points3D.ply"
FIGURES = "poses.json"
_NUMBER = (int, float, type(None))
# What is read of poses.json, see `check_shape`.
_SHAPE: dict[str, Any] = {
    "registered": int, "images": int, "points": int, "lens": str, "seconds": {"*": _NUMBER},
    "reprojection_error_px": {"rms": _NUMBER, "median": _NUMBER}, "verdict": Verdict.SHAPE,
    "lenses": [{"model": str, "params": [_NUMBER]}], "made_from?": str, "rig?": dict,
}  # fmt: skip
COLMAP = "sparse/0"
MODEL = "model_{}"  # folder of a further model; the first is in the output folder itself


def write_poses(mapping: Mapping, folder: Path, made_from: str) -> dict[str, Any]:
    """Writes dataset, rig, poses.json and report.html; returns the content of poses.json.

    Args:
        made_from: digest of all that the poses depend on.
    """
    solution, found, log = mapping.solved, mapping.found, mapping.log
    models = write_models(found.models, mapping.photographs, folder)
    log.note(*list_notes(mapping), *models)
    verdict = judge_solution(solution, mapping.features, found)
    look_alikes = found.look_alikes
    errors, lens = found.pose_errors_px, found.lens_sigma_px
    figures = found.figures | {
        "matches_in_points": found.agreement,
        "contradicted_pairs": found.contradicted,
        "contradicted_images": found.contradicted_images,
        "pose_errors_px": errors and [px if math.isfinite(px) else None for px in errors],
        "lens_sigma_px": lens if lens is not None and math.isfinite(lens) else None,
        "models": [int(model.num_registered) for model in found.models],
        "verdict": verdict.as_dict(),
        "made_from": made_from,
        "look_alikes": None if look_alikes is None else look_alikes.to_figures(),
    }  # fmt: skip
    up = find_stated_up(figures)
    log.note(*write_dataset(solution, mapping.photographs, folder, up))
    if found.rig is not None:
        figures |= {"rig": found.rig.figures, "covariance_of": COVARIANCE_OF}
        write_rig_fit(found.rig, folder)
    log.watch.record_lap("writing")
    seconds, cpu_seconds = (
        {stage: times[clock] for stage, times in log.watch.seconds.items()} for clock in (0, 1)
    )
    cpu_seconds["total"] = sum(cpu_seconds.values())
    figures["cpu_seconds"] = cpu_seconds
    values = list_figures(solution, seconds, log.notes, figures)
    write_report(folder, solution, values)
    write_file(folder / FIGURES, json.dumps(values, indent=1) + "\n")
    return values


def write_dataset(
    solution: Solution, photographs: Photographs, out: Path, up: Sequence[float] | None = None
) -> list[str]:
    """Writes the poses as a dataset and COLMAP text; every file as a whole or not at all.

    Args:
        photographs: the images, which are named by paths relative to `out` and not copied.
        out: the folder.
        up: (3,) in the world; None: not known.

    Returns:
        A sentence on each thing that could not be written (COLMAP lacks some lenses).

    Raises:
        InputError: a file cannot be written.
    """
    write_file(out / POINTS, format_points_ply(solution.points, solution.colors))
    frames = _list_frames(solution, photographs)
    write_transforms(out / TRANSFORMS, frames, points_file=POINTS, up=up)
    try:
        texts, notes = _format_colmap(solution, photographs)
    except InputError as error:
        return [f"{COLMAP} was not written: {error}"]
    (out / COLMAP).mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_file(out / COLMAP / name, text)
    if solution.shutter is not None:
        notes.append(f"{COLMAP} has the pose in the middle of each readout: COLMAP knows no other")
    return notes


def _list_frames(solution: Solution, photographs: Photographs) -> list[Frame]:
    frames = [
        Frame(
            name, path, camera, invert_pose(pose), mask_path=mask, shutter=shutter,
            time=photographs.times.get(name),
        )
        for name, path, camera, pose, mask, shutter in zip(
            solution.names, photographs.paths, solution.cameras, solution.camera_from_world,
            photographs.masks, solution.shutters, strict=True,
        )
    ]  # fmt: skip
    if solution.shutter is not None:
        ends = solution.interpolate_poses(0.0), solution.interpolate_poses(1.0)
        for frame, start, end in zip(frames, *ends, strict=True):
            if frame.shutter is None:  # of a camera that reads all lines at once
                continue
            frame.world_from_camera_start, frame.world_from_camera_end = (
                invert_pose(start),
                invert_pose(end),
            )
    return [f for f, registered in zip(frames, solution.registered, strict=True) if registered]


def _format_colmap(
    solution: Solution, photographs: Photographs
) -> tuple[dict[str, str], list[str]]:
    """Formats a model's texts, those of its rig too, and notes; images and points count from 1."""
    frames, on_rig = photographs.frames, photographs.rig_cameras
    rows: list[list[int]] = [[] for _ in solution.names]
    for row, (_, image, _) in enumerate(solution.observations):
        rows[image].append(row)
    images = [
        ColmapImage(
            i + 1, name, solution.cameras[i], solution.camera_from_world[i],
            np.reshape(solution.pixels[rows[i]], (-1, 2)), solution.observations[rows[i], 0],
            None if frames is None or on_rig is None
            else RigPlace(1, int(on_rig[i]), int(frames[i])),
        )
        for i, name in enumerate(solution.names)
        if solution.registered[i]
    ]  # fmt: skip
    held, notes = hold_rigs(images)
    model = ColmapModel(held, solution.points, solution.colors, solution.point_errors)
    return format_model_texts(model), notes


def list_figures(
    solution: Solution, seconds: dict[str, float], notes: list[str], extra: dict[str, Any]
) -> dict[str, Any]:
    """Lists the values of poses.json: JSON values, None for what is not known."""
    sigmas = np.sqrt(np.einsum("nii->ni", solution.covariances))
    lenses = list(dict.fromkeys(solution.cameras))
    rows = []
    images_of_point = np.bincount(solution.observations[:, 0])
    in_order = find_frame_numbers(solution.names, None) is not None
    for i, name in enumerate(solution.names):
        row: dict[str, Any] = {"name": name, "registered": bool(solution.registered[i])}
        if solution.registered[i]:
            mine = solution.observations[:, 1] == i
            if not in_order:
                held = images_of_point[solution.observations[mine, 0]] >= HELD_BY
                row["points_held_without"] = int(held.sum())
            lengths = np.linalg.norm(solution.residuals[mine], axis=1)
            row["camera_from_world"] = solution.camera_from_world[i].tolist()
            if solution.velocities is not None:
                row["readout_shift"] = solution.velocities[i, :3].tolist()
                row["readout_turn_degrees"] = np.degrees(solution.velocities[i, 3:]).tolist()
            row["points"] = int(mine.sum())
            row["error_px"] = keep_finite(np.nanmedian(lengths)) if len(lengths) else None
            row["sigma_center"] = [keep_finite(v) for v in sigmas[i, :3]]
            row["sigma_turn_degrees"] = [keep_finite(math.degrees(v)) for v in sigmas[i, 3:]]
            row["covariance"] = [[keep_finite(v) for v in line] for line in solution.covariances[i]]
        rows.append(row)
    return {
        "registered": solution.num_registered,
        "images": len(solution.names),
        "points": len(solution.points),
        "observations": len(solution.observations),
        "mean_track_length": keep_finite(
            len(solution.observations) / max(1, len(solution.points))
        ),
        "reprojection_error_px": {"rms": solution.rms, "median": solution.median},
        "seconds": {**seconds, "total": sum(seconds.values())},
        "initial_pair": [solution.names[i] for i in solution.initial_pair],
        "restarts": solution.restarts,
        "lenses": [
            {"model": c.model, "params": list(map(float, c.params)), "width": c.width,
             "height": c.height}
            for c in lenses
        ],
        "notes": notes,
        "covariance_scale": FEATURE_VARIANCE,
        "covariance_of": "centre in the world, turn in the camera frame (radians); the first image "
        "of initial_pair and one component of the second's centre are held",
        **extra,
        "views": rows,
    }  # fmt: skip


def keep_finite(value: float) -> float | None:
    """Returns the value, or None where it is not finite, which JSON does not know."""
    return float(value) if math.isfinite(value) else None


def write_models(models: Sequence[Solution], photographs: Photographs, out: Path) -> list[str]:
    """Writes further models to model_2, model_3 ..., and deletes those of an earlier run.

    Returns:
        A sentence on each.
    """
    for old in out.glob(MODEL.format("*")):
        if (old / FIGURES).is_file():
            shutil.rmtree(old)
    notes = []
    for number, model in enumerate(models, 2):
        folder = out / MODEL.format(number)
        folder.mkdir(parents=True, exist_ok=True)
        write_dataset(model, photographs, folder)
        values = list_figures(model, {}, [], {"model": number})
        write_file(folder / FIGURES, json.dumps(values, indent=1) + "\n")
        names = model.registered_names
        notes.append(
            f"{len(names)} images do not connect with the others and are a model of their own, "
            f"{folder.name}: {list_some(names)}; take pictures between them and the others, or "
            f"train them by themselves: gsut train {folder}"
        )
    return notes


@register_reader("poses.json", ".json")
def read_figures(out: Path) -> dict[str, Any]:
    """Reads poses.json of a finished run.

    Raises:
        InputError: the file is damaged.
    """
    path = out / FIGURES
    advice = "it is damaged: remove it, and the same command finds the poses again"
    return read_json(path, _SHAPE, advice=advice)


def read_scale_sigma(folder: Path) -> float | None:
    """Reads how well poses.json of a dataset knows its unit, relative; None: it does not say."""
    if not (folder / FIGURES).is_file():
        return None
    figures = read_figures(folder)
    gps = figures.get("earth", {}).get("gps", {})
    markers = figures.get("markers", {})
    percent = figures.get("control", {}).get("scale_sigma_percent")
    if percent is None and gps.get("applied"):
        percent = gps["scale_sigma_percent"]
    if percent is None and markers.get("applied"):
        percent = markers["sigma_percent"]
    if percent is None:
        percent = figures.get("rig", {}).get("scale_sigma_percent")
    return None if percent is None else percent / 100


def is_finished(out: Path) -> bool:
    """Returns whether a folder holds the result of a finished run."""
    return (out / FIGURES).is_file() and (out / TRANSFORMS).is_file() and (out / REPORT).is_file()
