"""report.html: one self-contained page of a calibration, in pictures and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2

from calib.report_json import report_values
from calib.report_plots import (
    angle_picture,
    coverage_picture,
    halves_picture,
    residual_picture,
    uncertainty_picture,
)
from calib.result import Result
from gsut.files import write_file
from gsut.page import picture_address, render_page

REPORT_PAGE = "report.html"
_TEMPLATE = Path(__file__).with_name("report_template.html.j2")
_THUMBNAIL = 420  # pixels wide


def write_report_page(folder: Path, result: Result) -> Path:
    """Writes FOLDER/report.html."""
    values = report_values(result)
    page = render_page(
        _TEMPLATE.read_text(encoding="utf-8"),
        values=values,
        cameras=[_camera(result, index, values) for index in range(len(result.cameras))],
        title=f"Calibration of {result.job.out.name}",
    )
    path = folder / REPORT_PAGE
    write_file(path, page)
    return path


def _camera(result: Result, index: int, values: dict[str, Any]) -> dict[str, Any]:
    camera, trust = result.cameras[index], result.trusts[index]
    pictures = [
        residual_picture(camera),
        angle_picture(camera, trust, result.board),
        coverage_picture(camera, trust, result.board),
        uncertainty_picture(camera, trust),
        halves_picture(camera, trust, result.halves[index]),
    ]
    boards = [
        {"name": photograph.path.name, "picture": _thumbnail(path)}
        for photograph, path in zip(result.photographs, result.pictures, strict=True)
        if photograph.camera == camera.name
    ]
    return {
        "name": camera.name,
        "pictures": [picture for picture in pictures if picture],
        "boards": boards,
        **values["cameras"][camera.name],
    }


def _thumbnail(path: Path) -> str:
    return picture_address(cv2.imread(str(path))[..., ::-1], _THUMBNAIL)
