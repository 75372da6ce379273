"""Runs mrcal of the system's packages as a subprocess: it breaks in a process with numpy 2."""

from __future__ import annotations

import functools
import itertools
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.boards import Board, Photograph, write_vnl
from calib.errors import BoardError, SolveError
from gsut.files import read_json, read_text, write_file

PYTHON = "/usr/bin/python3"  # the interpreter that Debian's python3-mrcal is built for
CALIBRATE = "mrcal-calibrate-cameras"
INSTALL = "sudo apt-get install mrcal python3-mrcal"
_INSIDE = Path(__file__).with_name("inside_mrcal.py")
# Variables of a virtual environment, which would put its numpy 2 in front of the system's.
_NOT_INHERITED = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
_LINES_SHOWN = 3  # of the last output of a failed program


@functools.cache
def has_mrcal() -> bool:
    """Returns whether mrcal's command-line tools and Python module are installed."""
    if shutil.which(CALIBRATE) is None or not Path(PYTHON).exists():
        return False
    found = subprocess.run(
        [PYTHON, "-c", "import mrcal"], env=_clean_environment(), capture_output=True, check=False
    )
    return found.returncode == 0


def require_mrcal() -> None:
    """Raises BoardError with the command that installs mrcal if it is missing."""
    if not has_mrcal():
        raise BoardError(
            f"mrcal is not installed, and this lens needs it: run `{INSTALL}`, "
            "or choose --solver opencv"
        )


def calibrate_cameras(
    model: str,
    groups: Sequence[Sequence[Photograph]],
    names: Sequence[Sequence[str]],
    focals: Sequence[float],
    board: Board,
) -> str:
    """Runs mrcal-calibrate-cameras and returns the .cameramodel of the first camera.

    Args:
        model: mrcal's name of the lens. groups: photographs with corners, of each camera.
        names: of these images: "cameraC-NNNNN.jpg", equal numbers for images taken together.
        focals: starts of each camera's focal length, in pixels. board: the chessboard.

    Raises:
        SolveError: it failed; the message ends with its last output.
    """
    require_mrcal()
    first = groups[0][0]
    with tempfile.TemporaryDirectory(prefix="gsut-calib-") as name:
        folder = Path(name)
        chain = itertools.chain.from_iterable
        write_vnl(folder / "corners.vnl", list(chain(groups)), list(chain(names)))
        arguments = {
            "--corners-cache": "corners.vnl",
            "--lensmodel": model,
            "--focal": ",".join(f"{focal:.3f}" for focal in focals),
            "--object-spacing": repr(board.spacing),
            "--object-width-n": str(board.columns),
            "--object-height-n": str(board.rows),
            "--outdir": ".",
        }
        words = [word for pair in arguments.items() for word in pair]
        words += ["--imagersize", str(first.width), str(first.height)]
        words += [f"camera{index}-*.jpg" for index in range(len(groups))]
        _run([PYTHON, str(shutil.which(CALIBRATE)), *words], folder, CALIBRATE)
        return read_text(folder / "camera-0.cameramodel")


def ask(question: dict[str, Any]) -> dict[str, Any]:
    """Returns the answer of inside_mrcal.py to a question; both travel as JSON.

    Args:
        question: "do" names a function of inside_mrcal.py, "model" is the text of a .cameramodel;
            the other keys are its own. Arrays become lists.

    Raises:
        SolveError: mrcal failed.
    """
    with tempfile.TemporaryDirectory(prefix="gsut-calib-") as name:
        folder = Path(name)
        asked, answered = folder / "question.json", folder / "answer.json"
        write_file(asked, json.dumps(question, default=np.ndarray.tolist))
        _run([PYTHON, str(_INSIDE), str(asked), str(answered)], folder, "mrcal")
        return read_json(answered, dict)


def _run(command: Sequence[str], folder: Path, name: str) -> None:
    done = subprocess.run(
        command, cwd=folder, env=_clean_environment(), capture_output=True, encoding="utf-8",
        errors="replace", check=False,
    )  # fmt: skip
    if done.returncode != 0:
        lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        said = " / ".join(lines[-_LINES_SHOWN:]) or f"exit status {done.returncode}"
        raise SolveError(f"{name} failed: {said}")


def _clean_environment() -> dict[str, str]:
    return {key: value for key, value in os.environ.items() if key not in _NOT_INHERITED}
