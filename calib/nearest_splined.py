"""Writes a Kannala-Brandt lens file as the .cameramodel that mrcal can read: the nearest splined.

    python -m calib.nearest_splined LENS.yaml OUT.cameramodel

LENS.uncertainty.json, if it is there, goes with it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

import gsut
from calib.errors import BoardError
from calib.lens import PIXEL_SHIFT
from calib.lens_files import NO_SIGMA, SIGMA_KEY, write_lens
from calib.solution import CameraSolution
from calib.trust import Trust
from calib.uncertainty import UNKNOWN, spread_pixels

_EXIT_INPUT = 2


def nearest_splined(lens: Path, out: Path) -> list[str]:
    """Writes `out`; returns notes.

    Raises:
        BoardError: not a Kannala-Brandt lens.
        gsut.InputError, OSError: the file cannot be read.
    """
    camera = gsut.load_camera(lens)
    if camera.model != "kannala_brandt" or len(camera.params) != 8:
        raise BoardError(
            f"{lens}: the lens is {camera.model} with {len(camera.params)} parameters; this writes "
            "kannala_brandt with 8"
        )
    solution = known_fisheye(camera)
    side = lens.with_suffix(".uncertainty.json")
    sigma = np.full(spread_pixels(camera.width, camera.height).shape[:2], UNKNOWN)
    if side.is_file():
        rows = np.array(json.loads(side.read_text(encoding="utf-8"))[SIGMA_KEY])
        sigma = np.where(rows == NO_SIGMA, UNKNOWN, rows)
    domain = float(camera.with_valid_field_angle(None).max_angle)
    valid = camera.valid_field_angle or domain
    trust = Trust(valid, valid, domain, sigma, 0.0)
    return write_lens(out, solution, trust, f"gsut calibrate --from-dataset: {lens.name}")


def known_fisheye(camera: gsut.Camera) -> CameraSolution:
    """A Kannala-Brandt lens that no boards have given, as if it were a solution."""
    params = np.array(camera.params)
    params[2:4] -= PIXEL_SHIFT
    return CameraSolution(
        name="camera",
        lens="fisheye",
        solver="gsut",
        width=camera.width,
        height=camera.height,
        model="KANNALA_BRANDT",
        params=params,
        camera_from_reference=np.zeros(6),
        photographs=[],
        camera_from_board=np.empty((0, 6)),
        residuals=np.empty((0, 0, 2)),
        outliers=np.empty((0, 0), bool),
    )


def main() -> int:
    """Exit status 2 and one sentence where it cannot."""
    if len(sys.argv) != 3:
        print("usage: python -m calib.nearest_splined LENS.yaml OUT.cameramodel", file=sys.stderr)
        return _EXIT_INPUT
    try:
        notes = nearest_splined(Path(sys.argv[1]), Path(sys.argv[2]))
    except (BoardError, gsut.InputError) as error:
        print(f"gsut: error: {error}", file=sys.stderr)
        return _EXIT_INPUT
    except OSError as error:
        print(f"gsut: error: {error.filename}: {error.strerror}", file=sys.stderr)
        return _EXIT_INPUT
    for note in notes:
        print(f"gsut: note: {note}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
