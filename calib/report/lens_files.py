"""Writes solved lenses as files of mrcal or OpenCV, with their trusted field."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np

from calib.camera import CameraSolution, invert, to_gsut_camera
from calib.errors import BoardError
from calib.solve import fit_splined
from calib.trust import Trust, trace_trusted_outline
from gsut.files import write_file
from gsut.lens import save_camera

# Keys that mrcal does not know and skips; its C reader takes numbers and lists of them only.
ANGLE_KEY = "gsut_valid_field_angle"  # radians
SIGMA_KEY = "gsut_uncertainty_px"  # rows of the map over the image, corner to corner
NO_SIGMA = -1.0  # marks pixels where the lens has no ray
DIGITS = 6  # decimals of a number in a report, and of the map, in pixels


def write_lens(path: Path, camera: CameraSolution, trust: Trust, origin: str) -> list[str]:
    """Writes one camera's lens file.

    mrcal has no Kannala-Brandt lens: a .cameramodel then holds the splined lens that is nearest to
    it, and a .yaml beside it the exact one. OpenCV's formats hold neither the uncertainty, which
    goes to NAME.uncertainty.json, nor splined lenses.

    Args:
        path: the file. camera: the solution. trust: how far it holds.
        origin: comment lines for the head of the file.

    Returns:
        Notes on what else was written.

    Raises:
        BoardError: the format cannot hold this lens.
    """
    if path.suffix.lower() != ".cameramodel":
        return _write_opencv(path, camera, trust)
    notes = []
    if camera.model_text is not None:
        values = ast.literal_eval(camera.model_text)
    else:
        values = {
            "lensmodel": camera.model,
            "intrinsics": camera.params.tolist(),
            "extrinsics": [],
            "imagersize": [camera.width, camera.height],
        }
        if camera.lens == "fisheye":
            exact = name_exact_file(path, camera)
            notes = _write_opencv(exact, camera, trust)
            model, params, error = fit_splined(camera, trust.domain)
            values.update(lensmodel=model, intrinsics=params)
            notes.append(
                f"{path.name}: mrcal has no Kannala-Brandt lens; this is the splined lens nearest "
                f"to it, {error:.1e} px off at most; the lens itself is {exact.name}"
            )
    values["extrinsics"] = camera.camera_from_reference.tolist()
    values["valid_intrinsics_region"] = trace_trusted_outline(camera, trust.valid_angle).tolist()
    values[ANGLE_KEY] = float(trust.valid_angle)
    values[SIGMA_KEY] = _round_map(trust.sigma)
    lines = [f"# {line}" for line in origin.splitlines()]
    lines += ["{", *(f"    {key!r}: {value!r}," for key, value in values.items()), "}"]
    write_file(path, "\n".join(lines) + "\n")
    return notes


def name_exact_file(path: Path, camera: CameraSolution) -> Path:
    """Names the file that holds a lens exactly, where `write_lens` writes to `path`."""
    is_near = path.suffix.lower() == ".cameramodel" and camera.lens == "fisheye"
    return path.with_suffix(".yaml") if is_near else path


def _write_opencv(path: Path, camera: CameraSolution, trust: Trust) -> list[str]:
    if camera.lens == "splined":
        raise BoardError(f"{path}: only mrcal has splined lenses; give -o a .cameramodel file")
    lens = to_gsut_camera(camera).with_valid_field_angle(trust.valid_angle)
    save_camera(lens, path, "opencv")
    side = path.with_suffix(".uncertainty.json")
    write_file(side, json.dumps({SIGMA_KEY: _round_map(trust.sigma)}) + "\n")
    return [f"{side.name} holds the uncertainty of {path.name}"]


def _round_map(sigma: np.ndarray) -> list[list[float]]:
    return [
        [round(float(value), DIGITS) if np.isfinite(value) else NO_SIGMA for value in row]
        for row in sigma
    ]


def measure_baseline(camera: CameraSolution) -> float:
    """Measures the distance of a camera's centre from the reference camera's, in board units."""
    return float(np.linalg.norm(invert(camera.camera_from_reference)[3:]))
