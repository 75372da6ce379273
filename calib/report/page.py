"""Writes report.html: one self-contained page of a calibration, in pictures and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2

from calib.report.plots import draw_camera
from calib.report.result import Result
from calib.report.values import collect_values
from gsut.files import read_picture, write_file
from gsut.page import (
    build_page,
    build_table,
    embed_picture,
    format_number,
    render_template,
)

REPORT_PAGE = "report.html"
_THUMBNAIL = 420  # pixels of a board's picture: twice its width on the page, for sharp screens
_NOTES = "<h3>Notes</h3><ul>{% for note in notes %}<li>{{ note }}</li>{% endfor %}</ul>"
_PICTURES = """<div class="pictures">
{%- for address in pictures %}<img alt="" src="{{ address }}">{% endfor %}</div>"""
_PHOTOGRAPHS = """<h3>Photographs</h3><div class="pictures">
{%- for address, name in thumbnails %}<figure style="width: {{ width }}px">
<img src="{{ address }}" alt="{{ name }}"><figcaption>{{ name }}</figcaption></figure>{% endfor %}
</div>"""


def write_report_page(folder: Path, result: Result) -> Path:
    """Writes FOLDER/report.html and returns its path."""
    values = collect_values(result)
    refused = [f"Refused. {text}. No lens file was written." for text in values["refused"]]
    parts = _describe_all(values)
    for index, camera in enumerate(result.cameras):
        pictures = draw_camera(camera, result.trusts[index], result.halves[index], result.board)
        boards = [
            (photograph.path.name, path)
            for photograph, path in zip(result.photographs, result.pictures, strict=True)
            if photograph.camera == camera.name
        ]
        parts += _describe_camera(camera.name, values["cameras"][camera.name], pictures, boards)
    path = folder / REPORT_PAGE
    write_file(path, build_page(f"Calibration of {result.job.out.name}", refused, parts))
    return path


def _describe_all(values: dict[str, Any]) -> list[str]:
    """Describes the calibration as a whole: a sentence, a row for each camera, the rig, notes."""
    board, cameras = values["board"], values["cameras"]
    parts = [
        _build_paragraph(
            f"{values['lens']} lens by {values['solver']}; board of {board['columns']} × "
            f"{board['rows']} inner corners, {board['spacing']} a square; {values['boards_found']} "
            f"boards in {values['boards_total']} photographs; {values['seconds']:.1f} s."
        ),
        build_table(
            [
                (
                    name,
                    format_number(c["rms_2d_px"], 3),
                    format_number(c["rms_axis_px"], 3),
                    c["outliers"],
                    f"{c['boards_found']} / {c['boards_total']}",
                    format_number(c["valid_angle_degrees"], 1),
                    format_number(c["boards_reached_degrees"], 1),
                    format_number(c["lens_domain_degrees"], 1),
                    format_number(c["halves_worst_degrees"], 3),
                )
                for name, c in cameras.items()
            ],
            ("", "RMS, 2-D [px]", "RMS, an axis [px]", "outliers", "boards", "trusted to [°]",
             "boards reached [°]", "lens one-to-one to [°]", "odd–even, worst [°]"),
        ),
    ]  # fmt: skip
    if values["rig_rms_2d_px"] is not None:
        first, *others = cameras
        distances = [
            f"{name} is {format_number(cameras[name]['distance_to_reference'], 4)} from {first}."
            for name in others
        ]
        rms = format_number(values["rig_rms_2d_px"], 3)
        words = ["With one pose of the rig for all boards: RMS", rms, "px.", *distances]
        parts.append(_build_paragraph(" ".join(words)))
    if values["notes"]:
        parts.append(render_template(_NOTES, notes=values["notes"]))
    return parts


def _build_paragraph(text: str) -> str:
    return render_template("<p>{{ text }}</p>", text=text)


def _describe_camera(
    name: str, values: dict[str, Any], pictures: list[str], boards: list[tuple[str, Path]]
) -> list[str]:
    """Describes one camera: other lenses of its boards, pictures, residuals, photographs."""
    parts = [render_template("<h2>{{ name }}</h2>", name=name), _build_paragraph(values["model"])]
    if values["second_lenses"]:
        parts += [
            _build_paragraph(
                "Other lenses of the same boards, turned onto this one: the angle to which all "
                f"rays agree within {values['agreement_degrees']}°. The trusted field ends where "
                "one does not (for distant things)."
            ),
            build_table(
                [
                    (
                        f"{s['lens']} by {s['solver']}",
                        format_number(s["rms_2d_px"], 3),
                        format_number(s["compared_to_degrees"], 1),
                        format_number(s["agrees_to_degrees"], 1),
                        format_number(s["agrees_at_the_boards_to_degrees"], 1),
                    )
                    for s in values["second_lenses"]
                ],
                ("lens", "RMS, 2-D [px]", "each trusted by itself to [°]", "agree to [°]",
                 "at the boards' distance to [°]"),
            ),
        ]  # fmt: skip
    parts.append(render_template(_PICTURES, pictures=pictures))
    if rows := values["cross_validation"]:
        title = render_template("<h3>Lenses compared on boards they had not seen</h3>")
        parts += [title, _compare_lenses(rows)]
    thumbnails = [
        (embed_picture(read_picture(path, cv2.IMREAD_COLOR)[..., ::-1], _THUMBNAIL), name)
        for name, path in boards
    ]
    return [
        *parts,
        render_template("<h3>Residuals by region of the image</h3>"),
        build_table(
            [
                (
                    r["column"] + 1,
                    r["row"] + 1,
                    r["corners"],
                    format_number(r["rms_2d_px"], 3),
                    ", ".join(format_number(mean, 3) for mean in r["mean_px"] or [None]),
                )
                for r in values["regions"]
            ],
            ("column", "row", "corners", "RMS, 2-D [px]", "mean x, y [px]"),
            texts=(),
        ),
        render_template(_PHOTOGRAPHS, thumbnails=thumbnails, width=_THUMBNAIL // 2),
        _list_photographs(values["images"]),
    ]


def _compare_lenses(rows: list[dict[str, Any]]) -> str:
    return build_table(
        [
            (
                f"{row['lens']} (chosen)" if row["chosen"] else row["lens"],
                row["parameters"],
                format_number(row["rms_2d_px"], 3),
                format_number(row["standard_error_px"], 3),
                row["problem"] or "",
            )
            for row in rows
        ],
        ("lens", "parameters", "RMS on held-out boards [px]", "standard error", ""),
        texts=(0, 4),
        bold=next((index for index, row in enumerate(rows) if row["chosen"]), None),
    )


def _list_photographs(images: list[dict[str, Any]]) -> str:
    return build_table(
        [
            (
                image["file"],
                format_number(image["rms_2d_px"], 3),
                image["outliers"],
                format_number(image["edge_width_px"], 1),
                "",
            )
            if image["found"]
            else (image["file"], "", "", "", f"left out: {image['reason']}")
            for image in images
        ],
        ("file", "RMS, 2-D [px]", "outliers", "edges [px]", ""),
        texts=(0, 4),
    )
