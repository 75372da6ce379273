"""Describes what to calibrate and with what, and checks it before any work begins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calib.boards import Board
from calib.errors import BoardError
from calib.solve import MRCAL_LENSES, OPENCV_LENSES, has_mrcal

SUFFIXES = (".cameramodel", ".yaml", ".yml", ".json")
_DEFAULT_SOLVER = {"fisheye": "opencv", "opencv4": "mrcal", "opencv8": "mrcal", "splined": "mrcal"}


@dataclass(frozen=True)
class Job:
    """One calibration.

    Args:
        images: files, of all cameras. board: number of inner corners, such as "9x6".
        spacing: side of a square.
        out: the lens file; for a rig NAME.cameramodel becomes NAME-CAMERA.cameramodel.
        lens: "auto" or a name of LENSES. solver: "auto", "opencv" or "mrcal".
        cameras: names of the rig's cameras.
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
    progress: bool = True

    def __post_init__(self) -> None:
        self.parse_board()
        if self.out.suffix.lower() not in SUFFIXES:
            raise BoardError(
                f"{self.out}: the lens' file name must end in {', '.join(SUFFIXES[:-1])} or "
                f"{SUFFIXES[-1]}"
            )
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
