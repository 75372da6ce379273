"""Describes what to calibrate and with what, and checks it before any work begins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calib.boards import Board
from calib.camera import LENSES
from calib.errors import BoardError
from calib.solve import MRCAL_LENSES, OPENCV_LENSES, has_mrcal

LENS_CHOICES = ("auto", *LENSES)
SOLVERS = ("auto", "opencv", "mrcal")
SUFFIXES = (".cameramodel", ".yaml", ".yml", ".json")
_DEFAULT_SOLVER = {"fisheye": "opencv", "opencv4": "mrcal", "opencv8": "mrcal", "splined": "mrcal"}


@dataclass(frozen=True)
class Job:
    """One calibration.

    Args:
        images: files, of all cameras. board: number of inner corners, such as "9x6".
        spacing: side of a square.
        out: the lens file; for a rig NAME.cameramodel becomes NAME-CAMERA.cameramodel.
        lens: one of LENS_CHOICES. solver: one of SOLVERS. cameras: names of the rig's cameras.
        knot_degrees: between the knots of a splined lens; None: from the number of corners.
        progress: show bars.

    Raises:
        BoardError: a value is impossible, or two do not go together.
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
        self.parse_board()
        if self.out.suffix.lower() not in SUFFIXES:
            raise BoardError(
                f"{self.out}: the lens' file name must end in {', '.join(SUFFIXES[:-1])} or "
                f"{SUFFIXES[-1]}"
            )
        if not self.images:
            raise BoardError("no images were given")
        for name, value, known in (
            ("lens", self.lens, LENS_CHOICES),
            ("solver", self.solver, SOLVERS),
        ):
            if value not in known:
                raise BoardError(f"unknown {name} {value!r}; known: {', '.join(known)}")
        able = {"opencv": OPENCV_LENSES, "mrcal": MRCAL_LENSES}
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

    def parse_board(self) -> Board:
        """Parses the board's size.

        Raises:
            BoardError: no board has this size.
        """
        return Board.parse(self.board, self.spacing)

    def choose_solver(self, lens: str) -> str:
        """Chooses the solver of a lens: the one given, or the best that is installed."""
        if self.solver != "auto":
            return self.solver
        if self.lens == "auto" and not has_mrcal():
            return "opencv"
        return _DEFAULT_SOLVER[lens]
