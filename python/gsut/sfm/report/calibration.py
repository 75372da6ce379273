"""Refines a dataset's lens and poses, and writes lens file, report and refined dataset."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import read_dataset
from gsut.files import write_file
from gsut.lens import Camera, save_camera, save_uncertainty, spread_pixels
from gsut.lens.files import OWN_SUFFIX
from gsut.sfm.lens import RefinedLens, refine_lens
from gsut.sfm.photographs import PosesOptions
from gsut.sfm.report.calibration_page import write_page
from gsut.sfm.report.output import TRANSFORMS, keep_finite, list_figures, write_dataset
from gsut.sfm.report.page import REPORT, write_report

_REPORT_JSON = "report.json"
_UNCERTAIN_PX = 1.0  # standard deviation at the rim above which a note is made
_SUFFIXES = (".cameramodel", ".yaml", ".yml", ".json")


@dataclasses.dataclass(frozen=True)
class DatasetCalibration:
    """The files that `calibrate_from_dataset` wrote.

    Attributes:
        lens: the lens file.
        summary: lines to print.
    """

    lens: Path
    summary: list[str]


def calibrate_from_dataset(
    data: str | os.PathLike[str],
    out: Path,
    on_progress: Callable[..., None] = lambda *_: None,
    on_note: Callable[[str], None] = lambda text: None,
) -> DatasetCalibration:
    """Refines the lens and the poses of a dataset together and writes everything.

    Beside the lens file it writes report.json, report.html and the folder NAME-dataset with the
    refined poses. A Kannala-Brandt lens, which mrcal does not have, goes to NAME.yaml instead of a
    .cameramodel; the caller adds the nearest splined lens. Any other lens that the wanted form does
    not have goes to NAME.lens.json.

    Args:
        data: the dataset; its lens and poses are roughly right.
        out: the lens file.
        on_progress: called with stage, number done, total and words.
        on_note: called with each sentence that the user should know.

    Returns:
        The lens' file and a summary.

    Raises:
        InputError: wrong arguments or data.
        SolveError: the images do not determine the lens.
    """
    data = Path(data)
    _check_file(out)
    started = time.perf_counter()
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        on_note(text)

    found = refine_lens(data, PosesOptions(), on_progress, note)
    camera = found.camera.with_valid_field_angle(found.reach)
    pixels = spread_pixels(camera.width, camera.height)
    sigma = found.covariance.estimate_projection_sigma(camera, pixels.reshape(-1, 2))
    sigma = sigma.reshape(pixels.shape[:2])
    rim = float(np.nanmax(sigma))
    if not rim <= _UNCERTAIN_PX:
        notes.append(
            f"the lens is uncertain by up to {rim:.2f} px: give more images, turned in different "
            "directions, and train with --set calibration_weights"
        )
    file = _write_lens(camera, sigma, out)
    folder = out.with_name(f"{out.stem}-dataset")
    seconds = time.perf_counter() - started
    notes += _write_refined(found, camera, data, folder, notes, seconds)
    values = _list_results(found, camera, sigma) | {
        "file": file.name,
        "dataset": folder.name,
        "notes": notes,
        "seconds": round(seconds, 2),
    }
    write_file(out.parent / _REPORT_JSON, json.dumps(values, indent=2) + "\n")
    page = write_page(out.parent, found, camera, sigma, values)
    names = camera.param_names.split()
    summary = [
        f"{camera.model}: {values['images']} images, {values['points']} points, RMS "
        f"{values['rms_2d_px']:.3f} px 2-D; held-out observations "
        f"{values['held_out_before_px']:.3f} -> {values['held_out_after_px']:.3f} px; seen to "
        f"{values['valid_angle_degrees']:.1f} degrees",
        *(
            f"  {name} {row['before']:.8g} -> {row['after']:.8g} +- {row['sigma']:.2g}"
            for name, row in zip(names, values["params"], strict=False)
        ),
        f"poses: {folder / TRANSFORMS}",
        f"report: {page}",
    ]
    return DatasetCalibration(file, summary)


def _check_file(out: Path) -> None:
    if out.suffix.lower() not in _SUFFIXES:
        raise InputError(
            f"{out}: the lens' file name must end in {', '.join(_SUFFIXES[:-1])} or {_SUFFIXES[-1]}"
        )
    if not out.parent.is_dir():
        raise InputError(f"{out.parent}: this folder does not exist; make it")


def _write_lens(camera: Camera, sigma: np.ndarray, out: Path) -> Path:
    exact = out
    if out.suffix.lower() == ".cameramodel" and camera.model == "kannala_brandt":
        exact = out.with_suffix(".yaml")
    try:
        save_camera(camera, exact, "opencv" if exact.suffix.lower() != ".cameramodel" else "mrcal")
    except InputError:  # the wanted form has no such lens
        exact = out.with_suffix(OWN_SUFFIX)
        save_camera(camera, exact)
    save_uncertainty(exact, sigma)
    return exact


def _write_refined(
    found: RefinedLens, camera: Camera, data: Path, folder: Path, notes: list[str], seconds: float
) -> list[str]:
    """Writes the dataset with the refined lens and poses, keeping its split; returns notes."""
    solution = dataclasses.replace(found.solution, cameras=[camera] * len(found.solution.cameras))
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make {folder}: {error.strerror}") from error
    more = write_dataset(solution, found.photographs, folder)
    listing = read_dataset(data)
    path = folder / TRANSFORMS
    values = json.loads(path.read_text(encoding="utf-8"))
    names = solution.registered_names
    files = [frame["file_path"] for frame in values["frames"]]
    new_name = dict(zip(names, files, strict=True))
    for key, listed in (
        ("train_filenames", listing.listed_train),
        ("test_filenames", listing.listed_test),
    ):
        if listed is not None:
            values[key] = [new_name[name] for name in listed if name in new_name]
    write_file(path, json.dumps(values, indent=1) + "\n")
    row = list_figures(solution, {"total": seconds}, notes + more, {"lens": "refined"})
    write_report(folder, solution, row)
    more.append(f"residuals by field angle: {folder / REPORT}")
    return more


def _list_results(found: RefinedLens, camera: Camera, sigma: np.ndarray) -> dict[str, Any]:
    """Lists the values of report.json that the refinement gives."""
    solution = found.solution
    good = np.isfinite(solution.residuals).all(axis=1)
    rms = float(np.sqrt(np.mean(np.sum(solution.residuals[good] ** 2, axis=1))))
    names = camera.param_names.split()
    before, after, sigmas = found.before.params, camera.params, found.covariance.sigmas
    return {
        "lens": camera.model,
        "solver": "bundle adjustment",
        "images_total": len(solution.names),
        "images": solution.num_registered,
        "points": len(solution.points),
        "observations": len(solution.observations),
        "rms_2d_px": rms,
        "rms_axis_px": rms / float(np.sqrt(2)),
        "median_px": solution.median,
        "noise_px": found.covariance.noise,
        "held_out_observations": found.held_out,
        "held_out_before_px": keep_finite(found.held_out_before_px),
        "held_out_after_px": keep_finite(found.held_out_after_px),
        "valid_angle_degrees": float(np.degrees(found.reach)),
        "lens_domain_degrees": float(np.degrees(found.camera.max_angle)),
        "uncertainty_px": {
            "best": keep_finite(np.nanmin(sigma)),
            "median": keep_finite(np.nanmedian(sigma)),
            "worst": keep_finite(np.nanmax(sigma)),
        },
        "params": [
            {
                "name": names[i] if i < len(names) else f"{i}",
                "before": float(before[i]),
                "after": float(after[i]),
                "sigma": float(sigmas[i]),
            }
            for i in range(len(after))
        ],
    }
