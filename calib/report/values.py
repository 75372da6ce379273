"""Collects the figures of a calibration and writes them to report.json, for programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import CameraSolution
from calib.report.lens_files import DIGITS, measure_baseline, name_exact_file
from calib.report.result import Result
from calib.trust import AGREEMENT_DEGREES, TRUSTED_SIGMA_PX
from gsut.files import write_file

REPORT_JSON = "report.json"
_REGIONS = 3  # columns and rows of the image whose residuals are summarized


def collect_values(result: Result) -> dict[str, Any]:
    """Collects the content of report.json: totals of all cameras, and each under "cameras".

    Lengths are in the board's unit (that of --spacing), angles in degrees, residuals in pixels.
    """
    inliers = [c.residuals[~c.outliers] for c in result.cameras]
    squares = np.concatenate([np.sum(r**2, axis=1) for r in inliers])
    rms = float(np.sqrt(np.mean(squares)))
    cameras = {
        camera.name: _collect_camera_values(result, index)
        for index, camera in enumerate(result.cameras)
    }
    return {
        "lens": result.cameras[0].lens,
        "solver": result.cameras[0].solver,
        "boards_total": len(result.photographs),
        "boards_found": sum(p.corners is not None for p in result.photographs),
        "rms_2d_px": rms,
        "rms_axis_px": rms / float(np.sqrt(2)),
        "outliers": int(sum(c.outliers.sum() for c in result.cameras)),
        "valid_angle_degrees": min(c["valid_angle_degrees"] for c in cameras.values()),
        "trusted_sigma_px": TRUSTED_SIGMA_PX,
        "board": {
            "columns": result.board.columns,
            "rows": result.board.rows,
            "spacing": result.board.spacing,
        },
        "refused": result.refusals,
        "notes": result.notes,
        "seconds": round(result.seconds, 2),
        "rig_rms_2d_px": result.rig_rms_px,
        "cameras": cameras,
    }


def _collect_camera_values(result: Result, index: int) -> dict[str, Any]:
    camera, trust = result.cameras[index], result.trusts[index]
    mine = [p for p in result.photographs if p.camera == camera.name]
    halves = result.halves[index]
    files = result.lens_files
    degrees = np.degrees
    return {
        "lens": camera.lens,
        "solver": camera.solver,
        "model": camera.model,
        "file": name_exact_file(files[index], camera).name if files else None,
        "width": camera.width,
        "height": camera.height,
        "boards_total": len(mine),
        "boards_found": len(camera.photographs),
        "rms_2d_px": camera.rms_2d_px,
        "rms_axis_px": camera.rms_axis_px,
        "outliers": int(camera.outliers.sum()),
        "valid_angle_degrees": float(degrees(trust.valid_angle)),
        "boards_reached_degrees": float(degrees(trust.reach)),
        "lens_domain_degrees": float(degrees(trust.domain)),
        "image_without_ray": trust.without_ray,
        "uncertainty_px": _summarize_sigma(trust.sigma),
        "refused": trust.refusal or None,
        "board_warp": None if camera.warp is None else list(camera.warp),
        "camera_from_reference": camera.camera_from_reference.tolist(),
        "distance_to_reference": measure_baseline(camera),
        "halves_median_degrees": None if halves is None else halves.median_degrees,
        "halves_worst_degrees": None if halves is None else halves.worst_degrees,
        "agreement_degrees": AGREEMENT_DEGREES,
        "second_lenses": [
            {
                "lens": other.lens,
                "solver": other.solver,
                "rms_2d_px": other.rms_2d_px,
                "compared_to_degrees": float(degrees(other.compared_to)),
                "agrees_to_degrees": float(degrees(other.agrees_to)),
                "agrees_at_the_boards_to_degrees": float(degrees(other.agrees_near_to)),
                "boards_distance": other.distance,
            }
            for other in result.second_lenses[index]
        ],
        "cross_validation": [
            {
                "lens": h.lens,
                "parameters": h.parameters,
                "rms_2d_px": h.rms_px,
                "standard_error_px": h.standard_error_px,
                "chosen": h.chosen,
                "problem": h.problem or None,
            }
            for h in result.held_out.get(camera.name, [])
        ],
        "images": _list_images(camera, mine),
        "regions": _summarize_regions(camera),
    }


def _summarize_sigma(sigma: np.ndarray) -> dict[str, float | None]:
    if not np.isfinite(sigma).any():
        return {"best": None, "median": None}
    return {"best": float(np.nanmin(sigma)), "median": float(np.nanmedian(sigma))}


def _list_images(camera: CameraSolution, photographs: list) -> list[dict[str, Any]]:
    """Lists each photograph: whether it was used, and the residuals of its corners."""
    used = {id(photograph): i for i, photograph in enumerate(camera.photographs)}
    rows = []
    for photograph in photographs:
        row: dict[str, Any] = {"file": str(photograph.path), "found": id(photograph) in used}
        if row["found"]:
            i = used[id(photograph)]
            row["rms_2d_px"] = _compute_rms(camera.residuals[i][~camera.outliers[i]])
            row["outliers"] = int(camera.outliers[i].sum())
            row["edge_width_px"] = photograph.edge_width
            row["detector"] = photograph.detector
        else:
            row["reason"] = photograph.reason
        rows.append(row)
    return rows


def _summarize_regions(camera: CameraSolution) -> list[dict[str, Any]]:
    """Summarizes residuals in _REGIONS x _REGIONS parts of the image: a mean shows a misfit."""
    good = ~camera.outliers
    pixels, left = camera.corners[good], camera.residuals[good]
    size = np.array([camera.width, camera.height])
    cell = np.clip((pixels + 0.5) * _REGIONS / size, 0, _REGIONS - 1).astype(int)
    rows = []
    for y in range(_REGIONS):
        for x in range(_REGIONS):
            inside = left[(cell[:, 0] == x) & (cell[:, 1] == y)]
            mean = inside.mean(axis=0).tolist() if len(inside) else None
            rows.append(
                {
                    "column": x,
                    "row": y,
                    "corners": len(inside),
                    "rms_2d_px": _compute_rms(inside),
                    "mean_px": mean,
                }
            )
    return rows


def _compute_rms(residuals: np.ndarray) -> float | None:
    if not len(residuals):
        return None
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def write_report_json(folder: Path, result: Result) -> Path:
    """Writes FOLDER/report.json; numbers that are not finite become null."""
    path = folder / REPORT_JSON
    write_file(path, json.dumps(_to_json(collect_values(result)), indent=2) + "\n")
    return path


def _to_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_json(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_json(entry) for entry in value]
    if isinstance(value, (float, np.floating)):
        return round(float(value), DIGITS) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
