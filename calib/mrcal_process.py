"""Runs mrcal of the system's packages as a subprocess: it breaks in a process with numpy 2."""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gsut
from calib.errors import BoardError, SolveError

PYTHON = "/usr/bin/python3"  # the interpreter that Debian's python3-mrcal is built for
CALIBRATE = "mrcal-calibrate-cameras"
INSTALL = "sudo apt-get install mrcal python3-mrcal"
_INSIDE = Path(__file__).with_name("inside_mrcal.py")
# Of the virtual environment: they would put its numpy 2 in front of the system's.
_NOT_INHERITED = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
_LINES_SHOWN = 3  # of what a failed program printed last


@functools.cache
def have_mrcal() -> bool:
    """Whether mrcal's command-line tools and Python module are installed."""
    if shutil.which(CALIBRATE) is None or not Path(PYTHON).exists():
        return False
    found = subprocess.run(
        [PYTHON, "-c", "import mrcal"], env=_environment(), capture_output=True, check=False
    )
    return found.returncode == 0


def require_mrcal() -> None:
    """Raises BoardError with the one command that installs mrcal, where it is missing."""
    if not have_mrcal():
        raise BoardError(
            f"mrcal is not installed, and this lens needs it: run `{INSTALL}`, "
            "or choose --solver opencv"
        )


def calibrate_cameras(arguments: Sequence[str], folder: Path) -> str:
    """Runs mrcal-calibrate-cameras in a folder; returns what it printed.

    Raises:
        SolveError: it failed; the message ends with what it said last.
    """
    program = shutil.which(CALIBRATE)
    if program is None:
        require_mrcal()
    return _run([PYTHON, str(program), *arguments], folder, "mrcal-calibrate-cameras")


def ask(question: dict[str, Any]) -> dict[str, Any]:
    """Has inside_mrcal.py answer a question; both are JSON.

    Args:
        question: "do" names the answer's kind, see inside_mrcal.py; texts of .cameramodel files
            under "models".

    Raises:
        SolveError: mrcal failed.
    """
    with tempfile.TemporaryDirectory(prefix="gsut-calib-") as name:
        folder = Path(name)
        asked, answered = folder / "question.json", folder / "answer.json"
        asked.write_text(json.dumps(question), encoding="utf-8")
        package = Path(gsut.__file__).parent
        _run([PYTHON, str(_INSIDE), str(asked), str(answered), str(package)], folder, "mrcal")
        return json.loads(answered.read_text(encoding="utf-8"))


def _run(command: Sequence[str], folder: Path, name: str) -> str:
    done = subprocess.run(
        command, cwd=folder, env=_environment(), capture_output=True, encoding="utf-8",
        errors="replace", check=False,
    )  # fmt: skip
    if done.returncode != 0:
        lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        said = " / ".join(lines[-_LINES_SHOWN:]) or f"exit status {done.returncode}"
        raise SolveError(f"{name} failed: {said}")
    return done.stdout


def _environment() -> dict[str, str]:
    return {key: value for key, value in os.environ.items() if key not in _NOT_INHERITED}
