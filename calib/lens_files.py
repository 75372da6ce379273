"""Writes solved lenses: mrcal's .cameramodel and OpenCV's YAML, with how far to trust them."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import BoardError
from calib.lens import gsut_camera
from calib.rigid import inverse
from calib.solution import CameraSolution
from calib.splined_fit import splined_like
from calib.trust import Trust, trusted_outline
from gsut.files import write_file
from gsut.lens import save_camera

SUFFIXES = (".cameramodel", ".yaml", ".yml", ".json")
# Keys that mrcal does not know and skips; its C reader takes numbers and lists of them only.
ANGLE_KEY = "gsut_valid_field_angle"  # radians
SIGMA_KEY = "gsut_uncertainty_px"  # rows of the map over the image, corner to corner
NO_SIGMA = -1.0  # where the lens has no ray
_DIGITS = 6  # of the map


def require_suffix(path: Path) -> None:
    """Raises BoardError for a name that chooses no format."""
    if path.suffix.lower() not in SUFFIXES:
        raise BoardError(
            f"{path}: the lens' file name must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
        )


def write_lens(path: Path, camera: CameraSolution, trust: Trust, origin: str) -> list[str]:
    """Writes one camera's lens under a temporary name and renames it.

    mrcal has no Kannala-Brandt lens: asked for one in a .cameramodel, this writes the splined lens
    that is nearest to it, and the exact one to a .yaml beside it. OpenCV's formats hold neither
    the uncertainty (it goes to NAME.uncertainty.json) nor splined lenses.

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
        values = _plain_values(camera)
        if camera.lens == "fisheye":
            exact = path.with_suffix(".yaml")
            notes = _write_opencv(exact, camera, trust)
            model, params, error = splined_like(camera, trust.domain)
            values.update(lensmodel=model, intrinsics=params)
            notes.append(
                f"{path.name}: mrcal has no Kannala-Brandt lens; this is the splined lens nearest "
                f"to it, {error:.1e} px off at most; the lens itself is {exact.name}"
            )
    values["extrinsics"] = camera.camera_from_reference.tolist()
    values["valid_intrinsics_region"] = trusted_outline(camera, trust.valid_angle).tolist()
    values[ANGLE_KEY] = float(trust.valid_angle)
    values[SIGMA_KEY] = _map(trust.sigma)
    lines = [f"# {line}" for line in origin.splitlines()]
    lines += ["{", *(f"    {key!r}: {value!r}," for key, value in values.items()), "}"]
    write_file(path, "\n".join(lines) + "\n")
    return notes


def _plain_values(camera: CameraSolution) -> dict[str, Any]:
    return {
        "lensmodel": camera.model,
        "intrinsics": camera.params.tolist(),
        "extrinsics": [],
        "imagersize": [camera.width, camera.height],
    }


def _write_opencv(path: Path, camera: CameraSolution, trust: Trust) -> list[str]:
    if camera.lens == "splined":
        raise BoardError(f"{path}: OpenCV has no splined lens; give -o a .cameramodel file")
    lens = gsut_camera(camera).with_valid_field_angle(trust.valid_angle)
    save_camera(lens, path, "opencv")
    side = path.with_suffix(".uncertainty.json")
    write_file(side, json.dumps({SIGMA_KEY: _map(trust.sigma)}) + "\n")
    return [f"{side.name} holds the uncertainty of {path.name}"]


def _map(sigma: np.ndarray) -> list[list[float]]:
    return [
        [round(float(value), _DIGITS) if np.isfinite(value) else NO_SIGMA for value in row]
        for row in sigma
    ]


def baseline(camera: CameraSolution) -> float:
    """Distance between a camera's centre and the reference camera's, in the board's unit."""
    return float(np.linalg.norm(inverse(camera.camera_from_reference)[3:]))
