"""Holds everything that a calibration found, as the reports show it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import gsut
from calib.boards import Board, Photograph
from calib.camera import CameraSolution
from calib.job import Job
from calib.trust import Halves, HeldOut, SecondLens, Trust

_COVERED = 0.005  # share of the image without a ray that is worth no photograph


@dataclass
class Result:
    """A calibration, finished or refused; lists are in the order of `cameras`.

    Args:
        job, board: what to calibrate. photographs: of all cameras. cameras: solved.
        trusts: of each camera. held_out: cross-validation of the lenses, by camera.
        halves: of odd and even photographs. second_lenses: other lenses of the same boards.
        lens_files: written. pictures: of the photographs. rig_rms_px: with one pose of the rig.
        seconds: elapsed. notes: sentences for the user.
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

    def summarize(self) -> list[str]:
        """Summarizes the calibration in a line for each camera and each file."""
        lines = [
            f"{camera.name}: {camera.lens} by {camera.solver}, {len(camera.photographs)} boards, "
            f"RMS {camera.rms_2d_px:.3f} px 2-D ({camera.rms_axis_px:.3f} an axis), "
            f"{int(camera.outliers.sum())} outliers, "
            f"trusted to {np.degrees(trust.valid_angle):.1f} degrees"
            for camera, trust in zip(self.cameras, self.trusts, strict=True)
        ]
        for path, trust in zip(self.lens_files, self.trusts, strict=True):
            lines += [f"lens: {path}", _judge_field(path, trust.valid_angle)]
        return [*lines, f"report: {self.job.out.parent / 'report.html'}"]


def _judge_field(lens: Path, valid_angle: float) -> str:
    """Says how much of the image a lens gives rays to, and where boards are missing.

    Some formats hold no field angle, so it is given.
    """
    camera = gsut.load_camera(lens).with_valid_field_angle(valid_angle)
    blind = float(np.mean(~np.asarray(camera.rays()[1], bool)))
    if blind < _COVERED:
        return "verdict: the lens covers the whole image; next: gsut poses IMAGES --camera " + str(
            lens
        )
    return (
        f"verdict: {blind:.0%} of the image has no ray and does not count in training; "
        "where it shows the scene, photograph the board there, up to the edge, and calibrate again"
    )
