"""What to calibrate: the job file that `gsut calibrate` writes and `python -m calib` reads."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from calib import solve_mrcal, solve_opencv
from calib.board import Board
from calib.errors import BoardError
from calib.lens_files import require_suffix
from calib.mrcal_process import have_mrcal
from calib.solution import LENSES

LENS_CHOICES = ("auto", *LENSES)
SOLVERS = ("auto", "opencv", "mrcal")
_DEFAULT_SOLVER = {"fisheye": "opencv", "opencv4": "mrcal", "opencv8": "mrcal", "splined": "mrcal"}


@dataclass(frozen=True)
class Job:
    """One calibration.

    Args:
        images: files, of all cameras. board: "9x6", inner corners. spacing: side of a square.
        out: the lens' file; for a rig NAME.cameramodel becomes NAME-CAMERA.cameramodel.
        lens: one of LENS_CHOICES. solver: one of SOLVERS. cameras: names of the rig's cameras.
        knot_degrees: between knots of a splined lens; None: from the number of corners.
        progress: show bars.
    """

    images: tuple[Path, ...]
    board: str
    spacing: float
    out: Path
    lens: str = "auto"
    solver: str = "auto"
    cameras: tuple[str, ...] = ()
    knot_degrees: float | None = None
    progress: bool = True

    def __post_init__(self) -> None:
        self.chessboard()
        require_suffix(self.out)
        if not self.images:
            raise BoardError("no images were given")
        for name, value, known in (
            ("lens", self.lens, LENS_CHOICES),
            ("solver", self.solver, SOLVERS),
        ):
            if value not in known:
                raise BoardError(f"unknown {name} {value!r}; known: {', '.join(known)}")
        able = {"opencv": solve_opencv.LENS_NAMES, "mrcal": solve_mrcal.LENS_NAMES}
        if self.lens != "auto" and self.solver != "auto" and self.lens not in able[self.solver]:
            raise BoardError(
                f"the solver {self.solver} has no {self.lens} lens; "
                f"it has {', '.join(able[self.solver])}"
            )
        if self.lens == "splined" and self.out.suffix.lower() != ".cameramodel":
            raise BoardError(f"{self.out}: a splined lens needs a .cameramodel file")
        if not self.out.parent.is_dir():
            raise BoardError(f"{self.out.parent}: this folder does not exist; make it")
        if self.knot_degrees is not None and not 2.0 <= self.knot_degrees <= 90.0:
            raise BoardError(f"knots must be 2 to 90 degrees apart, found {self.knot_degrees}")

    def chessboard(self) -> Board:
        """The board.

        Raises:
            BoardError: no such board.
        """
        return Board.parse(self.board, self.spacing)

    def solver_for(self, lens: str) -> str:
        """Which solver a lens is solved with."""
        if self.solver != "auto":
            return self.solver
        if self.lens == "auto" and not have_mrcal():
            return "opencv"
        return _DEFAULT_SOLVER[lens]


def read_job(path: Path) -> Job:
    """A job from its JSON file.

    Raises:
        BoardError: not a job; the message names the file and the key.
    """
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise BoardError(f"{path}: not a readable job ({error})") from None
    known = {f.name for f in fields(Job)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise BoardError(f"{path}: unknown key {unknown[0]!r}; known: {', '.join(sorted(known))}")
    missing = sorted({"images", "board", "spacing", "out"} - set(values))
    if missing:
        raise BoardError(f"{path}: the key {missing[0]!r} is missing")
    values["images"] = tuple(Path(image) for image in values["images"])
    values["cameras"] = tuple(values.get("cameras") or ())
    values["out"] = Path(values["out"])
    return Job(**values)
