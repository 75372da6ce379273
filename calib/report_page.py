"""report.html: one self-contained page of a calibration, in pictures and tables."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from calib.report_json import report_values
from calib.report_plots import (
    angle_picture,
    coverage_picture,
    halves_picture,
    residual_picture,
    uncertainty_picture,
)
from gsut.files import write_file

if TYPE_CHECKING:
    from calib.calibrate import Result

REPORT_PAGE = "report.html"
_TEMPLATE = Path(__file__).with_name("report_template.html.j2")
_THUMBNAIL = 420  # pixels wide
_JPEG_QUALITY = 75


def write_report_page(folder: Path, result: Result) -> Path:
    """Writes FOLDER/report.html."""
    import jinja2

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["number"] = _number
    values = report_values(result)
    page = environment.from_string(_TEMPLATE.read_text()).render(
        values=values,
        cameras=[_camera(result, index, values) for index in range(len(result.cameras))],
        name=result.job.out.name,
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
    image = cv2.imread(str(path))
    scale = min(1.0, _THUMBNAIL / image.shape[1])
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"
