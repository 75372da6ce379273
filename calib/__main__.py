"""`python -m calib JOB.json`: runs a job; exit status 2 and one sentence where it cannot."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2

from calib.calibrate import calibrate
from calib.errors import BoardError, SolveError
from calib.job import read_job
from gsut import InputError

_EXIT_INPUT, _EXIT_INTERRUPTED = 2, 130


def main() -> int:
    """Runs the job named by the only argument; prints what was found."""
    if len(sys.argv) != 2:
        print("usage: python -m calib JOB.json (see calib/job.py)", file=sys.stderr)
        return _EXIT_INPUT
    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # libjpeg and OpenCV would write under the progress bar
    try:
        job = read_job(Path(sys.argv[1]))
        result = calibrate(job)
    except (BoardError, SolveError, InputError) as error:
        print(f"gsut: error: {' '.join(str(error).split())}", file=sys.stderr)
        return _EXIT_INPUT
    except OSError as error:
        print(f"gsut: error: {error.filename}: {error.strerror}", file=sys.stderr)
        return _EXIT_INPUT
    except KeyboardInterrupt:
        print("\ngsut: stopped", file=sys.stderr)
        return _EXIT_INTERRUPTED
    for note in result.notes:
        print(f"gsut: note: {note}", file=sys.stderr)
    for camera, trust in zip(result.cameras, result.trusts, strict=True):
        outliers = int(camera.outliers.sum())
        print(
            f"{camera.name}: {camera.lens} by {camera.solver}, {len(camera.photographs)} boards, "
            f"RMS {camera.rms_2d_px:.3f} px 2-D ({camera.rms_axis_px:.3f} an axis), "
            f"{outliers} outliers, trusted to {trust.valid_angle * 57.29578:.1f} degrees"
        )
    for path in result.lens_files:
        print(f"lens: {path}")
    print(f"report: {job.out.parent / 'report.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
