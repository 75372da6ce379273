"""Everything that a calibration found out; what the reports show."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from calib.board import Board, Photograph
from calib.cross_validation import HeldOut
from calib.halves import Halves
from calib.job import Job
from calib.second_lens import SecondLens
from calib.solution import CameraSolution
from calib.trust import Trust


@dataclass
class Result:
    """A calibration, finished or refused.

    second_lenses: of each camera, other lenses of the same boards.
    """

    job: Job
    board: Board
    photographs: list[Photograph]
    cameras: list[CameraSolution]
    trusts: list[Trust]
    held_out: dict[str, list[HeldOut]]
    halves: list[Halves | None]
    second_lenses: list[list[SecondLens]]
    lens_files: list[Path]
    pictures: list[Path]
    rig_rms_px: float | None
    seconds: float
    notes: list[str] = field(default_factory=list)

    @property
    def refusals(self) -> list[str]:
        """Why lenses must not be used."""
        return [trust.refusal for trust in self.trusts if trust.refusal]
