"""`./run bench poses`: errors and seconds of `gsut poses`, and of pycolmap, against known poses."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import os
import subprocess
import tempfile
import unittest.mock
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.data import read_dataset
from gsut.data.images import read_header
from gsut.gaussians import measure_rotation_angles
from gsut.lens import convert_camera, save_camera
from gsut.lens.files import to_colmap
from gsut.sfm import PoseErrors, PosesOptions, compare_datasets, compare_poses, find_poses
from gsut.sfm.matches import ROLLING_ERROR
from gsut.sfm.photographs import find_photographs
from gsut.sfm.world import read_poses_by_path
from tests.bench import pycolmap_poses
from tests.bench.harness import HALL, WRONG, Benchmark, Column, Option, Row, Settings
from tests.bench.lens_walks import WALKS

_SETS = (HALL, "sponza_fisheye", "fox", "helmet_distorted_rs", "gopro_max_walk")
LENSES = "lenses"  # a walk through a lens of each family
KNOWN, UNKNOWN = "known", "unknown"
ALL, SIFT = "all", "SIFT"
AUC_DEGREES = (1, 5, 10)
_FEWEST = 3  # images with a pose, without which there is no similarity to compare by


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists datasets by lens and program."""
    sets = settings.sets or _SETS
    for data in [each for name in sets for each in (WALKS if name == LENSES else (name,))]:
        for lens in settings.lens:
            if lens == UNKNOWN and data in WALKS:
                continue  # they show what a known lens of each family costs
            path = settings.find(data)
            if lens != UNKNOWN and path is not None and not _has_poses(path):
                continue  # a folder of images has no lens of its own
            case = {"data": data, "lens": lens}
            for features in settings.features:
                yield case | {"program": "gsut" if features == ALL else f"gsut, {features}"}
            if settings.pycolmap and lens in (KNOWN, UNKNOWN):
                yield case | {"program": "pycolmap"}


def measure(case: Row, settings: Settings) -> Row:
    """Finds poses and compares them with the dataset's."""
    data = settings.path(case["data"])
    if case["program"] == "pycolmap":
        return measure_pycolmap(data, case["lens"], settings.pycolmap, settings.threads)
    lens, is_all = case["lens"], case["program"] == "gsut"
    with tempfile.TemporaryDirectory(prefix="gsut-poses-") as folder:
        fitted = None if lens in (KNOWN, UNKNOWN) else fit_lens(data, lens, Path(folder))
        options = _choose_options(data, settings)
        try:
            options = dataclasses.replace(options, unknown_lens=lens == UNKNOWN)
            with contextlib.nullcontext() if is_all else leave_out_learned():
                result = find_poses(data, folder, camera=fitted, options=options)
        except SolveError as error:
            return {"registered": 0, WRONG: str(error)}
        figures = result.figures
        row = {
            "registered": figures["registered"],
            "images": figures["images"],
            "residual_px": figures["reprojection_error_px"]["median"],
            "pose_errors_px": (figures["pose_errors_px"] or [None])[0],
            "verdict": figures["verdict"]["level"],
            "seconds": figures["seconds"]["total"],
            "cpu_seconds": figures["cpu_seconds"]["total"],
        }
        if lens == UNKNOWN:
            row["focal_sigma_percent"] = figures["focal_sigma_percent"]
        if _has_poses(data) and result.solution.num_registered >= _FEWEST:
            row |= _describe_errors(compare_datasets(data, folder))
            row |= measure_auc(read_poses_by_path(Path(folder)), read_poses_by_path(data))
            if lens == UNKNOWN:
                known = read_dataset(data).frames[0].camera.params[:2].mean()
                found = result.solution.cameras[0].params[:2].mean()
                row["focal_error_percent"] = 100 * float(found / known - 1)
    return row


def _has_poses(data: Path) -> bool:
    return (data / "transforms.json").is_file() or (data / "sparse").is_dir()


def _choose_options(data: Path, settings: Settings) -> PosesOptions:
    """Returns the options, looser where a rolling shutter is taken for a global one."""
    options = PosesOptions(threads=settings.threads, shutter=settings.shutter)
    if settings.shutter != "global" or find_photographs(data, None).shutter is None:
        return options
    return dataclasses.replace(options, max_error=ROLLING_ERROR * options.max_error)


def _describe_errors(errors: PoseErrors) -> Row:
    return {
        "centers_percent": errors.ate_percent,
        "rotation_degrees": float(np.median(errors.rotation_degrees)),
        "rotation_max_degrees": float(errors.rotation_degrees.max()),
    }


def fit_lens(data: Path, model: str, folder: Path) -> Path:
    """Writes the lens of a model that is nearest to the dataset's; returns its file."""
    (camera,) = set(find_photographs(data, None).lenses)
    save_camera(convert_camera(camera, model).camera, folder / "fitted.lens.json")
    return folder / "fitted.lens.json"


def measure_pycolmap(data: Path, lens: str, python: str, threads: int) -> Row:
    """Has pycolmap map the same images, in a process of its own.

    Args:
        data: dataset. lens: "known" or "unknown". python: that has pycolmap. threads: 0 for all.

    Raises:
        InputError: this Python cannot be run.
    """
    photographs = find_photographs(data, None)
    paths = [path.resolve() for path in photographs.paths]
    root = Path(os.path.commonpath([path.parent for path in paths]))
    names = [path.relative_to(root).as_posix() for path in paths]
    row: Row = {"registered": 0, "images": len(names)}
    request: Row = {
        "images": str(root), "names": names, "threads": threads or -1,
        "single": len({_read_size(path) for path in paths}) == 1, "model": None, "params": None,
    }  # fmt: skip
    if lens == KNOWN:
        cameras = {camera for camera in photographs.cameras if camera is not None}
        if len(cameras) != 1:
            return row | {WRONG: f"the images have {len(cameras)} known lenses, not one"}
        model, _, params = to_colmap(cameras.pop())
        request |= {"model": model, "params": [float(value) for value in params]}
    with tempfile.TemporaryDirectory(prefix="gsut-pycolmap-") as folder:
        question, answer = Path(folder) / "request.json", Path(folder) / "answer.json"
        work = Path(folder) / "work"
        work.mkdir()
        question.write_text(json.dumps(request | {"work": str(work)}))
        command = [python, pycolmap_poses.__file__, str(question), str(answer)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError(f"--pycolmap {python} cannot be run: {error.strerror}") from None
        if done.returncode == pycolmap_poses.MISSING:
            return row | {WRONG: f"{python} has no pycolmap: pip install pycolmap there"}
        if done.returncode or not answer.is_file():
            return row | {WRONG: done.stderr.strip()[-300:] or "pycolmap failed"}
        found = json.loads(answer.read_text())
    row |= {
        "registered": len(found["poses"]),
        "seconds": sum(found["seconds"].values()),
        "cpu_seconds": sum(found["cpu_seconds"].values()),
    }
    if _has_poses(data) and len(found["poses"]) >= _FEWEST:
        poses = {root / name: complete_pose(pose) for name, pose in found["poses"].items()}
        reference = read_poses_by_path(data)
        shared = [path for path in poses if path in reference]
        errors = compare_poses(
            np.array([poses[path] for path in shared]),
            np.array([reference[path] for path in shared]),
        )
        row |= _describe_errors(errors) | measure_auc(poses, reference)
    return row


def _read_size(path: Path) -> tuple[int, ...]:
    """Returns a picture's sides, the shorter first: those of one camera, however it was held."""
    header = read_header(path)
    return tuple(sorted((header.width, header.height)))


def complete_pose(rows: Sequence[Sequence[float]]) -> np.ndarray:
    """Returns (4, 4) of a pose's first three rows."""
    return np.array([*rows, [0.0, 0.0, 0.0, 1.0]])


def measure_auc(found: dict[Path, np.ndarray], truth: dict[Path, np.ndarray]) -> Row:
    """Measures the area under the recall curve of pairs of images up to each of some angles.

    The error of a pair is the larger of the angles between rotations and between directions of
    the baseline; a pair of which an image has no pose has none of the area.

    Args:
        found, truth: camera_from_world (4, 4) by image.
    """
    errors = []
    for pair in itertools.combinations(sorted(truth), 2):
        if not all(path in found for path in pair):
            errors.append(np.inf)
            continue
        own, right = (poses[pair[1]] @ np.linalg.inv(poses[pair[0]]) for poses in (found, truth))
        turn = measure_rotation_angles((own[:3, :3] @ right[:3, :3].T)[None])[0]
        sine = np.linalg.norm(np.cross(own[:3, 3], right[:3, 3]))
        errors.append(np.degrees(max(turn, np.arctan2(sine, own[:3, 3] @ right[:3, 3]))))
    return {
        f"auc_{limit}": 100 * float(np.mean(np.clip(1 - np.array(errors) / limit, 0, 1)))
        for limit in AUC_DEGREES
    }


def leave_out_learned() -> contextlib.AbstractContextManager[Any]:
    """Returns a block in which `gsut poses` has no learned features."""
    return unittest.mock.patch("gsut.sfm.connection.add_learned_features", lambda *_: None)


BENCHMARK = Benchmark(
    help="gsut poses, with and without the lens, and pycolmap: errors against known poses, "
    f"seconds; --sets {LENSES}: through a known lens of each family",
    columns=(
        Column("data"),
        Column("lens"),
        Column("program"),
        Column("registered", form="d"),
        Column("images", form="d"),
        Column("centers_percent", "centres", "% of extent", ".3f"),
        Column("rotation_degrees", "rotation", "degrees", ".3f"),
        Column("rotation_max_degrees", "largest", "degrees", ".3f"),
        *(Column(f"auc_{limit}", f"AUC@{limit}", "%", ".1f") for limit in AUC_DEGREES),
        Column("focal_error_percent", "focal length", "%", "+.2f"),
        Column("focal_sigma_percent", "stated", "%", ".2f"),
        Column("residual_px", "residual", "px", ".2f"),
        Column("pose_errors_px", "probable error", "px", ".1f"),
        Column("verdict", form="s"),
        Column("cpu_seconds", "time", "CPU-s", ".1f"),
        Column("seconds", "time", "s", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("lens", (KNOWN, UNKNOWN), "known, unknown, or models fitted to the known lens"),
        Option("features", (ALL,), f"{ALL}, or {SIFT}: without learned features"),
        Option("shutter", "auto", "auto, global or rolling, as of gsut poses"),
        Option(
            "pycolmap",
            os.environ.get("GSUT_PYCOLMAP", ""),
            "a Python that has pycolmap, for its rows",
        ),
    ),
)
